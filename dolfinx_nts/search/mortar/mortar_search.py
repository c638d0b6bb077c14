"""Global search of surface-to-surface contact: segments within reach of the facets of nodes."""

from functools import cached_property

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.global_search import GlobalSearch, owners_of
from dolfinx_nts.search.mortar.facet_candidates import FacetCandidates
from dolfinx_nts.search.mortar.mortar_points import MortarFacets
from dolfinx_nts.search.mortar.whole_facets import HatFunctions, whole_facets
from dolfinx_nts.search.segment_candidates import FoundSegments
from dolfinx_nts.search.smooth.smooth_patches import SmoothPatches

__all__ = ["MortarCandidates", "MortarSearch"]

# Radius of the search for the facets around a node, relative to the longest facet [-]: their
# distance is round-off.
_AROUND = 1e-6
# Round-off of sums of weights [-].
_ROUND_OFF = 1e-10


class MortarCandidates(FacetCandidates):
    """Candidate segments with the facets that may touch them.

    Args:
        found: The segments.
        facet_nodes: See `FacetCandidates`.
        facets: Facets around the owned nodes, by the nodes of the same map.

    Attributes:
        facets: The argument.
        hat_functions: Linear fields on the facets; None at degree 1, where all fields are linear.
    """

    def __init__(self, found: FoundSegments, facet_nodes: Ints, facets: MortarFacets) -> None:
        """Store the arguments."""
        super().__init__(found, facet_nodes)
        self.facets = facets
        self.hat_functions = _hat_functions(self, facets.vertices) if self.has_middles else None


class FacetSearch(GlobalSearch):
    """Search for segments with their whole facets, see `GlobalSearch`. Collective.

    Args:
        nodes: Surface of the nodes.
        segments: Surface that offers segments.
    """

    candidates: FacetCandidates

    def __init__(self, nodes: Surface, segments: Surface) -> None:
        """Prepare the search, which also sends the nodes of whole facets to other ranks."""
        super().__init__(nodes, segments)
        self._k, space = segments.segments.shape[1], segments.V.dofmap.index_map
        # A sphere has no patches.
        if segments.smooth is True:
            patches = SmoothPatches.of(segments)
            self._offer = patches.ids, patches.owners, *self._offer[2:]
            self._weights = patches.weights, patches.rise
            return
        facet_nodes = whole_facets(segments.segments, Element.of(segments.V).degree)
        if facet_nodes is not segments.segments:
            ids, owners, orientation, key, thickness = self._offer
            more = space.local_to_global(facet_nodes.ravel()).reshape(facet_nodes.shape)
            owners = np.hstack([owners, owners_of(space, facet_nodes)])
            self._offer = np.hstack([ids, more]), owners, orientation, key, thickness

    def _make(self, found: FoundSegments, others: Ints, x: Floats, reach: float) -> FacetCandidates:
        return FacetCandidates(*self._parted(found))

    def _parted(self, found: FoundSegments) -> tuple[FoundSegments, Ints]:
        k, vertices = self._k, found.vertices
        if vertices.shape[1] == k:
            return found, vertices
        facet_nodes = vertices[:, k:] if found.weights is None else vertices
        return found._replace(vertices=np.ascontiguousarray(vertices[:, :k])), facet_nodes


