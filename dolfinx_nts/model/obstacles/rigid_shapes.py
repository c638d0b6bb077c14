r"""Obstacles with an exact surface: planes, spheres and cylinders.

Gap and normal refer to the exact surface. The contact force of the energy-momentum scheme is
a discrete gradient, :math:`F \cdot (x_{n+1} - x_n) = g_{n+1} - g_n`, in closed form.
"""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arguments import as_call, positive, real_array
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.frames import rotation_by
from dolfinx_nts.model.kinematics import ContactKinematics
from dolfinx_nts.model.obstacles.exact_obstacle import ExactObstacle, tangents_of
from dolfinx_nts.model.obstacles.facing import Facing
from dolfinx_nts.model.obstacles.motion import vector

__all__ = ["RigidCylinder", "RigidPlane", "RigidSphere"]

# Distance of the centre of an obstacle from the axis, relative to its size [-], that counts as
# round-off.
_ROUND_OFF = 1e-10


class RigidPlane(ExactObstacle):
    """Rigid half space, such as a floor or a wall. Local.

    In an axisymmetric mesh it must be normal to the axis; see `RigidCone` for other lines.

    Args:
        point: Point on the plane, shape ``(3,)``, or on the line in two dimensions, ``(2,)`` [m].
        normal: Outward direction, of any length, of the same shape.
        name: Name in messages, columns and legends; empty for the kind of the obstacle.

    Raises:
        ValueError: An argument is not three (or two) finite numbers, or the normal is zero.

    Example:
        >>> floor = nts.RigidPlane(point=(0, 0, -1), normal=(0, 0, 1))
        >>> gap, normal = floor.distance(np.array([[5.0, 2.0, 1.0]]))
        >>> gap
        array([2.])
    """

    def __init__(self, point: Sequence[float], normal: Sequence[float], *, name: str = "") -> None:
        self._call_it(name)
        self.dim = _dimension("point", point)
        self._point = vector("point", point, self.dim)
        self._normal = _direction("normal", normal, self.dim)
        self._tangents = tangents_of(self._normal[None])

    @property
    def is_of_revolution(self) -> bool:
        return self.dim == 2 and bool(abs(self._normal[0]) < _ROUND_OFF)

    def _declaration(self) -> str:
        given = {"point": self._point[: self.dim], "normal": self._normal[: self.dim]}
        return as_call(self, **given, **self._named())

    def distance(self, x: Floats) -> tuple[Floats, Floats]:
        """Signed distance of points and normal, positive on the free side."""
        return self._height(x), np.full((len(x), 3), self._normal)

    def _height(self, x: Floats) -> Floats:
        """Signed distance alone, shape ``(m,)`` [m]."""
        height: Floats = (x - self._point) @ self._normal
        return height

    def contact(self, scheme: str, x_n: Floats, x: Floats, segment: Ints) -> ContactKinematics:
        gap_n, gap = self._height(x_n), self._height(x)
        force, tangent = self._force(scheme, x_n, x)
        turn = np.where(np.isfinite(gap_n + gap), 1.0, np.nan)
        return ContactKinematics(gap_n, gap, force, force, tangent, turn)

    def unturned(self, x: Floats, turn: Floats) -> Floats:
        # Unchanged: a point in front of the plane at both ends does not pass through it.
        return x

    def _part_inside(self, x_n: Floats, x: Floats) -> tuple[Floats, Floats]:
        gap_n, gap = self._height(x_n), self._height(x)
        change = np.where(gap_n == gap, 1.0, gap_n - gap)
        crossing = np.clip(gap_n / change, 0.0, 1.0)
        return np.where(gap_n < 0, 0.0, crossing), np.where(gap < 0, 1.0, crossing)

    def _force(self, scheme: str, x_n: Floats, x: Floats) -> tuple[Floats, Floats]:
        return np.full((len(x), 3), self._normal), self._curvature(x)

    def _curvature(self, x: Floats) -> Floats:
        return np.zeros((len(x), 3, 3))

    def frames(self, x_n: Floats, x: Floats) -> tuple[Floats, Floats]:
        frame = np.repeat(self._tangents, len(x), axis=0)
        return frame, frame


