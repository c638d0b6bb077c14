"""Segments of a deformable surface as candidates."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts._kernels import HYSTERESIS
from dolfinx_nts.common.arrays import Array, Flags, Floats, GlobalInts, Ints
from dolfinx_nts.model.kinematics import ContactKinematics, ConvectiveSlip, Slip
from dolfinx_nts.model.obstacles.adjacent_facets import AdjacentFacets
from dolfinx_nts.model.obstacles.rims import is_nearest_a_rim
from dolfinx_nts.model.obstacles.trajectories import Trajectories, passages
from dolfinx_nts.search.candidates import Candidates, mean_gaps
from dolfinx_nts.search.points import ContactPoints, NodalPoints
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["FoundSegments", "SegmentCandidates"]


class FoundSegments(NamedTuple):
    """Segments within the search radius of this rank's points.

    Attributes:
        scatter: Map of the nodes that the segments need.
        vertices: Vertices in Basix order, nodes of the map, shape ``(s, k)``.
        orientation: +1 where a_1 x a_2 points out of the body, otherwise -1, ``(s,)``.
        key: Number of each segment, the same on any partition, ascending, ``(s,)``.
        size: Current diameters, shape ``(s,)`` [m].
        thickness: Heights of the cells below the segments, ``(s,)`` [m, reference].
        weights: Weights of the nodes on and around each smooth segment in its control points, shape
            ``(s, c, k)`` [-]; None for flat segments.
        rise: Weights of the same nodes in the vector from the mean of each facet to the mean of
            its patch, shape ``(s, k)`` [-]; None where it is not needed.
        in_dents: Whether points below concave edges keep a segment, see `GlobalSearch`.
    """

    scatter: NodalScatter
    vertices: Ints
    orientation: Floats
    key: GlobalInts
    size: Floats
    thickness: Floats
    weights: Floats | None = None
    rise: Floats | None = None
    in_dents: bool = False


class SegmentCandidates(Candidates):
    """Segments of a deformable surface near the points of this rank.

    Args:
        found: The segments.
        first: Offsets of the groups of segments, shape ``(g + 1,)``. The search of a point is
            restricted to one group (`Facing`). None for one group.

    Attributes:
        orientation: +1 where a_1 x a_2 points out of the body, otherwise -1, shape ``(s,)``.
    """

    def __init__(self, found: FoundSegments, first: Ints | None = None) -> None:
        self.scatter, self.segments, self.orientation, self.key = found[:4]
        self.size, self._thickness = found[4:6]
        self.passage = passages(self.size, self._thickness)
        self._sunk: Floats = np.zeros(1 if first is None else len(first) - 1)
        self._adjacent = AdjacentFacets(self.segments, self.orientation, first)
        self._kernel = _kernels.Segments(self.segments, self.orientation, self.key, first)
        self._kernel.hold_in_dents(found.in_dents)

    @property
    def initial_depth(self) -> Floats:
        """Depth up to which initially penetrating points get segments, by group, ``(g,)`` [m]."""
        return self._sunk

    @initial_depth.setter
    def initial_depth(self, depth: Floats) -> None:
        self._sunk = depth
        self._kernel.sink(depth)

    @property
    def of_segments(self) -> tuple[Floats, GlobalInts, Floats, Floats]:
        """Orientation, key, size and thickness of the segments, as in `FoundSegments`."""
        return self.orientation, self.key, self.size, self._thickness

    def find(self, key: GlobalInts) -> Ints:
        return self._kernel.find(key)

    def pair(
        self,
        points: ContactPoints,
        x: Floats,
        current: Ints,
        reach: float,
        slack: float = HYSTERESIS,
    ) -> tuple[Ints, Floats]:
        found = self._choose(points, x, current, reach, slack)
        return found[0], found[2]

    def penalty_forces(
        self,
        points: NodalPoints,
        x: Floats,
        current: Ints,
        reach: float,
        numbers: Ints,
        stiffness: Callable[[Floats], Floats],
        start: Array | None = None,
        slack: float = HYSTERESIS,
        begin_at: Floats | float = 0.0,
    ) -> tuple[Ints, Floats, _kernels.Springs]:
        segment, xi, gap, normal = self._choose(points, x, current, reach, slack)
        if start is not None:
            gap = mean_gaps(gap, start)
        gap = gap - begin_at
        found = segment, xi, gap, normal, self.segments, self.key
        springs = _kernels.penalty_forces(numbers, points.nodes, *found, stiffness(gap))
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
        """Search radius of each group, ``(g,)``, from one radius or one per group [m]."""
        return reach

    def near(self, points: ContactPoints, x: Floats, reach: float) -> Ints:
        return self._kernel.near(points.of(x), reach, x)

    def gap(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        x_pair, orientation = self.pairs(points, x, segment), self.orientation.take(segment)
        return _kernels.project(x_pair, orientation)[1]

    def contact(
        self, scheme: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> ContactKinematics:
        kernel = getattr(_kernels, f"contact_{scheme}")
        return ContactKinematics(*kernel(*self._both_states(points, x_n, x, segment)))

    def slip(
        self, measure: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> Slip:
        pairs = self._both_states(points, x_n, x, segment)
        kernel, kind = {
            "objective": (_kernels.slip, Slip),
            "convective": (_kernels.convective_slip, ConvectiveSlip),
        }[measure]
        *values, frame_n, frame = kernel(*pairs)
        return kind(*values, frame_n=frame_n, frame=frame, orientation=pairs[2])

    def adjacent(self, x: Floats) -> tuple[AdjacentFacets, Floats] | None:
        return self._adjacent, x

    def follow(self, points: ContactPoints, x_n: Floats, x: Floats, inside: Ints) -> Trajectories:
        paths = points.of(x_n), points.of(x), self._own_rows(points), inside, x_n, x
        return Trajectories(*self._kernel.follow(*paths, *points.facing.arguments))

    def _own_rows(self, points: ContactPoints) -> Ints:
        """Node of each point as a vertex of segments, or -1, shape ``(p,)``."""
        return np.full(len(points.facing.numbers), -1, dtype=np.int32)

    def is_at_rim(self, points: ContactPoints, x: Floats, segment: Ints) -> Flags:
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