class MortarSearch(FacetSearch):
    """Search for segments within reach of facets around the owned nodes, see `Search`. Collective.

    A rank gets all facets around its owned nodes, including facets of other ranks, so that it can
    evaluate the multipliers of its nodes without further communication.

    Args:
        nodes: Surface whose facets search for segments.
        segments: Surface that offers segments.
    """

    candidates: MortarCandidates

    def __init__(self, nodes: Surface, segments: Surface) -> None:
        """Find the facets around the nodes."""
        super().__init__(nodes, segments)
        space = nodes.V.dofmap.index_map
        X: Floats = reference_positions(nodes.V)
        self._X = X[: space.size_local]
        search = FacetSearch(nodes, nodes)
        search.update(X, _AROUND * nodes.size)
        near = search.candidates
        # First segment of each facet, ascending.
        first = np.sort(np.unique(near.facet_nodes, axis=0, return_index=True)[1])
        around = first[(near.facet_nodes[first] < space.size_local).any(axis=1)]
        facets, there = near.facet_nodes[around], near.scatter.forward(self._X)
        self._shape = facets.shape
        self._of_patches: tuple[Floats, Floats] | None = None
        if near.weights is not None and near.rise is not None:
            self._of_patches = near.weights[around], near.rise[around]
        out = area_vectors(there[near.segments[around]], near.orientation[around])
        own = area_vectors(there[facets[:, : self._k]], np.ones(len(facets)))
        self._orientation = np.where(np.einsum("fi,fi->f", out, own) > 0, 1.0, -1.0)
        size = np.linalg.norm(own, axis=1)
        self._is_axisymmetric = is_axisymmetric(nodes.V.mesh)
        if self._is_axisymmetric:
            size *= 2 * np.pi * there[facets[:, : self._k], 0].mean(axis=1)
        shares = np.repeat(size / self._k, self._k)
        area = np.bincount(facets[:, : self._k].ravel(), shares, near.scatter.num_local)
        self._area: Floats = area[nodes.nodes].astype(np.float64)
        ids = near.scatter.index_map.local_to_global(facets.ravel())
        self._others = ids, owners_of(near.scatter.index_map, facets.ravel())
        self._around = _hat_functions(near, facets) if near.has_middles else None
        self._near, self._near_facets = near.scatter, facets[:, : self._k]

    def is_near(self, x: Floats, reach: float) -> bool:
        # Facets of this rank's nodes extend beyond these.
        self.update(x, reach + 2 * self._nodes.size)
        candidates = self.candidates
        facets, segments = candidates.facets.vertices, candidates.segments
        if candidates.may_curve or self._of_patches is not None:
            return True
        there = candidates.scatter.forward(x)
        return _kernels.facets_may_be_within(there, facets, segments, reach)

    def per_area(self, force: Floats, facing: Floats, covered: Floats) -> Floats:
        """Vertex forces per covered area [Pa], interpolated to mid-nodes of degree 2.

        The force of a node may act on a sliver of its facets, below an edge of the other body. The
        smaller the covered part of the facing facets, the more the mean pressure of all facets
        around the node counts. A uniform pressure is exact.

        Mid-nodes next to a vertex without a segment have no traction, such as on adjacent free
        faces.
        """
        area = self._area * facing
        own = np.clip(np.divide(covered, area, out=np.ones_like(facing), where=area > 0), 0, 1)
        columns = np.column_stack([covered, force])
        presses = np.abs(columns[:, 1:]).max(axis=1) > 0
        mean = (own * columns.T + (1 - own) * self._around_nodes(columns).T).T
        mean[mean[:, 0] <= 0] = np.column_stack([facing, force])[mean[:, 0] <= 0]
        values = np.zeros_like(columns[:, 1:])
        values[presses] = mean[presses, 1:] / mean[presses, :1]
        values = values.reshape(force.shape)
        if self._around is None:
            return values
        fields = np.zeros((2, *self._X.shape))
        nodes, columns = self._nodes.nodes, np.atleast_2d(values.T).T
        fields[0, nodes, : columns.shape[1]] = columns
        fields[1, nodes, 0] = covered > 0
        spread, covered = (self._around.spread(field)[nodes] for field in fields)
        spread *= covered[:, :1] > 1 - _ROUND_OFF
        return spread[:, : columns.shape[1]].reshape(force.shape)

    def _around_nodes(self, values: Floats) -> Floats:
        """Sums of values over each node and its neighbours on facets, ``(n, m)``. Collective."""
        row, neighbour = self._neighbours
        sums = np.zeros_like(values)
        for i, column in enumerate(values.T):
            field = np.zeros_like(self._X)
            field[self._nodes.nodes, 0] = column
            there = self._near.forward(field)[neighbour, 0]
            sums[:, i] = np.bincount(row, there, len(values))
        return sums

    @cached_property
    def _neighbours(self) -> tuple[Ints, Ints]:
        """Pairs of a node and a node of the map on its facets, as two arrays ``(p,)``. Local."""
        number = np.full(self._near.num_local, -1)
        number[self._nodes.nodes] = np.arange(len(self._nodes.nodes))
        k = self._near_facets.shape[1]
        pairs = np.stack([np.repeat(self._near_facets, k, axis=1), np.tile(self._near_facets, k)])
        node, neighbour = np.unique(pairs.reshape(2, -1), axis=1)
        owned = number[node] >= 0
        return number[node[owned]], neighbour[owned]

    def _make(
        self, found: FoundSegments, others: Ints, x: Floats, reach: float
    ) -> MortarCandidates:
        X = np.array(found.scatter.forward(self._X))
        facet_nodes = others.reshape(self._shape)
        vertices = (
            facet_nodes
            if self._of_patches is None
            else np.ascontiguousarray(facet_nodes[:, : self._k])
        )
        facets = MortarFacets(
            self._nodes.nodes,
            self._area,
            vertices,
            self._orientation,
            X,
            self._is_axisymmetric,
            facet_nodes,
            self._of_patches,
        )
        return MortarCandidates(*self._parted(found), facets)


def _hat_functions(candidates: FacetCandidates, facets: Ints) -> HatFunctions:
    return HatFunctions(candidates.scatter, facets, candidates.segments.shape[1])
