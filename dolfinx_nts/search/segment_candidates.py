"""Segments of a deformable surface as candidates."""

from typing import NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts._kernels import HYSTERESIS
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.model.kinematics import ContactKinematics, ConvectiveSlip, Slip
from dolfinx_nts.model.obstacles.adjacent_facets import AdjacentFacets
from dolfinx_nts.model.obstacles.rims import is_nearest_a_rim
from dolfinx_nts.model.obstacles.trajectories import Trajectories, passages
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.search.points import ContactPoints, NodalPoints
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["FoundSegments", "SegmentCandidates"]


class FoundSegments(NamedTuple):
    """What a search tells of the segments within reach of this rank's points.

    Attributes:
        scatter: Map of the nodes that the segments need.
        vertices: Vertices in Basix order, nodes of the map, shape ``(s, k)``.
        orientation: +1 where a_1 x a_2 points out of the body, otherwise -1, ``(s,)``.
        key: Number of each segment, the same on any partition, ascending, ``(s,)``.
        size: Current diameters, shape ``(s,)`` [m].
        thickness: Heights of the cells below the segments, ``(s,)`` [m, reference].
        weights: Of the nodes of smooth segments, their vertices and those around, in control
            points, shape ``(s, c, k)``; None of flat segments.
        rise: Of the same in the way from the mean of each facet to that of its patch, shape
            ``(s, k)``; None where nothing asks for it.
    """

    scatter: NodalScatter
    vertices: Ints
    orientation: Floats
    key: GlobalInts
    size: Floats
    thickness: Floats
    weights: Floats | None = None
    rise: Floats | None = None


class SegmentCandidates(Candidates):
    """Segments of a deformable surface within reach of this rank's points, see `Candidates`.

    Args:
        found: The segments.
        first: Where groups of them begin, and their number, shape ``(g + 1,)``: a point looks
            among those of one group, see `Facing`; None: there is one group.

    Attributes:
        orientation: As of `FoundSegments`.
    """

    def __init__(self, found: FoundSegments, first: Ints | None = None) -> None:
        """Hand the segments over to the kernel of the local search."""
        self.scatter, self.segments, self.orientation, self.key = found[:4]
        self.size, self._thickness = found[4:6]
        self.passage = passages(self.size, self._thickness)
        self._sunk: Floats = np.zeros(1 if first is None else len(first) - 1)
        self._adjacent = AdjacentFacets(self.segments, self.orientation, first)
        self._kernel = _kernels.Segments(self.segments, self.orientation, self.key, first)

    @property
    def sunk(self) -> Floats:
        """Depth of points that started inside each group, shape ``(g,)`` [m]."""
        return self._sunk

    @sunk.setter
    def sunk(self, depth: Floats) -> None:
        self._sunk = depth
        self._kernel.sink(depth)

    @property
    def of_segments(self) -> tuple[Floats, GlobalInts, Floats, Floats]:
        """Orientation, key, size and thickness of the segments, as of `FoundSegments`."""
        return self.orientation, self.key, self.size, self._thickness

    def find(self, key: GlobalInts) -> Ints:
        """Find the segment of each key, see `Candidates.find`."""
        return self._kernel.find(key)

    def pair(
        self,
        points: ContactPoints,
        x: Floats,
        current: Ints,
        reach: float,
        slack: float = HYSTERESIS,
    ) -> tuple[Ints, Floats]:
        """Choose a segment for each point, see `Candidates.pair`."""
        found = self._choose(points, x, current, reach, slack)
        return found[0], found[2]

    def penalty_forces(
        self,
        points: NodalPoints,
        x: Floats,
        current: Ints,
        reach: float,
        numbers: Ints,
        stiffness: Floats,
    ) -> tuple[Ints, Floats, _kernels.Springs]:
        """Load the springs of nodes inside, see `Candidates.penalty_forces`."""
        segment, xi, gap, normal = self._choose(points, x, current, reach, HYSTERESIS)
        springs = _kernels.penalty_forces(
            numbers, points.nodes, segment, xi, gap, normal, self.segments, self.key, stiffness
        )
        return segment, gap, springs

    def _choose(
        self, points: ContactPoints, x: Floats, current: Ints, reach: float, slack: float
    ) -> tuple[Ints, Floats, Floats, Floats]:
        """Segment, convective coordinates, gap and normal of each point."""
        facing, of_groups = points.facing.arguments, self._of_groups(reach)
        return self._kernel.pair(
            points.of(x), current, slack, of_groups, x, *facing, self._thickness
        )

    def _of_groups(self, reach: float) -> Floats | float:
        """Reach of all groups, or of each, shape ``(g,)`` [m]."""
        return reach

    def near(self, points: ContactPoints, x: Floats, reach: float) -> Ints:
        """Find the points near the boxes around the segments, see `Candidates.near`."""
        return self._kernel.near(points.of(x), reach, x)

    def gap(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Compute the gap of points to given segments, see `Candidates.gap`."""
        x_pair, orientation = self.pairs(points, x, segment), self.orientation.take(segment)
        return _kernels.project(x_pair, orientation)[1]

    def contact(
        self, scheme: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> ContactKinematics:
        """Evaluate gap and force of pairs, see `Candidates.contact`."""
        kernel = getattr(_kernels, f"contact_{scheme}")
        return ContactKinematics(*kernel(*self._both_states(points, x_n, x, segment)))

    def slip(self, law: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints) -> Slip:
        """Evaluate the slip of pairs, see `Candidates.slip`."""
        pairs = self._both_states(points, x_n, x, segment)
        kernel, kind = {
            "objective": (_kernels.slip, Slip),
            "convective": (_kernels.convective_slip, ConvectiveSlip),
        }[law]
        *values, frame_n, frame = kernel(*pairs)
        return kind(*values, frame_n=frame_n, frame=frame, orientation=pairs[2])

    def adjacent(self, x: Floats) -> tuple[AdjacentFacets, Floats] | None:
        """Take the segments of the group of each one, see `Candidates.adjacent`."""
        return self._adjacent, x

    def follow(self, points: ContactPoints, x_n: Floats, x: Floats, inside: Ints) -> Trajectories:
        """Find where points go through segments, see `Candidates.follow`."""
        ways = points.of(x_n), points.of(x), self._own_rows(points), inside, x_n, x
        return Trajectories(*self._kernel.follow(*ways, *points.facing.arguments))

    def _own_rows(self, points: ContactPoints) -> Ints:
        """Vertex of the segments that each point is, or -1, shape ``(p,)``."""
        return np.full(len(points.facing.numbers), -1, dtype=np.int32)

    def is_at_rim(self, points: ContactPoints, x: Floats, segment: Ints) -> Flags:
        """Whether points are nearest to the rim of the surface, see `Candidates.is_at_rim`."""
        return is_nearest_a_rim(points.of(x), x, self.segments, segment)

    def pairs(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Positions of points and vertices, shape ``(m, 1+k, 3)`` [m]."""
        return _kernels.with_vertices(points.of(x), x, self.segments, segment)

    def _both_states(
        self, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> tuple[Floats, Floats, Floats]:
        """Positions of pairs at t_n and t_{n+1}, and orientations of their segments."""
        pairs_n, pairs = (self.pairs(points, y, segment) for y in (x_n, x))
        return pairs_n, pairs, self.orientation.take(segment)
