r"""Obstacles with an exact surface: planes, spheres and cylinders.

Gap and normal refer to the exact surface. The contact force of the energy-momentum scheme is
a discrete gradient, :math:`F \cdot (x_{n+1} - x_n) = g_{n+1} - g_n`, in closed form.
"""

import copy
from abc import abstractmethod
from collections.abc import Callable, Sequence

import numpy as np

from dolfinx_nts.common.arguments import as_call, is_of_package, positive, real_array
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.common.vectors import cross
from dolfinx_nts.model.frames import rotation_by
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.obstacles.facing import Facing
from dolfinx_nts.model.obstacles.motion import vector
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.obstacles.trajectories import Trajectories
from dolfinx_nts.model.obstacles.user_distance import signed_distance, without_nan

__all__ = [
    "ExactObstacle",
    "RigidCylinder",
    "RigidPlane",
    "RigidSphere",
    "SurfaceSlip",
    "turned_tangents",
]

# Distance of the centre of an obstacle from the axis, relative to its size [-], that counts as
# round-off.
_ROUND_OFF = 1e-10
# Step of central differences of normals, relative to the largest coordinate [-]: truncation and
# round-off are then about 1e-10 of the curvature.
_DIFFERENCE = 1e-5
# Displacement, relative to the largest coordinate [-], below which the discrete gradient is
# replaced by the normal at the midpoint: round-off of the gaps would exceed its error of second
# order.
_STILL = 1e-7
# Largest number of spheres in sphere tracing [-]; a path that grazes the surface needs many.
_MOST_SPHERES = 200
# Length of a path inside, relative to the whole path [-], that counts as zero.
_SHORTEST = 1e-4

# Least 1 + cos of the rotation angle of normals [-]: for half a turn the rotation is not unique.
_REVERSED = 1e-12


class SurfaceSlip(Slip):
    """Displacement of nodes in the tangent plane of an exact surface at t_n.

    Schemes with forces at t_{n+1} use the tangent plane at t_{n+1}.

    Args:
        value: Slip of the step, shape ``(m, 2)`` [m].
        frame_n: Orthonormal tangents at t_n, shape ``(m, 2, 3)``.
        frame: Tangents at t_{n+1}, see `turned_tangents`.
        curvature: Derivative of the normal at t_{n+1} w.r.t. the position, ``(m, 3, 3)`` [1/m].
    """

    def __init__(self, value: Floats, frame_n: Floats, frame: Floats, curvature: Floats) -> None:
        m = len(value)
        frames = {"frame_n": frame_n, "frame": frame, "orientation": np.ones(m)}
        second = np.ones((m, 1)), np.zeros((m, 2, 1))
        super().__init__(value, frame_n, frame_n, *second, **frames)
        self._curvature, self._is_at_end = curvature, False

    def at_end(self) -> "SurfaceSlip":
        end = copy.copy(self)
        end.force, end._is_at_end = self.frame, True
        return end

    def tangent(self, t: Floats) -> Floats:

        if not self._is_at_end:
            return super().tangent(t)
        n_n, n, D = self.normal_n, self.normal, self._curvature
        along = np.einsum("mi,mij->mj", t, self.frame_n)
        share = np.einsum("mi,mi->m", along, n)[:, None]
        whole = np.maximum(1 + np.einsum("mi,mi->m", n_n, n), _REVERSED)[:, None]
        turn = np.einsum("mi,mij->mj", along / whole - share / whole**2 * n_n, D)
        tangent: Floats = -(n_n + n)[:, :, None] * turn[:, None] - (share / whole)[:, :, None] * D
        return tangent


def turned_tangents(frame_n: Floats, normal_n: Floats, normal: Floats) -> Floats:
    """Rotate tangents with the normal (parallel transport). Local.

    Args:
        frame_n: Tangents, shape ``(m, 2, 3)``.
        normal_n: Unit normals to them, shape ``(m, 3)``.
        normal: Unit normals after the rotation, shape ``(m, 3)``.

    Returns:
        Tangents after the rotation, shape ``(m, 2, 3)``.
    """
    whole = np.maximum(1 + np.einsum("mi,mi->m", normal_n, normal), _REVERSED)
    share = np.einsum("mki,mi->mk", frame_n, normal) / whole[:, None]
    frame: Floats = frame_n - share[:, :, None] * (normal_n + normal)[:, None]
    return frame


