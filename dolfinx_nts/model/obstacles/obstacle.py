"""Interface of rigid obstacles.

An obstacle replaces the segments of a surface in a contact pair and has no unknowns. It is at rest
or has a prescribed `Motion`. Its methods work in the frame of the obstacle, see `frames`. Obstacles
given by a signed distance are in `exact_obstacle`, planes, spheres and cylinders in `rigid_shapes`,
obstacles made of facets in `rigid_surface`.
"""

from abc import abstractmethod
from copy import copy
from functools import cached_property
from inspect import isfunction, signature
from typing import Any, TypeVar

import numpy as np

from dolfinx_nts.common.arguments import as_call, is_of_package, label, with_article
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.obstacles.adjacent_facets import AdjacentFacets
from dolfinx_nts.model.obstacles.facing import Facing
from dolfinx_nts.model.obstacles.motion import Motion
from dolfinx_nts.model.obstacles.trajectories import Trajectories

__all__ = ["Obstacle"]

Self = TypeVar("Self", bound="Obstacle")

# Reserved attributes that an obstacle may set.
_SETTABLE = {"dim", "shortest_passage"}


class Obstacle(Declaration):
    """Base class of obstacles, which replace segments in a contact pair. Local.

    The gap depends on the position of the node alone, so that its gradient has three components.
    Steppers call the methods. Positions are in the frame of the obstacle.

    Attributes:
        dim: Space dimension, 2 or 3.
        motion: Prescribed motion.
        key: Number of each facet, shape ``(f,)``; exact surfaces have one facet.
        shortest_passage: Displacement in a step below which no node passes through the obstacle
            [m]: a quarter of its least thickness, infinite if it has no far side.

    Example:
        >>> floor = nts.RigidPlane(point=(0, 0, 0), normal=(0, 0, 1))
        >>> isinstance(floor, nts.Obstacle)
        True
    """

    motion = Motion()
    key: GlobalInts = np.zeros(1, dtype=np.int64)
    shortest_passage = np.inf
    dim = 3
    _label = ""

    def __init_subclass__(cls, **options: Any) -> None:
        """Check the attributes of a class of a user.

        Raises:
            AttributeError: An attribute hides a method or property of all obstacles.
            TypeError: The class has a signed distance and is not derived from ``ExactObstacle``.
        """
        super().__init_subclass__(**options)
        if is_of_package(cls):
            return
        for name in _RESERVED.intersection(vars(cls)):
            if not _may_replace(name, vars(cls)[name]):
                raise _hides(name, cls)
        known = [base for base in cls.__mro__ if is_of_package(base)]
        if known[0] is Obstacle and hasattr(cls, "distance"):
            raise TypeError(
                f"expected ExactObstacle as the base class of {cls.__name__}, an obstacle by its "
                "signed distance, given Obstacle, which has no contact of its own"
            )

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute of an obstacle during its construction.

        Raises:
            AttributeError: The obstacle is complete, or the name is that of a method or property of
                obstacles.
        """
        if name in _RESERVED and not getattr(self, "_is_complete", False):
            raise _hides(name, type(self))
        super().__setattr__(name, value)

    def moving(self: Self, motion: Motion) -> Self:
        """Copy of the obstacle with a prescribed motion. Local.

        Args:
            motion: Motion relative to the declared position; in the plane with translations of two
                numbers, and rotations about z.

        Returns:
            The copy; this obstacle is unchanged.

        Raises:
            TypeError: ``motion`` is not a `Motion`.
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
    def adjacent(self) -> tuple[AdjacentFacets, Floats] | None:
        """Facets and vertices, see ``Candidates.adjacent``; None for exact surfaces."""
        return None

    @property
    def vertices(self) -> Floats:
        """Vertices of facets, shape ``(p, 3)`` [m]; none of round obstacles."""
        return np.empty((0, 3))

    def nearest(self, x: Floats) -> Floats:
        """Points of a round surface nearest to given points, ``(m, 3)`` [m]; none if it is flat."""
        return np.empty((0, 3))

    @property
    def least_radius(self) -> float:
        """Least radius of convex curvature [m], infinite for planes.

        By default half of the thickness. A user-defined obstacle overrides it if its surface has a
        smaller radius, such as c^2/a at the tip of an ellipsoid with semi-axes a > c.
        """
        return 2 * self.shortest_passage

    @property
    def extent(self) -> float:
        """Least thickness of the obstacle [m], infinite if it has no far side."""
        return 4 * self.shortest_passage

    @property
    def is_of_revolution(self) -> bool:
        """Whether the obstacle is symmetric about the axis y, for axisymmetric meshes."""
        return False

    @property
    def name(self) -> str:
        """Name in messages and columns: the given one, or the kind of the obstacle."""
        kind = type(self).__name__
        return self._label or with_article(kind if self.motion.is_rest else f"moving {kind}")

    def __repr__(self) -> str:
        """Arguments that define the surface, and its motion. Local."""
        motion = "" if self.motion.is_rest else f".moving({self.motion!r})"
        return f"{self._declaration()}{motion}"

    def _declaration(self) -> str:
        """Arguments that define the surface, or its number of facets."""
        return as_call(self, num_facets=len(self.key), **self._named())

    def _named(self) -> dict[str, str]:
        """Argument ``name`` for ``repr``, empty if none was given."""
        return {"name": self._label} if self._label else {}

    def _call_it(self, name: str) -> None:
        """Set the name of the obstacle; an empty text selects the automatic name."""
        self._label = label(name)

    @abstractmethod
    def contact(self, scheme: str, x_n: Floats, x: Floats, segment: Ints) -> ContactKinematics:
        """Gap and contact force of nodes in a step, in the layout of the kernels.

        Args:
            scheme: ``"conserving"``, ``"midpoint"`` or ``"static"``.
            x_n: Positions at t_n, shape ``(m, 3)`` [m].
            x: Positions at t_{n+1}, shape ``(m, 3)`` [m].
            segment: Facet of each node, shape ``(m,)``.

        Returns:
            Kinematics with d = 3.
        """

    @abstractmethod
    def slip(self, x_n: Floats, x: Floats, segment: Ints) -> Slip:
        """Slip of nodes in a step, in the layout of the kernels.

        Args:
            x_n: Positions at t_n, shape ``(m, 3)`` [m].
            x: Positions at t_{n+1}, shape ``(m, 3)`` [m].
            segment: Facet of each node, shape ``(m,)``.

        Returns:
            Slip with d = 3.
        """

    @abstractmethod
    def find(
        self, x: Floats, current: Ints, slack: float, reach: float, facing: Facing
    ) -> tuple[Ints, Floats]:
        """Find the candidate facet of each node.

        Args:
            x: Positions, shape ``(m, 3)`` [m].
            current: Last facet of each node, or -1, shape ``(m,)``.
            slack: Distance outside the last facet within which a node keeps it, see
                ``Candidates.pair``.
            reach: Search radius [m].
            facing: Admissible directions of contact of the nodes.

        Returns:
            Facet of each node, or -1, and its gap [m], both of shape ``(m,)``.
        """

    def unturned(self, x: Floats, turn: Floats) -> Floats | None:
        """Remove the component of the rotation in a step that leaves the surface unchanged.

        Args:
            x: Positions at the end of a step, shape ``(m, 3)`` [m].
            turn: Cayley vector of the rotation in the frame of the obstacle, ``(3,)`` [-].

        Returns:
            Positions in a frame without this rotation, in which points move straight; None if no
            rotation leaves the surface unchanged.
        """
        return None

    @abstractmethod
    def follow(self, x_n: Floats, x: Floats, inside: Ints, facing: Facing) -> Trajectories:
        """Find intersections of straight paths of nodes with the obstacle.

        Args:
            x_n: Positions at t_n, shape ``(m, 3)`` [m].
            x: Positions at t_{n+1}, shape ``(m, 3)`` [m].
            inside: Facet behind which each node starts, or -1, shape ``(m,)``.
            facing: Admissible directions of contact of the nodes.
        """

    @abstractmethod
    def near(self, x: Floats, reach: float) -> Ints:
        """Find the nodes that may be near a facet.

        Args:
            x: Positions, shape ``(m, 3)`` [m].
            reach: Distance that counts as near [m].

        Returns:
            Indices of rows of x, including all nodes within ``reach``.
        """

    @abstractmethod
    def depth(self, x: Floats) -> Floats:
        """Penetration depth of points.

        Args:
            x: Positions, shape ``(m, 3)`` [m].

        Returns:
            Distance from the surface, at most 0 outside, shape ``(m,)`` [m].
        """

    def is_at_rim(self, x: Floats, segment: Ints) -> Flags:
        """Whether the edge of the facet nearest to a node is a free edge. Local.

        Args:
            x: Positions, shape ``(m, 3)`` [m].
            segment: Facet of each node, shape ``(m,)``.

        Returns:
            Flags, shape ``(m,)``, False of exact surfaces.
        """
        return np.zeros(len(x), dtype=bool)