class _Round(ExactObstacle):
    """Sphere or cylinder.

    Args:
        centre: Centre, or a point of the axis, shape ``(3,)`` [m].
        radius: Radius [m].
        axes: Projection onto the axes of symmetry, shape ``(3, 3)`` [-].
        projector: Projection onto the directions of the radius, shape ``(3, 3)`` [-].
        hollow: Whether bodies are inside.
    """

    def __init__(
        self,
        centre: Sequence[float],
        radius: float,
        axes: Floats,
        projector: Floats,
        hollow: bool,
    ) -> None:
        self.dim = _dimension("centre", centre)
        self.centre, self.radius = vector("centre", centre, self.dim), positive("a radius", radius)
        self._axes, self._projector, self._sign = axes, projector, -1.0 if hollow else 1.0
        if not hollow:
            self.shortest_passage = self.radius / 2

    @property
    def is_hollow(self) -> bool:
        return self._sign < 0

    def _radial(self, x: Floats) -> tuple[Floats, Floats]:
        r = (x - self.centre) @ self._projector
        return r, np.linalg.norm(r, axis=1)

    def distance(self, x: Floats) -> tuple[Floats, Floats]:
        """Signed distance of points and normal, positive on the free side."""
        r, length = self._radial(x)
        normal = self._sign * r / np.where(length > 0, length, np.nan)[:, None]
        return self._sign * (length - self.radius), normal

    def find(
        self, x: Floats, current: Ints, slack: float, reach: float, facing: Facing
    ) -> tuple[Ints, Floats]:
        # Nodes deeper than half the radius have no gap: they could leave on another side.
        found, gap = super().find(x, current, slack, reach, facing)
        return np.where(gap < -self.shortest_passage, -1, found).astype(np.int32), gap

    def unturned(self, x: Floats, turn: Floats) -> Floats:
        spin = self._axes @ turn  # 2 tan(angle/2) along its axis
        half = float(np.linalg.norm(spin)) / 2
        angle = spin * (np.arctan(half) / half if half else 1.0)
        straight: Floats = self.centre + (x - self.centre) @ rotation_by(angle).T
        return straight

    def _part_inside(self, x_n: Floats, x: Floats) -> tuple[Floats, Floats]:
        # Zeros of |r_n + s (r - r_n)|^2 - radius^2.
        (r_n, length), (r, _) = self._radial(x_n), self._radial(x)
        motion = r - r_n
        square, half = (np.einsum("mi,mi->m", motion, y) for y in (motion, r_n))
        root = np.sqrt(np.fmax(half**2 - square * (length**2 - self.radius**2), 0.0))
        square = np.where(square > 0, square, np.inf)
        low, high = (np.clip((-half + side * root) / square, 0.0, 1.0) for side in (-1.0, 1.0))
        if self.is_hollow:
            # In a hollow shape, a straight path between two inner points stays inside.
            return high, np.where(high < 1, 1.0, high)
        return low, high

    def _curvature(self, x: Floats) -> Floats:
        return self._force("static", x, x)[1]

    def _force(self, scheme: str, x_n: Floats, x: Floats) -> tuple[Floats, Floats]:
        if scheme == "conserving":
            # (r_n + r)/(|r_n| + |r|), whose work is |r| - |r_n|.
            (r_n, length_n), (r, length) = self._radial(x_n), self._radial(x)
            total, sum_r = length_n + length, r_n + r
            force = sum_r / total[:, None]
            turned = r / np.where(length > 0, length, np.nan)[:, None]
            tangent = (self._projector - force[:, :, None] * turned[:, None, :]) / total[
                :, None, None
            ]
            return self._sign * force, self._sign * tangent
        r, length = self._radial((x_n + x) / 2 if scheme == "midpoint" else x)
        force = r / np.where(length > 0, length, np.nan)[:, None]
        tangent = (self._projector - force[:, :, None] * force[:, None, :]) / length[:, None, None]
        return self._sign * force, self._sign * tangent * (0.5 if scheme == "midpoint" else 1.0)


class RigidSphere(_Round):
    """Rigid ball, or hollow sphere around bodies. Local.

    Args:
        centre: Centre, shape ``(3,)``, or ``(2,)`` for a circle in the plane [m].
        radius: Radius [m].
        hollow: Whether bodies are inside.
        name: Name in messages, columns and legends; empty for the kind of the obstacle.

    Attributes:
        centre: The argument, shape ``(3,)``, in the plane with a last coordinate of zero [m].
        radius: The argument [m].

    Raises:
        ValueError: ``centre`` is not three (or two) finite numbers, or ``radius`` not positive.

    Example:
        >>> nts.RigidSphere(centre=(0, 0, 5), radius=2.0, hollow=True)
        RigidSphere(centre=(0, 0, 5), radius=2, hollow=True)
    """

    def __init__(
        self, centre: Sequence[float], radius: float, *, hollow: bool = False, name: str = ""
    ) -> None:
        self._call_it(name)
        super().__init__(centre, radius, np.eye(3), np.eye(3), hollow)

    @property
    def is_of_revolution(self) -> bool:
        return self.dim == 2 and bool(abs(self.centre[0]) < _ROUND_OFF * self.radius)

    def _declaration(self) -> str:
        centre = self.centre[: self.dim]
        given = {"centre": centre, "radius": self.radius, "hollow": self.is_hollow}
        return as_call(self, **given, **self._named())


class RigidCylinder(_Round):
    """Rigid infinite cylinder, or tube around bodies. Local.

    Args:
        point: A point of the axis, shape ``(3,)`` [m].
        axis: Direction of the axis, of any length, shape ``(3,)``.
        radius: Radius [m].
        hollow: Whether bodies are inside.
        name: Name in messages, columns and legends; empty for the kind of the obstacle.

    Raises:
        ValueError: ``point`` or ``axis`` is not three finite numbers, the axis is zero, or
            ``radius`` is not positive.

    Example:
        >>> nts.RigidCylinder(point=(0, 0, 0), axis=(0, 2, 0), radius=0.5)
        RigidCylinder(point=(0, 0, 0), axis=(0, 1, 0), radius=0.5, hollow=False)
    """

    def __init__(
        self,
        point: Sequence[float],
        axis: Sequence[float],
        radius: float,
        *,
        hollow: bool = False,
        name: str = "",
    ) -> None:
        self._call_it(name)
        self._axis = a = _direction("axis", axis)
        vector("point", point, 3)  # not in the plane
        along: Floats = a[:, None] * a
        super().__init__(point, radius, along, np.eye(3) - along, hollow)

    def _declaration(self) -> str:
        given = {"point": self.centre, "axis": self._axis, "radius": self.radius}
        return as_call(self, **given, hollow=self.is_hollow, **self._named())


def _dimension(name: str, value: Sequence[float]) -> int:
    """Number of coordinates of a point, 2 in the plane, otherwise 3."""
    return 2 if real_array(name, value).shape == (2,) else 3


def _direction(name: str, value: Sequence[float], dim: int = 3) -> Floats:
    given = vector(name, value, dim)
    length = np.linalg.norm(given)
    if length == 0:
        raise ValueError(f"expected a direction for {name}, given {value}")
    direction: Floats = given / length
    return direction
