"""Candidates of contact: what contact points may touch, and the search for it.

The global search finds the segments, or facets of a rigid obstacle, that the
points of a rank can reach within a step. The local search chooses one of these
candidates for each point. Contact asks candidates for gap, force and slip of
the pairs, and never what they are.
"""

from collections.abc import Sequence
from typing import Protocol

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.points import ContactPoints
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["Candidates", "Search"]


class Candidates(Protocol):
    """Segments or facets within reach of the contact points of a rank. Local.

    ``x`` stands for positions of the nodes of the scatter's map, owned and
    ghost, shape ``(l, 3)`` [m]; ``segment`` for the numbers of chosen
    candidates, one a point, or -1.
    """

    @property
    def scatter(self) -> NodalScatter:
        """Brings values to the vertices of the candidates, and forces back."""

    @property
    def segments(self) -> Ints:
        """Vertices of each candidate, nodes of the map, shape ``(s, k)``."""

    @property
    def key(self) -> GlobalInts:
        """Number of each candidate on any partition of the mesh, ``(s,)``."""

    @property
    def size(self) -> Floats:
        """Length with which gaps are compared, shape ``(s,)`` [m]."""

    def find(self, key: GlobalInts) -> Ints:
        """Candidate of each key or -1, of the same shape."""

    def pair(
        self,
        points: ContactPoints,
        x: Floats,
        current: Ints,
        reach: float,
        slack: float = _kernels.HYSTERESIS,
    ) -> tuple[Ints, Floats]:
        """Choose a candidate for each point, see `cpp/nts/search/local_search.h`.

        Args:
            points: The points.
            x: Positions.
            current: Candidates of the last choice or -1, shape ``(p,)``.
            reach: Largest gap of interest [m].
            slack: By how much a point may be beside its current candidate
                and stays with it, relative to half a quadrilateral, or to
                a triangle.

        Returns:
            Candidate or -1, shape ``(p,)``, and gap [m], NaN without.
        """

    def penalty_forces(
        self,
        nodes: Ints,
        x: Floats,
        current: Ints,
        reach: float,
        numbers: Ints,
        stiffness: Floats,
    ) -> tuple[Ints, Floats, _kernels.Springs]:
        """Springs of nodes that `pair` finds inside, see `cpp/nts/contact/springs.h`.

        Args:
            nodes: The nodes, shape ``(c,)``.
            x: As of `pair`, and so are ``current`` and ``reach``.
            current: Shape ``(c,)``.
            reach: [m].
            numbers: By which the springs call the nodes, shape ``(c,)``.
            stiffness: Of each spring, shape ``(c,)`` [N/m].

        Returns:
            Candidate and gap, shape ``(c,)``; springs of nodes with gap < 0.
        """

    def near(self, points: ContactPoints, x: Floats, reach: float) -> Ints:
        """Positions of the points that are within reach of a candidate, at least."""

    def gap(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Gap of points to given candidates, shape ``(m,)`` [m]."""

    def contact(
        self, scheme: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> ContactKinematics:
        """Gap and force of pairs between two states.

        Args:
            scheme: Kernel: ``"conserving"``, ``"midpoint"`` or ``"static"``.
            points: The points.
            x_n: Positions at t_n.
            x: Positions at t_{n+1}.
            segment: Candidate of each point, shape ``(m,)``.
        """

    def slip(self, law: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints) -> Slip:
        """Slip of pairs between two states.

        Args:
            law: Measure of slip: ``"objective"`` or ``"convective"``.
            points: As of `contact`, and so are the others.
            x_n: Positions at t_n.
            x: Positions at t_{n+1}.
            segment: Shape ``(m,)``.
        """

    def restrict(self, points: ContactPoints, free: Floats) -> Floats | None:
        """Which displacements are unknown, at the nodes of the map. Collective.

        Args:
            points: The points.
            free: 1 where the displacement of an owned node is unknown,
                otherwise 0, shape ``(n, 3)``.

        Returns:
            The same at all nodes of the map, shape ``(l, 3)``; None if all
            of the points and the candidates are unknown.
        """

    def beside(self, points: ContactPoints, x: Floats, segment: Ints) -> Flags:
        """Whether points have left their candidates sideways, over a rim of the surface."""

    def independent(
        self, surface: Surface, segment: Ints, eligible: Flags, urgency: GlobalInts
    ) -> Flags:
        """Nodes that may have multipliers at the same time. Collective.

        Args:
            surface: The surface of the nodes.
            segment: Candidate of each node or -1, shape ``(n,)``.
            eligible: Nodes that have a candidate and might be held, ``(n,)``.
            urgency: Nodes with a greater one are taken first, ``(n,)``.

        Returns:
            Flags, shape ``(n,)``: all eligible nodes, unless they are also
            vertices of the segments of others.
        """


class Search(Protocol):
    """Finds the candidates of a pair of surfaces. Collective, as all its methods.

    Attributes:
        num_searches: How often they were searched.
    """

    num_searches: int

    def update(self, x: Floats, reach: float) -> tuple[Candidates, bool]:
        """Candidates among which is everything within reach of a point.

        Args:
            x: Positions of the local nodes of the space, owned and ghost,
                shape ``(l, 3)`` [m].
            reach: Distance from a point that is covered [m].

        Returns:
            The candidates, and whether they are others than last time.
        """

    @property
    def candidates(self) -> Candidates:
        """The candidates of the last update. Local."""

    def positions(self, x: Floats) -> tuple[Floats, Floats]:
        """Positions of this rank's nodes and vertices, for `approach`. Local."""

    def approach(self, x: Floats, before: Sequence[Floats]) -> float:
        """By how much any point may be closer to a candidate than it was [m].

        Args:
            x: As of `update`.
            before: `positions` then.
        """

    def serialize(self, archive: Archive, name: str) -> None:
        """Serialize where the candidates were found."""
