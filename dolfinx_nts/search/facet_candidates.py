"""Segments as parts of facets, which mortar contact touches as a whole."""

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.search.points import ContactPoints
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates
from dolfinx_nts.search.whole_facets import equal_mean_weights

__all__ = ["FacetCandidates"]


class FacetCandidates(SegmentCandidates):
    """Segments with the facets that they are parts of, see `SegmentCandidates`.

    Args:
        found: The segments.
        wholes: Nodes of the facet of each segment, shape ``(s, n)``; at degree 1 the segments.

    Attributes:
        wholes: The argument.
        weights: Those of these nodes in the vertices of the segments, shape ``(s, k, n)``; None
            where these are the nodes.
    """

    def __init__(self, found: FoundSegments, wholes: Ints) -> None:
        """Tell the nodes in the vertices of segments."""
        super().__init__(found)
        self.wholes = wholes
        self.weights: Floats | None = None
        if wholes.shape[1] > self.segments.shape[1]:
            self.weights = equal_mean_weights(self.segments, wholes)

    def vertices(self, x: Floats) -> tuple[Ints, Floats]:
        """Rows of positions, ``(s, k)``, and positions of the vertices of all segments [m]."""
        if self.weights is None:
            return self.segments, x
        y = self.weights @ x[self.wholes]
        return np.arange(len(y) * y.shape[1], dtype=np.int32).reshape(y.shape[:2]), y.reshape(-1, 3)

    def pairs(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Positions of points and vertices, shape ``(m, 1+k, 3)`` [m]."""
        if self.weights is None:
            return super().pairs(points, x, segment)
        y = self.weights[segment] @ x[self.wholes[segment]]
        return np.concatenate([points.of(x)[:, None], y], axis=1)
