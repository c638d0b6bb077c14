"""Whole facets as candidates of mortar contact."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.search.mortar.whole_facets import linear_functions
from dolfinx_nts.search.points import ContactPoints
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates
from dolfinx_nts.search.smooth.smooth_candidates import weights_of_pairs
from dolfinx_nts.search.smooth.smooth_patches import flat_patch

__all__ = ["FacetCandidates", "distances", "extend_evenly", "outside", "rises"]

# Distance outside a curved facet in reference coordinates [-] up to which it is extrapolated.
# Larger: strongly curved facets are extrapolated too far; smaller: flat facets are used more often.
_OUTSIDE = 0.5
# Least area of the extension of a quadrilateral, per area of its coordinates and relative to its
# centre [-]. Smaller: near a fold points have no projection, and forces of friction are arbitrary;
# larger: fewer points may slide over several segments.
_LEAST_AREA = 0.5
# Kernels of flat facets, and of curved facets and patches, see `Candidates.contact`.
_FLAT: dict[str, Callable[..., Any]] = {
    "conserving": _kernels.contact_conserving,
    "midpoint": _kernels.contact_midpoint,
    "static": _kernels.contact_static,
    "project": _kernels.project,
    "slip": _kernels.slip,
}
_CURVED: dict[str, Callable[..., Any]] = {
    "conserving": _kernels.patch_conserving,
    "midpoint": _kernels.patch_midpoint,
    "static": _kernels.patch_static,
    "project": _kernels.patch_project,
    "slip": _kernels.patch_slip,
}


class FacetCandidates(SegmentCandidates):
    """Segments with the facets to which they belong.

    Segments select the facet of each point. Gap, force and slip are evaluated on the whole facet:
    at degree 2 on the curved facet, see `cpp/nts/geometry/facet.h`, and for smooth surfaces on the
    patch. The patch is shifted to the mean of the flat facet, so that the consistent load of a
    uniform pressure belongs to the facet. Points store the effect of the shifts on gaps, see
    `MortarPoints`.

    Far outside a curved facet its extrapolation is not used. In the methods that evaluate pairs,
    the number of a segment plus the number of all segments denotes the plane through the vertices
    instead, see `of_points`.

    Args:
        found: The segments; with weights for a smooth surface.
        facet_nodes: Nodes on which the facet of each segment depends, shape ``(s, n)``: vertices,
            mid-nodes, and nodes of a patch.

    Attributes:
        facet_nodes: The argument.
        whole: Number of the facet of each segment, shape ``(s,)``.
        weights: Weights of the nodes in the control points of shifted patches, ``(s, c, n)``, or
            None.
        rise: Weights of the nodes in the displacement from the shifted to the actual patches,
            ``(s, n)``, or None.
        has_middles: Whether facets have mid-nodes.
    """

    def __init__(self, found: FoundSegments, facet_nodes: Ints) -> None:
        super().__init__(found)
        self.facet_nodes, self.rise = facet_nodes, found.rise
        (s, k), n = self.segments.shape, facet_nodes.shape[1]
        self.has_middles = found.weights is None and n > k
        self.whole: Ints = np.arange(s, dtype=np.int32)
        # Weights of point and nodes in point and control points: for both numbers of a facet, and
        # for flat facets.
        self._of_pairs: Floats | None = None
        self._of_flat: Floats | None = None
        self.weights: Floats | None = None
        if self.has_middles:
            number = np.unique(facet_nodes, axis=0, return_inverse=True)[1]
            self.whole = number.ravel().astype(np.int32)
            self._of_flat = _among(linear_functions(k), n)
        elif found.weights is not None:
            assert found.rise is not None
            self.weights = found.weights - found.rise[:, None]
            self._of_pairs = weights_of_pairs(self.weights)
            self._of_flat = _among(flat_patch(k), n)
        self.may_curve = self._of_flat is not None
        self._kernels = _CURVED if self.may_curve else _FLAT

    def of_points(self, points: ContactPoints, segment: Ints, states: Sequence[Floats]) -> Ints:
        """Facet of each point, or its plane if the point is far outside in any state. Local.

        Args:
            points: Contact points, ``m`` in number.
            segment: Segment of each point, shape ``(m,)``.
            states: Positions of the local nodes of the space, each of shape ``(l, 3)`` [m].

        Returns:
            Number of the segment, or for its plane that number plus the number of all segments,
            shape ``(m,)``.
        """
        if self._of_flat is None:
            return segment
        outside_facet = np.zeros(len(segment), dtype=bool)
        for x in states:
            # Negated, to include NaN where there is no projection.
            outside_facet |= ~(outside(self, points, x, segment) <= _OUTSIDE)
        return np.where(outside_facet, segment + len(self.segments), segment).astype(np.int32)

    def gap(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        return self.projections(points, x, segment)[1]

    def shortened(self, points: ContactPoints, x: Floats, segment: Ints, rise: Floats) -> Floats:
        """Correction of the gaps of points for the shift of patches, shape ``(m,)`` [m].

        ``rise`` is the displacement of the points from the shifted to the actual patches of their
        own facets, ``(m, 3)`` [m].
        """
        pairs, orientation = self.pairs(points, x, segment), self._sense(segment)
        before = self._kernels["project"](pairs, orientation)[1]
        pairs[:, 0] += rise
        if self.rise is not None:
            pairs[:, 1:] += rises(self.rise, self.facet_nodes, segment % len(self.rise), x)[:, None]
        taken: Floats = self._kernels["project"](pairs, orientation)[1] - before
        return taken

    def contact(
        self, scheme: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> ContactKinematics:
        pairs_n, pairs = (self.pairs(points, y, segment) for y in (x_n, x))
        return self.contact_between(scheme, pairs_n, pairs, segment)

    def contact_between(
        self, scheme: str, pairs_n: Floats, pairs: Floats, segment: Ints
    ) -> ContactKinematics:
        """Kinematics for positions as in `pairs` at both ends of the step, ``(m, 1+n, 3)`` [m]."""
        found = ContactKinematics(*self._kernels[scheme](pairs_n, pairs, self._sense(segment)))
        weights = self._weights(segment)
        return found if weights is None else found.combined(weights)

    def slip(
        self, measure: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> Slip:
        pairs_n, pairs = (self.pairs(points, y, segment) for y in (x_n, x))
        return self.slip_between(pairs_n, pairs, segment)

    def slip_between(self, pairs_n: Floats, pairs: Floats, segment: Ints) -> Slip:
        """Slip for positions as in `pairs` at both ends of the step, ``(m, 1+n, 3)`` [m]."""
        orientation, weights = self._sense(segment), self._weights(segment)
        *values, frame_n, frame = self._kernels["slip"](pairs_n, pairs, orientation)
        slip = Slip(*values, frame_n=frame_n, frame=frame, orientation=orientation)
        return slip if weights is None else slip.combined(weights)

    def pairs(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Positions of points and nodes or control points of facets, ``(m, 1+n, 3)`` [m]."""
        pairs = np.empty((len(segment), 1 + self.facet_nodes.shape[1], 3))
        pairs[:, 0] = points.of(x)
        pairs[:, 1:] = x.take(self.facet_nodes.take(segment, axis=0, mode="wrap"), axis=0)
        weights = self._weights(segment)
        return pairs if weights is None else weights @ pairs

    def projections(self, points: ContactPoints, x: Floats, segment: Ints) -> tuple[Floats, ...]:
        """Project points on the facets of segments. Local.

        Returns convective coordinates, shape ``(m, 2)`` [-], gaps, ``(m,)`` [m], and the other
        results of the kernel.
        """
        pairs = self.pairs(points, x, segment)
        found: tuple[Floats, ...] = self._kernels["project"](pairs, self._sense(segment))
        return found

    def _sense(self, segment: Ints) -> Floats:
        return self.orientation.take(segment, mode="wrap")

    def _weights(self, segment: Ints) -> Floats | None:
        """Weights of points and nodes in the pairs of the kernels; None for the identity."""
        if self._of_flat is None:
            return None
        s = len(self.segments)
        flat = segment >= s
        if self._of_pairs is not None:
            weights: Floats = self._of_pairs[segment % s]
        elif flat.any():
            weights = np.tile(np.eye(1 + self.facet_nodes.shape[1]), (len(segment), 1, 1))
        else:
            return None
        weights[flat] = self._of_flat
        return weights


