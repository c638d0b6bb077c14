"""Facets around the nodes of a surface, including facets of other ranks."""

from functools import cached_property
from typing import NamedTuple
from weakref import WeakKeyDictionary

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.obstacles.facing import Facing
from dolfinx_nts.model.segments import NEIGHBOURS, area_vectors
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["AroundNodes", "NodalFacets"]

# Reach of the search for the facets around a node, relative to the longest facet [-]: it only has
# to exceed round-off.
_AROUND = 1e-6
# Least cosine of the angle between the contact normal and the inward normal of a facet on which
# contact acts [-]: 60 degrees, so that it acts on both sides of a right-angled edge with a normal
# at 45 degrees. Smaller: it also acts on lateral facets that bulge; larger: not on facets at blunt
# tips. Other values were not measured.
_OPPOSED = 0.5
# Reference positions of a space, and facets of a surface at these.
_KNOWN: "WeakKeyDictionary[Surface, tuple[Floats, NodalFacets]]" = WeakKeyDictionary()


class AroundNodes(NamedTuple):
    """Facets around nodes, for the kernel in `cpp/nts/search/facing.h`.

    Attributes:
        scatter: Map of the nodes that the facets need.
        nodes: Owned nodes, shape ``(n,)``.
        vertices: Vertices of the facets as nodes of the map, shape ``(f, k)``.
        orientation: +1 where a_1 x a_2 points out of the body, otherwise -1, ``(f,)``.
        counts: Number of facets around each node, shape ``(n,)``.
        facets: These facets, node by node, shape ``(e,)``.
        corner: Local number of the node in each of these facets, shape ``(e,)``.
        angle: Angles of the facets at the nodes, shape ``(e,)`` [rad].
    """

    scatter: NodalScatter
    nodes: Ints
    vertices: Ints
    orientation: Floats
    counts: Ints
    facets: Ints
    corner: Ints
    angle: Floats


