"""Global search of edge-to-edge contact: edges of one surface near those of another."""

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.surfaces import Surface, diameters
from dolfinx_nts.search.edge_candidates import EdgeCandidates, Edges
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.segment_candidates import FoundSegments
from dolfinx_nts.search.sharp_edges import SharpEdges

__all__ = ["EdgeSearch"]

# Distance, in longest facets of both surfaces [-], up to which edges are looked for where any
# distance is asked for: crossings further away have no meaning.
_FARTHEST = 4.0


class EdgeSearch(GlobalSearch):
    """Finds sharp edges that those of another surface can reach, see `GlobalSearch`. Collective.

    Args:
        nodes: Surface whose nodes carry the multipliers.
        segments: The other surface.
        edges: Sharp edges of both.
    """

    candidates: EdgeCandidates

    def __init__(
        self, nodes: Surface, segments: Surface, edges: tuple[SharpEdges, SharpEdges]
    ) -> None:
        """Offer the edges of the other surface with the facets at them."""
        super().__init__(nodes, segments)
        # All owned nodes, also those whose facets belong to other ranks.
        self._vertices = np.union1d(self._vertices, segments.nodes).astype(np.int32)
        self._own, self._offers = edges
        ids, owners = self._offers.offer
        no_orientation = np.ones(len(ids))
        thickness = self._offers.thickness
        self._offer = ids, owners, no_orientation, self._offers.key, thickness
        ids, owners = self._own.offer
        self._shape, self._others = ids.shape, (ids.ravel(), owners.ravel())
        self._farthest = _FARTHEST * (nodes.size + segments.size)

    def update(self, x: Floats, reach: float) -> tuple[EdgeCandidates, bool]:
        """Find what is within reach, but not at any distance, see `Search.update`."""
        candidates, is_new = super().update(x, min(reach, self._farthest))
        assert isinstance(candidates, EdgeCandidates)
        return candidates, is_new

    def _offered(self, x: Floats) -> Floats:
        """Ends of the edges, see `GlobalSearch`."""
        return self._offers.ends(x)

    def _make(
        self, found: FoundSegments, others: Ints, x: Floats, reach: float
    ) -> EdgeCandidates:
        """Pair edges, see `GlobalSearch`."""
        own = Edges.of(others.reshape(self._shape), self._own.key, self._own.thickness)
        other = Edges.of(found.vertices, found.key, found.thickness)
        x = found.scatter.forward(x)
        return EdgeCandidates.near(found.scatter, own, other, self._offers.total, x, reach)
