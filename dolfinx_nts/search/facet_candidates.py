"""Segments as parts of facets, which mortar contact touches as a whole."""

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.search.points import ContactPoints
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates

__all__ = ["FacetCandidates"]


class FacetCandidates(SegmentCandidates):
    """Segments with the facets that they are parts of, see `SegmentCandidates`.

    Segments say which points face which facet. Gap, force and slip are those of the facet: at
    degree 2 of the curved one, see `cpp/nts/geometry/facet.h`.

    Args:
        found: The segments.
        wholes: Nodes of the facet of each segment, shape ``(s, n)``; at degree 1 the segments.

    Attributes:
        wholes: The argument.
        whole: Number of the facet of each segment, shape ``(s,)``.
        is_curved: Whether facets have more nodes than their vertices.
    """

    def __init__(self, found: FoundSegments, wholes: Ints) -> None:
        """Number the facets."""
        super().__init__(found)
        self.wholes = wholes
        self.is_curved = wholes.shape[1] > self.segments.shape[1]
        self.whole: Ints = np.arange(len(wholes), dtype=np.int32)
        if self.is_curved:
            number = np.unique(wholes, axis=0, return_inverse=True)[1]
            self.whole = number.ravel().astype(np.int32)
        kind = "patch" if self.is_curved else "contact"
        self._contact = {s: getattr(_kernels, f"{kind}_{s}") for s in _SCHEMES}
        self._project = _kernels.patch_project if self.is_curved else _kernels.project
        self._slip = _kernels.patch_slip if self.is_curved else _kernels.slip

    def gap(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Compute the gap of points to the facets of segments, see `Candidates.gap`."""
        return self._project(self.pairs(points, x, segment), self.orientation.take(segment))[1]

    def places(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Coordinates of points on the facets of segments, shape ``(m, 2)``."""
        return self._project(self.pairs(points, x, segment), self.orientation.take(segment))[0]

    def contact(
        self, scheme: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> ContactKinematics:
        """Evaluate gap and force of pairs, see `Candidates.contact`."""
        pairs = self._both_states(points, x_n, x, segment)
        return ContactKinematics(*self._contact[scheme](*pairs))

    def slip(self, law: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints) -> Slip:
        """Evaluate the slip of pairs by the law "objective", see `Candidates.slip`."""
        pairs = self._both_states(points, x_n, x, segment)
        *values, frame_n, frame = self._slip(*pairs)
        return Slip(*values, frame_n=frame_n, frame=frame, orientation=pairs[2])

    def pairs(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Positions of points and nodes of facets, shape ``(m, 1+n, 3)`` [m]."""
        pairs = np.empty((len(segment), 1 + self.wholes.shape[1], 3))
        pairs[:, 0] = points.of(x)
        pairs[:, 1:] = x.take(self.wholes.take(segment, axis=0), axis=0)
        return pairs


# Kernels of contact, see `Candidates.contact`.
_SCHEMES = ("conserving", "midpoint", "static")
