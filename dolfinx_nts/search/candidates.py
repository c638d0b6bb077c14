"""Candidates of contact: what contact points may touch, and the search for it.

The global search finds the segments, or facets of a rigid obstacle, that the points of a
rank can reach within a step. The local search chooses one of these candidates for each
point. Contact asks candidates for gap, force and slip of the pairs, and never what they are.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts._kernels import HYSTERESIS
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.model.frames import Frame
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.model.trajectories import Trajectories
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.points import ContactPoints, NodalPoints
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["Candidates", "Search", "sunk_from"]

# Depth relative to the size of a candidate [-] with which points may leave it.
_DEEP = 0.1


class Candidates(ABC):
    """Base of what the contact points of a rank may touch: segments or rigid facets.

    Methods are local unless they say otherwise. In their arguments ``x`` stands for current
    positions of the nodes of the scatter's map, owned and ghost, shape ``(l, 3)`` [m], in the
    frame of the search, and ``segment`` for the number of a candidate for each of ``m`` points,
    shape ``(m,)``. Forces, gradients and tangents that they return are in space.

    Attributes:
        scatter: Brings values to the vertices of the candidates, and forces back.
        segments: Vertices of each candidate, nodes of the map, shape ``(s, k)``; a rigid
            facet has none.
        key: Number of each candidate, the same on any partition of the mesh, ``(s,)``.
        size: Length to which gaps are compared, shape ``(s,)`` [m].
        passage: Relative motion below which no point passes a candidate, shape ``(s,)`` [m].
        may_curve: Whether candidates may be curved, so that straight ways along them leave them.
    """

    scatter: NodalScatter
    segments: Ints
    key: GlobalInts
    size: Floats
    passage: Floats
    may_curve = False

    @abstractmethod
    def find(self, key: GlobalInts) -> Ints:
        """Find the candidate of each key, or -1, of the same shape."""

    @abstractmethod
    def pair(
        self,
        points: ContactPoints,
        x: Floats,
        current: Ints,
        reach: float,
        slack: float = HYSTERESIS,
    ) -> tuple[Ints, Floats]:
        """Choose a candidate for each point, see `cpp/nts/search/local_search.h`.

        Args:
            points: The ``p`` points.
            x: Positions.
            current: Candidates of the last choice or -1, shape ``(p,)``.
            reach: Largest gap of interest [m].
            slack: How far beside its current candidate a point may be and still stays with
                it, in coordinates of the reference segment.

        Returns:
            Candidate or -1, shape ``(p,)``, and gap, NaN without one, ``(p,)`` [m].
        """

    def penalty_forces(
        self,
        points: NodalPoints,
        x: Floats,
        current: Ints,
        reach: float,
        numbers: Ints,
        stiffness: Floats,
    ) -> tuple[Ints, Floats, _kernels.Springs]:
        """Pair nodes and load the springs of those inside, see `cpp/nts/contact/springs.h`.

        Args:
            points: The ``c`` nodes.
            x: Positions.
            current: Candidates of the last choice or -1, shape ``(c,)``.
            reach: Largest gap of interest [m].
            numbers: Numbers of the nodes by which the springs name them, shape ``(c,)``.
            stiffness: Stiffness of each spring, shape ``(c,)`` [N/m].

        Returns:
            Candidate and gap as of `pair`, ``(c,)``; and springs of the nodes with gap < 0.
        """
        segment, gap = self.pair(points, x, current, reach)
        inside = np.flatnonzero(gap < 0).astype(np.int32)
        some, facet, depth = points.take(inside), segment[inside], gap[inside]
        gradient = self.contact("static", some, x, x, facet).gradient
        lambda_N = stiffness[inside] * depth
        shape = len(inside), 1 + self.segments.shape[1], 3
        force = -lambda_N[:, None, None] * gradient.reshape(shape)
        springs = _kernels.Springs(
            numbers[inside],
            self.key[facet],
            some.dofs(self.segments[facet]),
            force,
            lambda_N * depth / 2,
        )
        return segment, gap, springs

    @abstractmethod
    def near(self, points: ContactPoints, x: Floats, reach: float) -> Ints:
        """Find the points within reach [m] of a candidate, and perhaps some others."""

    @abstractmethod
    def gap(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Compute the gap of points to given candidates, shape ``(m,)`` [m]."""

    @abstractmethod
    def contact(
        self, scheme: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> ContactKinematics:
        """Evaluate gap and force of pairs in a step.

        Args:
            scheme: Kernel: ``"conserving"``, ``"midpoint"`` or ``"static"``.
            points: The points.
            x_n: Positions at t_n.
            x: Positions at t_{n+1}.
            segment: Candidate of each point.
        """

    @abstractmethod
    def slip(self, law: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints) -> Slip:
        """Evaluate the slip of pairs in a step; arguments as of `contact`.

        ``law`` is the measure of slip: ``"objective"`` or ``"convective"``.
        """

    @abstractmethod
    def follow(self, points: ContactPoints, x_n: Floats, x: Floats, inside: Ints) -> Trajectories:
        """Find where points go through what they face on straight ways from x_n to x.

        ``inside`` is the candidate behind which each point starts, or -1, shape ``(m,)``.
        """

    @abstractmethod
    def is_at_rim(self, points: ContactPoints, x: Floats, segment: Ints) -> Flags:
        """Whether points are nearest to an edge that belongs to one candidate only."""

    def too_deep(self, segment: Ints) -> Floats:
        """Depth below which points belong to another side of the body, ``(m,)`` [m]."""
        return _kernels.DEEPEST * self.size[segment]

    def independent(
        self, surface: Surface, segment: Ints, eligible: Flags, urgency: GlobalInts
    ) -> Flags:
        """Choose the nodes that may have multipliers at the same time. Collective.

        Args:
            surface: The surface of the nodes.
            segment: Candidate of each node or -1, shape ``(n,)``.
            eligible: Nodes that have a candidate and might be held, shape ``(n,)``.
            urgency: Nodes with a greater one are taken first, shape ``(n,)``.

        Returns:
            Flags, shape ``(n,)``: all eligible nodes, unless nodes are also vertices of the
            segments of others.
        """
        return eligible


def sunk_from(candidates: Candidates, segment: Ints) -> Floats:
    """Depth from which on points that have no candidate any more did not merely leave it. Local.

    A node is not seen deeper than the cell below a segment is thick. Arguments are those of
    `Candidates`; shape ``(m,)`` [m].
    """
    return np.minimum(_DEEP * candidates.size[segment], candidates.passage[segment])


class Search(ABC):
    """Base of the searches that find the candidates of a pair. Collective.

    Args:
        nodes: Surface whose nodes look for candidates.
        vertices: Vertices of the candidates that this rank offers, local nodes of the space.

    Attributes:
        candidates: The candidates of the last update.
        frame: Frame of the candidates in the present step, in which all positions are given.
        may_move: Whether the frame may be another one than space.
        num_searches: How often candidates were sent between ranks.
        sunk: Depth up to which nodes that started inside still face segments [m], see `start.py`.
    """

    candidates: Candidates
    frame = Frame()
    may_move = False
    num_searches = 0
    sunk = 0.0

    def __init__(self, nodes: Surface, vertices: Ints) -> None:
        self._nodes, self._vertices = nodes, vertices
        self._comm: MPI.Comm = nodes.V.mesh.comm

    def begin(self, t_n: float, t: float) -> None:  # noqa: B027 (segments move by unknowns)
        """Go to the frame of a step from t_n to t [s]. Local."""

    @abstractmethod
    def update(self, x: Floats, reach: float) -> tuple[Candidates, bool]:
        """Find candidates among which is everything within reach of a node. Collective.

        Args:
            x: Positions of the local nodes of the space, owned and ghost, ``(l, 3)`` [m].
            reach: Distance from a node that is covered [m].

        Returns:
            The candidates, and whether they are others than last time.
        """

    @property
    def rows(self) -> tuple[Ints, Ints]:
        """Local nodes of the space that are this rank's nodes and vertices. Local."""
        return self._nodes.nodes, self._vertices

    def is_near(self, x: Floats, reach: float) -> bool:
        """Whether a node of this rank may be within reach of a candidate. Local.

        Arguments are those of `update`, x in space.
        """
        return True

    def positions(self, x: Floats) -> tuple[Floats, Floats]:
        """Positions of this rank's nodes and vertices, for `approach`; x as of `update`. Local."""
        nodes, vertices = self.rows
        return x[nodes], x[vertices]

    def per_area(self, force: Floats, area: Floats) -> Floats:
        """Convert forces of multipliers into tractions at the nodes of the surface. Collective.

        Args:
            force: Forces, shape ``(n,)`` or ``(n, 3)`` [N].
            area: Areas on which they act, shape ``(n,)`` [m^2].

        Returns:
            Forces per reference area, of the same shape [Pa].
        """
        return self._nodes.per_area(force, area)

    def approach(self, x: Floats, before: Sequence[Floats]) -> float:
        """Bound on how much any node has come nearer to a candidate [m]. Collective.

        ``before`` are the `positions` from which the motion counts, ``x`` is as of `update`.
        """
        ways = zip(self.rows, before, strict=True)
        moved = [_kernels.farthest(x.take(rows, axis=0), there) for rows, there in ways]
        # A node and a vertex of different ranks may approach each other.
        return sum(reductions.largest(self._comm, moved))

    def way(self, x: Floats, way: float) -> float:
        """Bound on the ways of nodes and of the frame where they are in a step [m]. Collective.

        Args:
            x: Positions of the local nodes at its end in space, shape ``(l, 3)`` [m].
            way: Bound on the ways of the nodes, the same on all ranks [m].
        """
        if not self.frame.moves:
            return way
        return max(
            way, reductions.largest(self._comm, float(self.frame.displacement(x).max(initial=0.0)))
        )

    @abstractmethod
    def serialize(self, archive: Archive, name: str) -> None:
        """Serialize where the candidates were found, under a name. Collective."""
