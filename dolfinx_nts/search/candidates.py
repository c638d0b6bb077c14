"""Interface of contact candidates and of the global search.

The global search finds the segments, or facets of a rigid obstacle, within the search radius of the
points of a rank. The local search chooses one of these candidates for each point. Candidates
evaluate gap, force and slip of the pairs.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts._kernels import HYSTERESIS
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Array, Flags, Floats, GlobalInts, Ints, indices
from dolfinx_nts.model.frames import Frame
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.obstacles.adjacent_facets import AdjacentFacets
from dolfinx_nts.model.obstacles.trajectories import Trajectories
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.points import ContactPoints, NodalPoints
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["Candidates", "Search", "contact_normals", "lost_depth", "mean_gaps", "too_deep"]

# Depth relative to the size of a candidate [-] up to which points may leave it.
_DEEP = 0.1


class Candidates(ABC):
    """Base class of the segments or rigid facets that the contact points of a rank may touch.

    Methods are local unless they say otherwise. Common arguments: ``x`` are current positions of
    the nodes of the map of the scatter, owned and ghost, in the frame of the search, shape
    ``(l, 3)`` [m]; ``segment`` is the candidate of each of ``m`` points, shape ``(m,)``. Returned
    forces, gradients and tangents are in space.

    Attributes:
        scatter: Scatter of values to the vertices of the candidates, and of forces back.
        segments: Vertices of each candidate, nodes of the map, shape ``(s, k)``; a rigid
            facet has none.
        key: Partition-independent number of each candidate, shape ``(s,)``.
        size: Reference length of gaps, shape ``(s,)`` [m].
        passage: Relative displacement below which no point passes through a candidate, shape
            ``(s,)`` [m].
        may_curve: Whether candidates may be curved, so that a straight path along them leaves
            them.
    """

    scatter: NodalScatter
    segments: Ints
    key: GlobalInts
    size: Floats
    passage: Floats
    may_curve = False

    @property
    def initial_depth(self) -> Floats:
        """Depth up to which initially penetrating points get candidates, by group, ``(g,)`` [m]."""
        return np.zeros(1)

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
            current: Current candidates or -1, shape ``(p,)``.
            reach: Search radius [m].
            slack: Distance outside the current candidate within which a point keeps it, in
                coordinates of the reference segment.

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
        stiffness: Callable[[Floats], Floats],
        start: Array | None = None,
        slack: float = HYSTERESIS,
        begin_at: Floats | float = 0.0,
    ) -> tuple[Ints, Floats, _kernels.Springs]:
        """Pair nodes and evaluate the springs of penetrating ones, see `cpp/nts/contact/springs.h`.

        Args:
            points: The ``c`` nodes; a node that is equally near to several candidates occurs once
                for each.
            x: Positions.
            current: Current candidates or -1, shape ``(c,)``.
            reach: Search radius [m].
            numbers: Numbers of the nodes in the returned springs, shape ``(c,)``.
            stiffness: Returns the secant stiffness of each spring, shape ``(c,)`` [N/m], for gaps
                minus ``begin_at``, shape ``(c,)`` [m].
            start: Offsets of the occurrences of each node, shape ``(m + 1,)``; None if all nodes
                occur once.
            slack: See `pair`.
            begin_at: Gaps at which springs begin, shape ``(c,)`` [m].

        Returns:
            Candidate as for `pair`; gap minus ``begin_at``, averaged over the occurrences of a
            node, ``(c,)`` [m]; and springs of the nodes where this gap is negative, with the
            energies of linear springs of the secant stiffness.
        """
        segment, gap = self.pair(points, x, current, reach, slack)
        if start is not None:
            gap = mean_gaps(gap, start)
        gap = gap - begin_at
        inside = indices(gap < 0)
        some, facet, depth = points.take(inside), segment[inside], gap[inside]
        gradient = self.contact("static", some, x, x, facet).gradient
        lambda_N = stiffness(gap)[inside] * depth
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
        """Indices of points, at least of those within the search radius [m] of a candidate."""

    @abstractmethod
    def gap(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Gap of points to given candidates, shape ``(m,)`` [m]."""

    @abstractmethod
    def contact(
        self, scheme: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> ContactKinematics:
        """Gap and force of pairs in a step.

        Args:
            scheme: Kernel: ``"conserving"``, ``"midpoint"`` or ``"static"``.
            points: The points.
            x_n: Positions at t_n.
            x: Positions at t_{n+1}.
            segment: Candidate of each point.
        """

    @abstractmethod
    def slip(
        self, measure: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> Slip:
        """Slip of pairs in a step; ``measure`` is ``"objective"`` or ``"convective"``."""

    @abstractmethod
    def follow(self, points: ContactPoints, x_n: Floats, x: Floats, inside: Ints) -> Trajectories:
        """Find intersections of straight paths of points from x_n to x with candidates.

        ``inside`` is the candidate that each point has penetrated at the start, or -1, ``(m,)``.
        """

    def adjacent(self, x: Floats) -> tuple[AdjacentFacets, Floats] | None:
        """Facets with their neighbours, and positions of the vertices, ``(v, 3)`` [m].

        Facets have the numbers of the candidates. None if points never have several candidates.
        """
        return None

    @abstractmethod
    def is_at_rim(self, points: ContactPoints, x: Floats, segment: Ints) -> Flags:
        """Whether the edge nearest to a point is a free edge of the surface."""

    def independent(
        self, surface: Surface, segment: Ints, eligible: Flags, urgency: GlobalInts
    ) -> Flags:
        """Choose nodes that may have multipliers simultaneously. Collective.

        Args:
            surface: The surface of the nodes.
            segment: Candidate of each node or -1, shape ``(n,)``.
            eligible: Flags of nodes with a candidate that may become active, shape ``(n,)``.
            urgency: Priority of each node, shape ``(n,)``.

        Returns:
            Flags, shape ``(n,)``: all eligible nodes, except in self contact.
        """
        return eligible


def contact_normals(
    candidates: Candidates, points: ContactPoints, x: Floats, segment: Ints
) -> Floats:
    """Unit normals of given candidates at points, 0 without projection, ``(m, 3)``. Local."""
    contact = candidates.contact("static", points, x, x, segment)
    normals: Floats = np.nan_to_num(contact.gradient[:, :3])
    return normals


def mean_gaps(gap: Floats, start: Array) -> Floats:
    """Replace the gaps of each node by their mean, see `Candidates.penalty_forces`."""
    counts = np.diff(start)
    means: Floats = np.repeat(np.add.reduceat(gap, start[:-1]) / counts, counts)
    return means


def too_deep(candidates: Candidates, segment: Ints) -> Floats:
    """Depth beyond which a point may belong to another side of the body, ``(m,)`` [m]. Local."""
    deepest = float(candidates.initial_depth.max(initial=0.0))
    depth: Floats = np.maximum(_kernels.DEEPEST * candidates.size[segment], deepest)
    return depth


def lost_depth(candidates: Candidates, segment: Ints) -> Floats:
    """Depth beyond which points without a candidate have passed through their last one. Local.

    It is limited by the height of the cell below a segment. Shape ``(m,)`` [m].
    """
    return np.minimum(_DEEP * candidates.size[segment], candidates.passage[segment])


class Search(ABC):
    """Base class of global searches for the candidates of a pair. Collective.

    Args:
        nodes: Surface of the nodes.
        vertices: Vertices of the candidates on this rank, local nodes of the space.

    Attributes:
        candidates: The candidates of the last update.
        frame: Frame of the candidates in the current step, in which all positions are given.
        may_move: Whether the frame may differ from space.
        was_displaced: Whether the user has set displacements since the last accepted step.
        num_searches: Number of exchanges of candidates between ranks.
        initial_depth: Depth [m] up to which nodes that penetrate initially get segments, see
            `start.py`.
    """

    candidates: Candidates
    frame = Frame()
    may_move = False
    was_displaced = False
    num_searches = 0
    initial_depth = 0.0

    def __init__(self, nodes: Surface, vertices: Ints) -> None:
        self._nodes, self._vertices = nodes, vertices
        self._comm: MPI.Comm = nodes.V.mesh.comm

    def begin(self, t_n: float, t: float) -> None:  # noqa: B027 (segments move by unknowns)
        """Set the frame for a step from t_n to t [s]. Local."""

    @abstractmethod
    def update(self, x: Floats, reach: float) -> tuple[Candidates, bool]:
        """Update the candidates: all segments within the search radius of a node. Collective.

        Args:
            x: Positions of the local nodes of the space, owned and ghost, ``(l, 3)`` [m].
            reach: Largest distance from a node [m].

        Returns:
            The candidates, and whether they have changed.
        """

    @property
    def rows(self) -> tuple[Ints, Ints]:
        """This rank's nodes and vertices of segments, as local nodes of the space. Local."""
        return self._nodes.nodes, self._vertices

    def is_near(self, x: Floats, reach: float) -> bool:
        """Whether points of the surface on this rank may be near a candidate. Collective.

        Args:
            x: Positions of the local nodes of the space, owned and ghost, shape ``(l, 3)`` [m].
            reach: Largest distance that counts as near [m].
        """
        return True

    def positions(self, x: Floats) -> tuple[Floats, Floats]:
        """Positions of nodes and vertices of this rank, for `approach`. Local."""
        nodes, vertices = self.rows
        return x[nodes], x[vertices]

    def per_area(self, force: Floats, facing: Floats, covered: Floats) -> Floats:
        """Convert multiplier forces to tractions at the nodes of the surface. Collective.

        Args:
            force: Forces, shape ``(n,)`` or ``(n, 3)`` [N].
            facing: Fraction of the area of each node that faces the contact, shape ``(n,)`` [-].
            covered: Area covered by segments, shape ``(n,)`` [m^2]; only mortar contact uses it.

        Returns:
            Forces per reference area, of the same shape [Pa].
        """
        return self._nodes.per_area(force, facing * self._nodes.area)

    def approach(self, x: Floats, before: Sequence[Floats]) -> float:
        """Bound on the approach of any node and candidate since earlier positions [m]. Collective.

        ``before`` is the earlier result of `positions`.
        """
        states = zip(self.rows, before, strict=True)
        moved = [_kernels.farthest(x.take(rows, axis=0), there) for rows, there in states]
        # The bound includes nodes and vertices of different ranks.
        return sum(reductions.largest(self._comm, moved))

    def displacement_bound(self, x: Floats, bound: float) -> float:
        """Bound on the displacement of nodes and frame in a step [m]. Collective.

        Args:
            x: Positions of the local nodes at its end in space, shape ``(l, 3)`` [m].
            bound: Bound on the displacement of the nodes, the same on all ranks [m].
        """
        if not self.frame.moves:
            return bound
        return max(
            bound,
            reductions.largest(self._comm, float(self.frame.displacement(x).max(initial=0.0))),
        )

    @abstractmethod
    def serialize(self, archive: Archive, name: str) -> None:
        """Serialize the positions of the last search under a name. Collective."""