class ExactObstacle(Obstacle):
    """Base class of obstacles with an exact surface, given by its signed distance. Local.

    A user-defined obstacle only needs the method `distance`; gap, force, slip and trajectories
    follow from it. The contact force of the energy-momentum scheme is the discrete gradient of
    Gonzalez (J. Nonlinear Sci. 6, 1996). Set the attribute ``shortest_passage`` to a quarter of the
    least thickness [m]; without it, steps are not checked for nodes that pass through. In the
    plane, the class attribute ``dim`` is 2; positions and normals keep three components, with z =
    0. For axisymmetric meshes, the class attribute ``is_of_revolution`` is True as well. Other
    attributes are shown in messages and compared in checkpoints. In the first step the distance is
    checked at a few points: near the surface its finite differences must be the normal, and outside
    it must not exceed the distance from the surface.

    Example:
        >>> class Drop(nts.ExactObstacle):
        ...     shortest_passage = 0.5
        ...     def distance(self, x):
        ...         r = np.linalg.norm(x, axis=1)
        ...         return r - 1.0, x / r[:, None]
        >>> Drop().distance(np.array([[0.0, 0.0, 3.0]]))[0]
        array([2.])
    """

    @abstractmethod
    def distance(self, x: Floats) -> tuple[Floats, Floats]:
        """Signed distance of points from the surface, and normal. Local.

        Args:
            x: Positions, shape ``(m, 3)`` [m], read-only.

        Returns:
            Gap, positive outside the obstacle, shape ``(m,)`` [m], and outward unit normal, the
            gradient of the gap, shape ``(m, 3)``. A normal that is not unique may be NaN. Outside,
            far from the surface, the gap may be smaller than the distance, but not larger: it is
            the step length along paths of nodes (sphere tracing).
        """

    def _declaration(self) -> str:
        own = {k: v for k, v in vars(self).items() if k[0] != "_" and not hasattr(Obstacle, k)}
        return as_call(self, **own, **self._named())

    def _found(self, x: Floats) -> tuple[Floats, Floats]:
        """Distance and normal, see `signed_distance`."""
        distance: Callable[[Floats], tuple[Floats, Floats]] = self.distance
        return distance(x) if is_of_package(distance) else signed_distance(self, x)

    def _height(self, x: Floats) -> Floats:
        """Signed distance alone, shape ``(m,)`` [m]."""
        return self._found(x)[0]

    def _nodal_height(self, x: Floats) -> Floats:
        """Signed distance of nodes, which must have one, shape ``(m,)`` [m]."""
        return without_nan(self, self._height(x), x)

    def _force(self, scheme: str, x_n: Floats, x: Floats) -> tuple[Floats, Floats]:
        """Force per multiplier, (m, 3) [-], and its derivative w.r.t. x, (m, 3, 3) [1/m]."""
        if scheme == "static":
            return self._found(x)[1], self._curvature(x)
        middle = (x_n + x) / 2
        normal, half = self._found(middle)[1], self._curvature(middle) / 2
        if scheme == "midpoint":
            return normal, half
        # n + (g - g_n - n . d) d / |d|^2 with the displacement d
        d = x - x_n
        square = np.einsum("mi,mi->m", d, d)[:, None]
        moves = square > (_STILL * np.abs(x).max(initial=0.0)) ** 2
        d = np.where(moves, d, 0.0) / np.sqrt(np.where(moves, square, 1.0))
        length = np.sqrt(np.where(moves, square, 1.0))
        (gap_n, _), (gap, normal_end) = self._found(x_n), self._found(x)
        error = np.where(moves, (gap - gap_n)[:, None] / length, 0.0)
        error -= np.einsum("mi,mi->m", normal, d)[:, None]
        of_error = normal_end - normal - length * np.einsum("mi,mij->mj", d, half)
        tangent = half + np.einsum("mi,mj->mij", d, of_error - 2 * error * d) / length[:, None]
        tangent += (error * moves / length)[:, None] * np.eye(3)
        return normal + error * d, tangent

    def contact(self, scheme: str, x_n: Floats, x: Floats, segment: Ints) -> ContactKinematics:
        gap_n, normal_n = self._found(x_n)
        gap, normal = self._found(x)
        without_nan(self, gap, x)
        force, tangent = self._force(scheme, x_n, x)
        turn = np.einsum("mi,mi->m", normal_n, normal)
        turn = np.where(np.isfinite(gap_n + gap + turn), turn, np.nan)
        return ContactKinematics(gap_n, gap, force, normal, tangent, turn)

    def slip(self, x_n: Floats, x: Floats, segment: Ints) -> Slip:
        frame_n, frame = self.frames(x_n, x)
        value = np.einsum("mij,mj->mi", frame_n, x - x_n)
        return SurfaceSlip(value, frame_n, frame, self._curvature(x))

    def _curvature(self, x: Floats) -> Floats:
        """Derivative of the normal w.r.t. the position, shape ``(m, 3, 3)`` [1/m]."""
        size = _DIFFERENCE * max(float(np.abs(x).max(initial=0.0)), np.finfo(float).tiny)
        curvature: Floats = np.zeros((*x.shape, 3))
        for i, h in enumerate(size * np.eye(3)[: self.dim]):
            curvature[:, :, i] = (self._found(x + h)[1] - self._found(x - h)[1]) / (2 * size)
        return curvature

    def frames(self, x_n: Floats, x: Floats) -> tuple[Floats, Floats]:
        """Orthonormal tangents at both ends of a step, each ``(m, 2, 3)``. Local.

        Parallel transport with the normal gives the tangents at the end from those at t_n.
        """
        normal_n, normal = self._found(x_n)[1], self._found(x)[1]
        frame_n = _frame(normal_n)
        return frame_n, turned_tangents(frame_n, normal_n, normal)

    def nearest(self, x: Floats) -> Floats:
        if np.isinf(self.shortest_passage):
            return super().nearest(x)
        gap, normal = self._found(x)
        points = x - gap[:, None] * normal
        found: Floats = points[np.isfinite(points).all(axis=1)]
        return found

    def find(
        self, x: Floats, current: Ints, slack: float, reach: float, facing: Facing
    ) -> tuple[Ints, Floats]:
        gap = self._nodal_height(x)
        return np.where(gap <= reach, 0, -1).astype(np.int32), gap

    def depth(self, x: Floats) -> Floats:
        return -self._height(x)

    def follow(self, x_n: Floats, x: Floats, inside: Ints, facing: Facing) -> Trajectories:
        begin, end = self._part_inside(x_n, x)
        enters = begin < end
        (entry, n_in), (exit_, n_out) = (
            (y, self._found(y)[1]) for y in (x_n + s[:, None] * (x - x_n) for s in (begin, end))
        )
        length = np.linalg.norm(exit_ - entry, axis=1)
        return Trajectories(
            np.where(enters, 0, -1).astype(np.int32),
            enters & (end < 1),
            np.where(inside >= 0, -1.0, begin),
            np.where(enters, length, 0.0),
            np.einsum("mi,mi->m", n_in, n_out),
            np.einsum("mi,mi->m", x - entry, n_in),
        )

    def _part_inside(self, x_n: Floats, x: Floats) -> tuple[Floats, Floats]:
        """Step fractions, ``(m,)``, between which straight paths are inside; equal if outside.

        Sphere tracing: a path shorter than the distance does not reach the surface.
        """
        length = np.linalg.norm(x - x_n, axis=1)
        length = np.where(length > 0, length, 1.0)
        least = _ROUND_OFF * length

        def trace(start: Floats, sign: float) -> Floats:
            s = start
            for _ in range(_MOST_SPHERES):
                gap = sign * self._height(x_n + s[:, None] * (x - x_n))
                goes_on = (gap > least) & (s < 1)
                if not goes_on.any():
                    break
                s = np.where(goes_on, np.minimum(s + gap / length, 1.0), s)
            return s

        begin = trace(np.zeros(len(x)), 1.0)
        inside = np.minimum(begin + _SHORTEST, 1.0)
        end = trace(inside, -1.0)
        return begin, np.where(end > inside, end, begin)

    def near(self, x: Floats, reach: float) -> Ints:
        return np.flatnonzero(self._nodal_height(x) <= reach).astype(np.int32)


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
        self._tangents = _frame(self._normal[None])

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


def _frame(normal: Floats) -> Floats:
    """Orthonormal tangents (m, 2, 3), right-handed with unit normals (m, 3)."""
    # The coordinate axis farthest from the normal. For normals in the plane it is z, so that the
    # first tangent is in the plane.
    axis = np.eye(3)[2 - np.argmin(np.abs(normal[:, ::-1]), axis=1)]
    first = cross(axis, normal)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, cross(normal, first)], axis=1)