class NodalFacets:
    """Facets around the owned nodes of a surface, from which the nodes get normals. Collective.

    Args:
        surface: The surface.

    Attributes:
        around: The facets.
        least_height: Least height of the cells behind the facets of each node, relative to their
            mean, shape ``(n,)`` [-].
    """

    def __init__(self, surface: Surface) -> None:
        X = reference_positions(surface.V)
        near, _ = GlobalSearch(surface, surface).update(X, _AROUND * surface.size)
        number = np.full(near.scatter.num_local, -1, dtype=np.int32)
        number[surface.nodes] = np.arange(len(surface.nodes), dtype=np.int32)
        node = number[near.segments].ravel()
        order = np.argsort(node, kind="stable")[np.count_nonzero(node < 0) :]
        facet, corner = (part.astype(np.int32) for part in np.divmod(order, near.segments.shape[1]))
        counts = np.bincount(node[order], minlength=len(surface.nodes))
        at_rest = near.scatter.forward(X)[near.segments]
        angle = _angles(at_rest).ravel()[order]
        # Contribution of each facet to the area of the node, in the order of ``around.facets``
        # [m^2].
        vectors = area_vectors(at_rest, near.orientation)
        size = np.linalg.norm(vectors, axis=1)
        self._comm: MPI.Comm = surface.V.mesh.comm
        self._normals: Floats = _kernels.unit_vectors(vectors)
        if is_axisymmetric(surface.V.mesh):
            size *= at_rest[:, :, 0].mean(axis=1)
        at: Ints = node[order]
        of_node = np.bincount(at, size[facet], len(surface.nodes))
        self._fractions: Floats = size[facet] / of_node[at]
        # Heights of the cells behind the facets, relative to the mean at the node [-].
        height = near.of_segments[3][facet]
        mean = np.bincount(at, self._fractions * height, len(surface.nodes))
        self._heights: Floats = height / mean[at]
        self.least_height: Floats = np.ones(len(mean))
        np.minimum.at(self.least_height, at, self._heights)
        facets = near.segments, near.orientation, counts.astype(np.int32), facet, corner
        self._take(AroundNodes(near.scatter, surface.nodes, *facets, angle))

    @classmethod
    def of(cls, surface: Surface) -> "NodalFacets":
        """Cached facets of a surface, renewed after its mesh has moved. Collective."""
        X, comm = reference_positions(surface.V), surface.V.mesh.comm
        # The nodes of some ranks only may have moved.
        if surface not in _KNOWN or reductions.anywhere(comm, _KNOWN[surface][0] is not X):
            _KNOWN[surface] = X, cls(surface)
        return _KNOWN[surface][1]

    def _take(self, around: AroundNodes, group: Ints | None = None) -> None:
        """Create the kernel object.

        ``group`` is the group of candidate segments of each node, shape ``(n,)``; None for one
        group.
        """
        self.around, counts = around, around.counts
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        # Nodes on whose positions the normals depend.
        self._vertices: Ints = np.unique(around.vertices)
        facets = (
            np.searchsorted(self._vertices, around.vertices).astype(np.int32),
            around.orientation,
            first,
            around.facets,
            around.corner,
            around.angle,
        )
        self._kernel = _kernels.NodeFacets(*facets, group)
        self._numbers: Ints = np.arange(len(counts), dtype=np.int32)

    def points(self, x: Floats) -> NodalPoints:
        """Create contact points of the nodes, with their normals at positions x. Collective.

        ``x`` are positions of the local nodes of the space, owned and ghost, ``(l, 3)`` [m].
        """
        # Copied, as x may change later.
        corners = self.around.scatter.forward(x).take(self._vertices, axis=0)
        facing = Facing(self._kernel, corners, self._numbers)
        return NodalPoints(self.around.nodes, facing)

    @cached_property
    def has_edges(self) -> bool:
        """Whether normals of two facets at a node differ by more than 60 degrees. Collective."""
        return reductions.anywhere(self._comm, bool(self._are_kinked.any()))

    @cached_property
    def _are_kinked(self) -> Flags:
        """Whether normals of two facets of each node differ by more than 60 degrees, ``(n,)``."""
        around, node = self.around, np.repeat(self._numbers, self.around.counts)
        outward = self._normals[around.facets]
        found: Flags = np.zeros(len(around.counts), dtype=bool)
        for apart in range(1, int(around.counts.max(initial=0))):
            cosine = np.einsum("ei,ei->e", outward[apart:], outward[:-apart])
            found[node[apart:][(node[apart:] == node[:-apart]) & (cosine < _OPPOSED)]] = True
        return found

    def facing_fractions(self, x: Floats, normal: Floats, presses: Flags) -> Floats:
        """Fractions of the nodal areas on facets in contact, shape ``(n,)`` [-]. Collective.

        Contact acts on the facets that are opposed to the contact normal, and not on facets beyond
        an edge. On surfaces without edges these are all facets, and the pressure integrates to the
        force.

        Args:
            x: Positions of the local nodes of the space, owned and ghost, ``(l, 3)`` [m].
            normal: Unit contact normals of the nodes, shape ``(n, 3)``. A node with 0 gets the mean
                normal of the nodes of its facets; if these are also 0, the fraction is 1.
            presses: Flags of nodes with a force, whose fraction is 1 if no facet is opposed,
                ``(n,)``.
        """
        around, node = self.around, np.repeat(self._numbers, self.around.counts)
        of_all = np.zeros((around.scatter.index_map.size_local, 3))
        of_all[around.nodes] = normal
        of_facets = around.scatter.forward(of_all)[around.vertices].sum(axis=1)[around.facets]
        near = [np.bincount(node, of_facets[:, i], len(normal)) for i in range(3)]
        knows: Flags = np.abs(normal).max(axis=1) > 0
        normal = np.where(knows[:, None], normal, np.column_stack(near))
        normal = np.nan_to_num(_kernels.unit_vectors(normal))
        knows = np.abs(normal).max(axis=1) > 0
        fractions = np.bincount(
            node, self._fractions * (self._opposed(x, normal) > _OPPOSED), len(normal)
        )
        return np.where((fractions == 0) & (presses | ~knows), 1.0, fractions)

    def pressed_layers(self, x: Floats, normal: Floats) -> tuple[Floats, Floats]:
        """Fractions of the nodal areas on which contact may press, and heights there. Collective.

        Unlike the results of `facing_fractions` they are continuous in the normal: the weight of a
        facet decreases from 1 at 60 degrees to 0 at 90 degrees.

        Args:
            x: See `facing_fractions`.
            normal: Unit contact normals of the nodes, or 0, ``(n, 3)``.

        Returns:
            The fractions, and the mean heights of the cells behind these areas relative to those
            behind all facets of the node, each of shape ``(n,)`` [-]; 1 for a normal 0, or if all
            facets have the weight 0.
        """
        weight = np.clip(self._opposed(x, normal) / _OPPOSED, 0.0, 1.0) * self._fractions
        node = np.repeat(self._numbers, self.around.counts)
        fractions = np.bincount(node, weight, len(normal)).astype(np.float64)
        moments = np.bincount(node, weight * self._heights, len(normal))
        presses, heights = fractions > 0, np.ones(len(normal))
        np.divide(moments, fractions, out=heights, where=presses)
        return np.where(presses, fractions, 1.0), heights

    def turns_from(self, x: Floats, normal: Floats, least: float) -> Flags:
        """Whether nodes within smooth faces turn away from contact normals, ``(n,)``. Collective.

        A face is smooth at a node if its facets there are within 60 degrees of each other.

        Args:
            x: See `facing_fractions`.
            normal: Unit contact normals of the nodes, or 0, ``(n, 3)``.
            least: Cosine between a contact normal and an inward facet normal below which the facet
                turns away [-].
        """
        node, cosine = np.repeat(self._numbers, self.around.counts), self._opposed(x, normal)
        largest: Floats = np.full(len(normal), -np.inf)
        np.maximum.at(largest, node, cosine)
        turned: Flags = (largest < least) & ~self._are_kinked
        return turned

    def _opposed(self, x: Floats, normal: Floats) -> Floats:
        """Cosine between the contact normal of a node and inward facet normals, ``(e,)`` [-]."""
        around, node = self.around, np.repeat(self._numbers, self.around.counts)
        vectors = area_vectors(around.scatter.forward(x)[around.vertices], around.orientation)
        outward = _kernels.unit_vectors(vectors)[around.facets]
        cosine: Floats = -np.einsum("ei,ei->e", outward, normal[node])
        return cosine


def _angles(x: Floats) -> Floats:
    """Angles of facets at their vertices, ``(f, k)``, by positions ``(f, k, 3)``."""
    if x.shape[1] == 2:  # from vectors along both edges, of equal length
        return np.ones(x.shape[:2])
    neighbours = np.array(NEIGHBOURS[x.shape[1]])
    a, b = (x[:, neighbours[:, side]] - x for side in (0, 1))
    sine = np.linalg.norm(np.cross(a, b), axis=2)
    angles: Floats = np.arctan2(sine, np.einsum("fki,fki->fk", a, b))
    return angles
