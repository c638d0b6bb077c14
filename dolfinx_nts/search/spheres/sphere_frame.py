"""Exact spherical surfaces of meshed rigid bodies."""

import numpy as np

from dolfinx_nts.common.arrays import Floats, GlobalInts, Ints
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.node_numbering import input_ids, reference_positions
from dolfinx_nts.model.obstacles.rigid_shapes import RigidSphere
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.search.global_search import owners_of

__all__ = ["SphereFrame"]


# Distance of vertices from a plane relative to the radius [-] that counts as zero.
_FLAT = 1e-6


class SphereFrame:
    """Centre of a sphere and points that rotate with it, linear in a few nodes. Collective.

    Args:
        surface: Surface of a rigid body with the sphere as its shape.

    Raises:
        ValueError: All vertices of the facets lie in a plane, and cannot define the sphere.

    Attributes:
        sphere: The sphere in the reference configuration.
        bulge: Largest distance of the sphere from the facets [m].
        ids: Global numbers of the vertices of each facet, then of the d + 1 nodes that define the
            sphere, shape ``(s, k + d + 1)``. The latter are the same for all facets.
        owners: Ranks that own the nodes, of the same shape.
        weights: Weights of these nodes in the control points: the centre, and d points at the
            radius along the reference axes, shape ``(s, d + 1, k + d + 1)``.
    """

    def __init__(self, surface: Surface) -> None:
        assert isinstance(surface.smooth, RigidSphere)
        self.sphere = sphere = surface.smooth
        V, comm, d = surface.V, surface.V.mesh.comm, dimension(surface.V)
        own, places = surface.segments, reference_positions(V)
        space = V.dofmap.index_map
        dofs = space.local_to_global(own.ravel()).reshape(own.shape)
        owners = owners_of(space, own)
        of_nodes = input_ids(V)[own].ravel(), places[own].reshape(-1, 3), dofs.ravel()
        ids, X, *nodes = (joined(comm, values) for values in (*of_nodes, owners.ravel()))
        _, first = np.unique(ids, return_index=True)
        carriers = first[_spread_points(X[first], d + 1)]
        arms = (X[carriers[1:], :d] - X[carriers[0], :d]) / sphere.radius
        if np.linalg.matrix_rank(arms, tol=_FLAT) < d:
            raise ValueError(
                f"expected facets of {surface.name} with vertices in more than one plane, which "
                f"define {sphere!r}: use a larger part of the surface"
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


def _spread_points(X: Floats, number: int) -> Ints:
    """Indices of points, each the farthest from the span of the previous points, ``(number,)``."""
    chosen, rest = [0], X - X[0]
    while len(chosen) < number:
        chosen.append(int(np.linalg.norm(rest, axis=1).argmax()))
        length = float(np.linalg.norm(rest[chosen[-1]]))
        along = rest[chosen[-1]] / (length or 1.0)
        rest = rest - np.outer(rest @ along, along)
    return np.array(chosen, dtype=np.int32)