# Names of methods and properties, which user-defined attributes must not hide.
_RESERVED = frozenset(name for name in vars(Obstacle) if name[0] != "_") - _SETTABLE


def _hides(name: str, kind: type[Obstacle]) -> AttributeError:
    """Error for an attribute of a user's class that hides an attribute of all obstacles."""
    own = vars(Obstacle)[name]
    if isinstance(own, property):
        way = f", or a property: write @property above def {name}(self)"
    else:
        arguments = ", ".join(signature(own).parameters) if isfunction(own) else ""
        way = f", or a method {name}({arguments})" if arguments else ""
    return AttributeError(
        f"expected another name for the attribute {name} of {kind.__name__}{way}; all obstacles "
        f"have {', '.join(sorted(_RESERVED))}"
    )


def _may_replace(name: str, value: Any) -> bool:
    """Whether an attribute of a user's class may override the same attribute of all obstacles.

    A method may be overridden by one with the same arguments, a property by a property, and
    ``is_of_revolution`` by its value.
    """
    own = vars(Obstacle)[name]
    if name == "is_of_revolution" and isinstance(value, bool):
        return True
    if isinstance(own, property):
        return isinstance(value, property | cached_property)
    if not (isfunction(own) and isfunction(value)):
        return False
    return [*signature(value).parameters] == [*signature(own).parameters]
