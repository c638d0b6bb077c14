"""Global search of edge-to-edge contact."""

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.edges.current_edges import Edges
from dolfinx_nts.search.edges.edge_candidates import EdgeCandidates
from dolfinx_nts.search.edges.sharp_edges import SharpEdges
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates

__all__ = ["EdgeSearch"]

# Largest distance of edges, in longest facets of both surfaces [-], if the reach is infinite.
_FARTHEST = 4.0


class EdgeSearch(GlobalSearch):
    """Search for sharp edges near the edges of another surface. Collective.

    Args:
        nodes: Surface whose nodes carry the multipliers.
        segments: The other surface.
    """

    candidates: EdgeCandidates
    # Small margin, since each pair of edges within reach is evaluated in each step.
    _margin = 1.5

    def __init__(self, nodes: Surface, segments: Surface) -> None:
        super().__init__(nodes, segments)
        # All owned nodes, including nodes whose facets belong to other ranks.
        self._vertices = np.union1d(self._vertices, segments.nodes).astype(np.int32)
        self._own, self._offers = map(SharpEdges.of, (nodes, segments))
        ids, owners = self._offers.offer
        no_orientation = np.ones(len(ids))
        thickness = self._offers.thickness
        self._offer = ids, owners, no_orientation, self._offers.key, thickness
        ids, owners = self._own.offer
        self._shape, self._others = ids.shape, (ids.ravel(), owners.ravel())
        self._farthest = _FARTHEST * (nodes.size + segments.size)

    def update(self, x: Floats, reach: float) -> tuple[EdgeCandidates, bool]:
        candidates, is_new = super().update(x, min(reach, self._farthest))
        assert isinstance(candidates, EdgeCandidates)
        return candidates, is_new

    def _find(self, x: Floats, reach: float) -> SegmentCandidates:
        return super()._find(x, reach + self._additional_reach(x))

    def _additional_reach(self, x: Floats) -> float:
        """Longest edge of a carrier of this rank [m]. Collective."""
        first, second = self._own.ends(x)
        return float(np.linalg.norm(second - first, axis=1).max(initial=0.0))

    def _offered(self, x: Floats) -> Floats:
        return self._offers.ends(x)

    def _make(self, found: FoundSegments, others: Ints, x: Floats, reach: float) -> EdgeCandidates:
        own = Edges.of(others.reshape(self._shape), self._own.key, self._own.thickness)
        other = Edges.of(found.vertices, found.key, found.thickness)
        reach -= self._additional_reach(x)
        x = found.scatter.forward(x)
        return EdgeCandidates.paired(found.scatter, own, other, self._offers.total, x, reach)
