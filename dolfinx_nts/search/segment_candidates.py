"""Segments of a deformable surface as candidates."""

import numpy as np
from basix import CellType, topology

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.model.kinematics import ContactKinematics, ConvectiveSlip, Slip
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.points import ContactPoints, NodalPoints
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["SegmentCandidates"]

# Vertices at the ends of each edge, by the number of vertices of a segment.
_EDGES = {
    len(topology(cell)[0]): topology(cell)[1]
    for cell in (CellType.triangle, CellType.quadrilateral)
}


class SegmentCandidates:
    """Segments within reach of this rank's points, see `Candidates`.

    Args:
        scatter: Map of the nodes that the segments need.
        segments: Vertices in Basix order, nodes of the map, ``(s, k)``.
        orientation: +1 where a_1 x a_2 points out of the body, otherwise
            -1, shape ``(s,)``.
        key: Number of each segment on any partition, ascending, ``(s,)``.
        size: Current diameters, shape ``(s,)`` [m].

    Attributes:
        scatter, segments, orientation, key, size: The arguments.
    """

    def __init__(
        self,
        scatter: NodalScatter,
        segments: Ints,
        orientation: Floats,
        key: GlobalInts,
        size: Floats,
    ) -> None:
        """Hand the segments over to the kernel that pairs points with them."""
        self.scatter, self.segments, self.orientation = scatter, segments, orientation
        self.key, self.size = key, size
        self._kernel = _kernels.Segments(segments, orientation, key)

    def find(self, key: GlobalInts) -> Ints:
        """Segment of each key or -1, see `Candidates.find`."""
        return self._kernel.find(key)

    def pair(
        self,
        points: ContactPoints,
        x: Floats,
        current: Ints,
        reach: float,
        slack: float = _kernels.HYSTERESIS,
    ) -> tuple[Ints, Floats]:
        """Choose a segment for each point, see `Candidates.pair`."""
        found = self._choose(points, x, current, reach, slack)
        return found[0], found[2]

    def penalty_forces(
        self,
        nodes: Ints,
        x: Floats,
        current: Ints,
        reach: float,
        numbers: Ints,
        stiffness: Floats,
    ) -> tuple[Ints, Floats, _kernels.Springs]:
        """Springs of nodes inside, see `Candidates.penalty_forces`."""
        segment, xi, gap, normal = self._choose(
            NodalPoints(nodes), x, current, reach, _kernels.HYSTERESIS
        )
        springs = _kernels.penalty_forces(
            numbers, nodes, segment, xi, gap, normal, self.segments, self.key, stiffness
        )
        return segment, gap, springs

    def _choose(
        self, points: ContactPoints, x: Floats, current: Ints, reach: float, slack: float
    ) -> tuple[Ints, Floats, Floats, Floats]:
        """Segment, convective coordinates, gap and normal of each point."""
        return self._kernel.pair(points.of(x), current, slack, reach, x)

    def near(self, points: ContactPoints, x: Floats, reach: float) -> Ints:
        """Points in the boxes around the segments, see `Candidates.near`."""
        return self._kernel.near(points.of(x), reach, x)

    def gap(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Gap of points to given segments, see `Candidates.gap`."""
        x_pair, orientation = self._pairs(points, x, segment), self.orientation.take(segment)
        return _kernels.project(x_pair, orientation)[1]

    def contact(
        self, scheme: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> ContactKinematics:
        """Gap and force of pairs, see `Candidates.contact`."""
        kernel = getattr(_kernels, f"contact_{scheme}")
        return ContactKinematics(*kernel(*self._both_states(points, x_n, x, segment)))

    def slip(self, law: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints) -> Slip:
        """Slip of pairs, see `Candidates.slip`."""
        pairs = self._both_states(points, x_n, x, segment)
        kernel, kind = {
            "objective": (_kernels.slip, Slip),
            "convective": (_kernels.convective_slip, ConvectiveSlip),
        }[law]
        *values, frame_n, frame = kernel(*pairs)
        return kind(*values, frame_n=frame_n, frame=frame, orientation=pairs[2])

    def restrict(self, points: ContactPoints, free: Floats) -> Floats | None:
        """Which displacements are unknown, see `Candidates.restrict`."""
        free = self.scatter.forward(free)
        all_free = bool(free[self.segments].all() and points.of(free).all())
        return None if all_free else free

    def beside(self, points: ContactPoints, x: Floats, segment: Ints) -> Flags:
        """Whether points have left their segments sideways, see `Candidates.beside`."""
        edges = self.segments[:, _EDGES[self.segments.shape[1]]]
        begin, end = np.moveaxis(x[edges[segment]], 2, 0)
        along, r = end - begin, points.of(x)[:, None] - begin
        square = np.einsum("mei,mei->me", along, along)
        part = np.einsum("mei,mei->me", r, along) / np.where(square > 0, square, 1)
        distance = np.linalg.norm(r - np.clip(part, 0, 1)[..., None] * along, axis=2)
        nearest = np.sort(edges[segment, distance.argmin(axis=1)])
        shared = (np.sort(edges.reshape(-1, 2))[:, None] == nearest).all(axis=2).sum(axis=0) > 1
        depth = -self.gap(points, x, segment)
        flags: Flags = (depth < _kernels.DEEPEST * self.size[segment]) & ~shared
        return flags

    def independent(
        self, surface: Surface, segment: Ints, eligible: Flags, urgency: GlobalInts
    ) -> Flags:
        """All eligible nodes, as no node is a vertex, see `Candidates.independent`."""
        return eligible

    def _pairs(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Positions of points and vertices, shape ``(m, 1+k, 3)`` [m]."""
        pairs = np.empty((len(segment), 1 + self.segments.shape[1], 3))
        pairs[:, 0], pairs[:, 1:] = (
            points.of(x),
            x.take(self.segments.take(segment, axis=0), axis=0),
        )
        return pairs

    def _both_states(
        self, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> tuple[Floats, Floats, Floats]:
        pairs_n, pairs = (self._pairs(points, y, segment) for y in (x_n, x))
        return pairs_n, pairs, self.orientation.take(segment)
