"""Spheres that rigid bodies carry along: exact surfaces in the place of meshed ones."""

import numpy as np

from dolfinx_nts.common.arrays import Floats, GlobalInts, Ints
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.node_numbering import input_ids, reference_positions
from dolfinx_nts.model.rigid_shapes import RigidSphere
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.search.global_search import owners_of

__all__ = ["SphereFrame"]


# Distance of vertices from a plane, relative to the radius [-], that is none.
_FLAT = 1e-6


class SphereFrame:
    """Centre of a sphere and points that turn with it, linear in a few nodes. Collective.

    Args:
        surface: Surface of a rigid body with the sphere as its shape.

    Raises:
        ValueError: All vertices of its facets lie in a plane, and cannot carry the sphere.

    Attributes:
        sphere: The sphere, where the body is in the reference configuration.
        bulge: How far the sphere is outside of the facets at most [m].
        ids: Global numbers of the vertices of each facet, then of the d + 1 nodes that carry the
            sphere, the same for all facets, shape ``(s, k + d + 1)``.
        owners: Their ranks, of the same shape.
        weights: Weights of these nodes in the control points, which are the centre and the d
            points at the radius along the axes in the reference configuration, shape
            ``(s, d + 1, k + d + 1)``.
    """

    def __init__(self, surface: Surface) -> None:
        assert isinstance(surface.smooth, RigidSphere)
        self.sphere = sphere = surface.smooth
        V, comm, d = surface.V, surface.V.mesh.comm, dimension(surface.V)
        own, places = surface.segments, reference_positions(V)
        space = V.dofmap.index_map
        dofs = space.local_to_global(own.ravel()).reshape(own.shape)
        owners = owners_of(space)[own]
        of_nodes = input_ids(V)[own].ravel(), places[own].reshape(-1, 3), dofs.ravel()
        ids, X, *nodes = (joined(comm, values) for values in (*of_nodes, owners.ravel()))
        _, first = np.unique(ids, return_index=True)
        carriers = first[_far_apart(X[first], d + 1)]
        arms = (X[carriers[1:], :d] - X[carriers[0], :d]) / sphere.radius
        if np.linalg.matrix_rank(arms, tol=_FLAT) < d:
            raise ValueError(
                f"expected facets of {surface.name} that are more than one plane cut of "
                f"{sphere!r}, which their vertices carry along: take more of its surface"
            )
        rows = [
            np.hstack([of_facets, np.tile(values[carriers], (len(own), 1))])
            for of_facets, values in zip((dofs, owners), nodes, strict=True)
        ]
        self.ids: GlobalInts = rows[0]
        self.owners: Ints = rows[1]
        points = sphere.centre + sphere.radius * np.eye(d + 1, 3, -1)
        ones = np.ones((d + 1, 1))
        of_carriers = np.hstack([ones, points[:, :d]]) @ np.linalg.inv(
            np.hstack([ones, X[carriers, :d]])
        )
        self.weights: Floats = np.zeros((len(own), d + 1, self.ids.shape[1]))
        self.weights[:, :, own.shape[1] :] = of_carriers
        normals = area_vectors(places[own], surface.orientation)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        height = np.einsum("fi,fi->f", normals, places[own[:, 0]] - sphere.centre)
        bulge = sphere.radius - height.min(initial=sphere.radius)
        self.bulge = reductions.largest(comm, float(bulge))


def _far_apart(X: Floats, number: int) -> Ints:
    """Points of which each is farthest from what those before it span, ``(number,)``."""
    chosen, rest = [0], X - X[0]
    while len(chosen) < number:
        chosen.append(int(np.linalg.norm(rest, axis=1).argmax()))
        length = float(np.linalg.norm(rest[chosen[-1]]))
        along = rest[chosen[-1]] / (length or 1.0)
        rest = rest - np.outer(rest @ along, along)
    return np.array(chosen, dtype=np.int32)
