"""Rigid obstacles, which bodies cannot enter, and what contact asks of them.

An obstacle takes the place of a surface's segments in a contact pair and has no unknowns. It is
at rest, or moves as a `Motion` says; its methods see it where it was declared, see `frames`.
Planes, spheres and cylinders are in `rigid_shapes`, obstacles made of facets in `rigid_surface`.
"""

from abc import abstractmethod
from copy import copy
from typing import TypeVar

import numpy as np

from dolfinx_nts.common.arguments import as_call
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.model.facing import Facing
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.motion import Motion
from dolfinx_nts.model.trajectories import Trajectories

__all__ = ["Obstacle"]

Self = TypeVar("Self", bound="Obstacle")


class Obstacle(Declaration):
    """Base of all obstacles, which take the place of segments in a contact pair. Local.

    Pairs with an obstacle consist of the node alone, so that gradients have the three entries
    of its position. Methods are for the contact of a stepper. In them positions are those in the
    frame of the obstacle, which is space where it is at rest.

    Attributes:
        dim: Dimension of the space it is in, 3, or 2 where its points have two coordinates.
        motion: How it moves.
        key: Number of each facet, shape ``(f,)``; exact surfaces count as one.
        shortest_passage: Motion in a step below which no node passes the obstacle [m].

    Example:
        >>> floor = nts.RigidPlane(point=(0, 0, 0), normal=(0, 0, 1))
        >>> isinstance(floor, nts.Obstacle)
        True
    """

    motion = Motion()
    key: GlobalInts = np.zeros(1, dtype=np.int64)
    shortest_passage = np.inf
    dim = 3

    def moving(self: Self, motion: Motion) -> Self:
        """Return the same obstacle with a prescribed motion. Local.

        Args:
            motion: Where it is at each time, relative to where it was declared; in the plane with
                translations of two numbers, and rotations about z.

        Returns:
            Another obstacle; this one stays as it is.

        Raises:
            TypeError: ``motion`` is no `Motion`.
            ValueError: Its centre has two coordinates, but the obstacle three.

        Example:
            >>> ball = nts.RigidSphere(centre=(0, 0, 2), radius=1.0)
            >>> ball.moving(nts.Motion(translation=lambda t: (0, 0, -0.1 * t))).name
            'a moving RigidSphere'
        """
        if not isinstance(motion, Motion):
            raise TypeError(
                "expected a Motion, such as Motion(translation=lambda t: (0, 0, -t)), given "
                f"{motion!r}"
            )
        motion.check(self.dim)
        other = copy(self)
        vars(other)["motion"] = motion
        return other

    @property
    def is_of_revolution(self) -> bool:
        """Whether turns about the axis y leave the obstacle of the plane as it is."""
        return False

    @property
    def name(self) -> str:
        """Kind of the obstacle, for messages."""
        return f"a {'' if self.motion.is_rest else 'moving '}{type(self).__name__}"

    def __repr__(self) -> str:
        """Arguments that define the surface, and its motion, in one line. Local."""
        motion = "" if self.motion.is_rest else f".moving({self.motion!r})"
        return f"{self._declaration()}{motion}"

    def _declaration(self) -> str:
        """Arguments that define the surface, or its number of facets."""
        return as_call(self, num_facets=len(self.key))

    @abstractmethod
    def contact(self, scheme: str, x_n: Floats, x: Floats, segment: Ints) -> ContactKinematics:
        """Evaluate gap and contact force of nodes in a step, as the kernels do.

        Args:
            scheme: ``"conserving"``, ``"midpoint"`` or ``"static"``.
            x_n: Positions at t_n, shape ``(m, 3)`` [m].
            x: Positions at t_{n+1}, shape ``(m, 3)`` [m].
            segment: Facet of each node, shape ``(m,)``.

        Returns:
            The kinematics of the nodes alone, d = 3.
        """

    @abstractmethod
    def slip(self, x_n: Floats, x: Floats, segment: Ints) -> Slip:
        """Evaluate slip of nodes in a step, as the kernel does.

        Args:
            x_n: Positions at t_n, shape ``(m, 3)`` [m].
            x: Positions at t_{n+1}, shape ``(m, 3)`` [m].
            segment: Facet of each node, shape ``(m,)``.

        Returns:
            The slip of the nodes alone, d = 3.
        """

    @abstractmethod
    def find(
        self, x: Floats, current: Ints, slack: float, reach: float, facing: Facing
    ) -> tuple[Ints, Floats]:
        """Find the facet that each node faces.

        Args:
            x: Positions, shape ``(m, 3)`` [m].
            current: Facet that each node had last, or -1, shape ``(m,)``.
            slack: How far a node may be beside its last facet and still have it, see
                ``Candidates.pair``.
            reach: Largest gap of interest [m].
            facing: What the nodes face.

        Returns:
            Facet of each node, or -1, and its gap [m], both of shape ``(m,)``.
        """

    def unturned(self, x: Floats, turn: Floats) -> Floats | None:
        """Positions before a turn of the obstacle that leaves its surface where it is.

        Args:
            x: Positions at the end of a step, shape ``(m, 3)`` [m].
            turn: Cayley vector of the turn in the step, as the obstacle sees it, ``(3,)`` [-].

        Returns:
            Those in a frame that does not take part in that turn, in which points go straight;
            None if no turn leaves the surface where it is.
        """
        return None

    @abstractmethod
    def follow(self, x_n: Floats, x: Floats, inside: Ints, facing: Facing) -> Trajectories:
        """Find where nodes go through the obstacle on straight ways.

        Args:
            x_n: Positions at t_n, shape ``(m, 3)`` [m].
            x: Positions at t_{n+1}, shape ``(m, 3)`` [m].
            inside: Facet behind which each node starts, or -1, shape ``(m,)``.
            facing: What the nodes face.
        """

    @abstractmethod
    def near(self, x: Floats, reach: float) -> Ints:
        """Find the nodes that may be within reach of a facet.

        Args:
            x: Positions, shape ``(m, 3)`` [m].
            reach: Distance that counts as near [m].

        Returns:
            Indices of rows of x, among them all nodes within reach.
        """

    @abstractmethod
    def depth(self, x: Floats) -> Floats:
        """Tell how deep points are inside.

        Args:
            x: Positions, shape ``(m, 3)`` [m].

        Returns:
            Distance from the surface, not above 0 outside, shape ``(m,)`` [m].
        """

    def is_at_rim(self, x: Floats, segment: Ints) -> Flags:
        """Whether the edge of a facet that is nearest to a node is a rim. Local.

        Args:
            x: Positions, shape ``(m, 3)`` [m].
            segment: Facet of each node, shape ``(m,)``.

        Returns:
            Flags, shape ``(m,)``; an exact surface has no rim.
        """
        return np.zeros(len(x), dtype=bool)