def extend_evenly(candidates: FacetCandidates, x: Floats, segment: Ints, xi: Floats) -> Flags:
    """Whether flat facets extend to given coordinates with about their own size. Local.

    The extension of edges and triangles is uniform. A quadrilateral is not if it is no
    parallelogram: beyond some distance it folds, and points have no projection.

    Args:
        candidates: The facets.
        x: Positions of nodes, see `Candidates`.
        segment: Facets, shape ``(m,)``.
        xi: Convective coordinates of points, shape ``(m, 2)`` [-].

    Returns:
        Flags, shape ``(m,)``.
    """
    if candidates.segments.shape[1] != 4:
        return np.ones(len(segment), dtype=bool)
    first, right, upper, last = np.moveaxis(
        x[candidates.facet_nodes.take(segment, axis=0, mode="wrap")[:, :4]], 1, 0
    )
    twist = last - right - upper + first

    def area_vectors(at: Floats) -> Floats:
        along, across = right - first + at[:, 1:] * twist, upper - first + at[:, :1] * twist
        normals: Floats = np.cross(along, across)
        return normals

    centre = area_vectors(np.full_like(xi, 0.5))
    there = np.einsum("mi,mi->m", area_vectors(xi), centre)
    flags: Flags = there >= _LEAST_AREA * np.einsum("mi,mi->m", centre, centre)
    return flags


def outside(candidates: FacetCandidates, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
    """Distances of projections outside the reference facets, or NaN, ``(m,)`` [-]."""
    xi, *_ = candidates.projections(points, x, segment)
    return distances(xi, is_triangle=candidates.segments.shape[1] == 3)


def distances(xi: Floats, *, is_triangle: bool) -> Floats:
    """Distances of points outside the reference facet, ``(m,)`` [-]; NaN where xi is NaN."""
    distance: Floats = np.maximum(-xi.min(axis=1), xi.max(axis=1) - 1)
    return np.maximum(distance, xi.sum(axis=1) - 1) if is_triangle else distance


def _among(weights: Floats, n: int) -> Floats:
    """Extend weights of vertices in control points, ``(c, k)``, by zeros for all other nodes."""
    of_nodes = np.zeros((1, len(weights), n))
    of_nodes[0, :, : weights.shape[1]] = weights
    of_pairs: Floats = weights_of_pairs(of_nodes)[0]
    return of_pairs


def rises(weights: Floats, nodes: Ints, facet: Ints, x: Floats) -> Floats:
    """Offsets from the mean of each facet to the mean of its patch, shape ``(m, 3)`` [m].

    ``weights`` and ``nodes`` are of all facets, ``(s, n)``; ``facet`` selects m of them.
    """
    rise: Floats = np.einsum("mn,mni->mi", weights[facet], x[nodes[facet]])
    return rise
