"""Smooth segments as candidates: cubic patches on facets."""

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts._kernels import HYSTERESIS
from dolfinx_nts.common.arrays import Flags, Floats, Ints, indices
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.obstacles.rims import is_nearest_a_rim
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.search.points import ContactPoints
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates
from dolfinx_nts.search.smooth.smooth_patches import flat_patch

__all__ = ["SmoothCandidates", "weights_of_pairs"]

# Largest distance from the centre of a patch, in its coordinates [-], at which the patch is used:
# half a patch beyond its edges.
_OUTSIDE = 1.0


class SmoothCandidates(SegmentCandidates):
    """Smooth segments near the points of this rank.

    Flat facets select the segment of a point. Gap, force and slip are evaluated on the patch. Its
    *vertices* are all nodes on which it depends.

    Args:
        found: The facets, with the nodes of the patches and their weights.
        k: Number of vertices of a facet, the first of the nodes.
    """

    may_curve = True

    def __init__(self, found: FoundSegments, k: int) -> None:
        super().__init__(found._replace(vertices=np.ascontiguousarray(found.vertices[:, :k])))
        assert found.weights is not None
        self._vertices, self.segments = self.segments, found.vertices
        self._weights = weights_of_pairs(found.weights)

    def pair(
        self,
        points: ContactPoints,
        x: Floats,
        current: Ints,
        reach: float,
        slack: float = HYSTERESIS,
    ) -> tuple[Ints, Floats]:
        segment, gap = super().pair(points, x, current, reach, slack)
        some = indices(segment >= 0)
        if len(some):
            pairs, orientation = self._patches(points.take(some), x, segment[some])
            xi, smooth, *_ = _kernels.patch_project(pairs, orientation)
            near = np.abs(xi - 0.5).max(axis=1) <= _OUTSIDE  # false where there is no projection
            gap[some[near]] = smooth[near]
        return segment, gap

    def gap(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        return _kernels.patch_project(*self._patches(points, x, segment))[1]

    def contact(
        self, scheme: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> ContactKinematics:
        found = self._kinematics(scheme, *self._both_states(points, x_n, x, segment))
        return found.combined(self._weights[segment])

    def slip(
        self, measure: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> Slip:
        slip = self._slip(*self._both_states(points, x_n, x, segment))
        return slip.combined(self._weights[segment])

    def adjacent(self, x: Floats) -> None:
        """Return None: at an edge both adjacent patches give the same gap."""
        return None

    def is_at_rim(self, points: ContactPoints, x: Floats, segment: Ints) -> Flags:
        return is_nearest_a_rim(points.of(x), x, self._vertices, segment)

    def beneath(self, x: Floats) -> float:
        """Largest depth of patches below their facets, as on concave surfaces [m]. Local.

        It is estimated by the depth of the control points, which is up to a third larger.
        """
        facets = x[self._vertices]
        normals = area_vectors(facets, self.orientation)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        flat = flat_patch(facets.shape[1]) @ facets
        height = (self._weights[:, 1:, 1:] @ x[self.segments] - flat) @ normals[:, :, None]
        return -float(height.min(initial=0.0))

    def pairs(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Positions of points and control points, shape ``(m, 1+c, 3)`` [m]."""
        pairs: Floats = self._weights[segment] @ super().pairs(points, x, segment)
        return pairs

    def _kinematics(
        self, scheme: str, x_n: Floats, x: Floats, orientation: Floats
    ) -> ContactKinematics:
        """Gap and force for positions of points and control points, ``(m, 1+c, 3)`` [m]."""
        kernel = getattr(_kernels, f"patch_{scheme}")
        return ContactKinematics(*kernel(x_n, x, orientation))

    def _slip(self, x_n: Floats, x: Floats, orientation: Floats) -> Slip:
        """Slip for positions of points and control points, ``(m, 1+c, 3)`` [m]."""
        *values, frame_n, frame = _kernels.patch_slip(x_n, x, orientation)
        return Slip(*values, frame_n=frame_n, frame=frame, orientation=orientation)

    def _patches(self, points: ContactPoints, x: Floats, segment: Ints) -> tuple[Floats, Floats]:
        """Positions of pairs, and orientations of their segments."""
        return self.pairs(points, x, segment), self.orientation.take(segment)


def weights_of_pairs(weights: Floats) -> Floats:
    """Extend weights of nodes in control points, ``(s, c, m)``, by the point of a pair.

    Returns:
        Weights of point and nodes in point and control points, shape ``(s, 1 + c, 1 + m)``.
    """
    s, c, m = weights.shape
    of_pairs: Floats = np.zeros((s, 1 + c, 1 + m))
    of_pairs[:, 0, 0], of_pairs[:, 1:, 1:] = 1.0, weights
    return of_pairs
