"""Global search of surface-to-surface contact: facets around nodes, and segments in their reach."""

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.global_search import GlobalSearch, owners_of
from dolfinx_nts.search.mortar_points import MortarFacets
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates

__all__ = ["MortarCandidates", "MortarSearch"]

# Reach of the search for the facets around a node, relative to the longest facet [-]: they are
# at no distance but for round-off.
_AROUND = 1e-6


class MortarCandidates(SegmentCandidates):
    """Segments with the facets that may touch them, see `SegmentCandidates`.

    Args:
        found: The segments.
        facets: Facets around the owned nodes, by the nodes of the same map.

    Attributes:
        facets: The argument.
    """

    def __init__(self, found: FoundSegments, facets: MortarFacets) -> None:
        """Take both."""
        super().__init__(found)
        self.facets = facets


class MortarSearch(GlobalSearch):
    """Finds the segments that facets around the owned nodes can reach, see `Search`. Collective.

    Facets of other ranks are known too where an owned node is one of their vertices: each rank
    computes all that the multipliers of its nodes do.

    Args:
        nodes: Surface whose facets look for segments.
        segments: Surface that offers segments.
    """

    candidates: MortarCandidates

    def __init__(self, nodes: Surface, segments: Surface) -> None:
        """Find the facets around the nodes."""
        super().__init__(nodes, segments)
        space = nodes.V.dofmap.index_map
        X: Floats = nodes.V.tabulate_dof_coordinates()
        self._X = X[: space.size_local]
        near, _ = GlobalSearch(nodes, nodes).update(X, _AROUND * nodes.size)
        around = (near.segments < space.size_local).any(axis=1)
        vertices = near.segments[around]
        self._shape, self._orientation = vertices.shape, near.orientation[around]
        ids = near.scatter.index_map.local_to_global(vertices.ravel())
        self._others = ids, owners_of(near.scatter.index_map)[vertices.ravel()]

    def _make(self, found: FoundSegments, others: Ints) -> MortarCandidates:
        """Add the facets, see `GlobalSearch`."""
        X = np.array(found.scatter.forward(self._X))
        vertices = others.reshape(self._shape)
        nodes = self._nodes
        facets = MortarFacets(nodes.nodes, nodes.area, vertices, self._orientation, X)
        return MortarCandidates(found, facets)
