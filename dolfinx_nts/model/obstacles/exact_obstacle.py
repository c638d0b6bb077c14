r"""Base class of obstacles with an exact surface, given by its signed distance.

Gap and normal refer to the exact surface. The contact force of the energy-momentum scheme is
a discrete gradient, :math:`F \cdot (x_{n+1} - x_n) = g_{n+1} - g_n`.
"""

import copy
from abc import abstractmethod
from collections.abc import Callable

import numpy as np

from dolfinx_nts.common.arguments import as_call, is_of_package
from dolfinx_nts.common.arrays import Floats, Ints, indices
from dolfinx_nts.common.vectors import cross
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.obstacles.facing import Facing
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.obstacles.trajectories import Trajectories
from dolfinx_nts.model.obstacles.user_distance import signed_distance, without_nan

__all__ = ["ExactObstacle", "tangents_of"]

# Distance from the surface, relative to the length of a path [-], that counts as zero.
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


class _SurfaceSlip(Slip):
    """Displacement of nodes in the tangent plane of an exact surface at t_n.

    Schemes with forces at t_{n+1} use the tangent plane at t_{n+1}.

    Args:
        value: Slip of the step, shape ``(m, 2)`` [m].
        frame_n: Orthonormal tangents at t_n, shape ``(m, 2, 3)``.
        frame: Tangents at t_{n+1}, see `_turned_tangents`.
        curvature: Derivative of the normal at t_{n+1} w.r.t. the position, ``(m, 3, 3)`` [1/m].
    """

    def __init__(self, value: Floats, frame_n: Floats, frame: Floats, curvature: Floats) -> None:
        m = len(value)
        frames = {"frame_n": frame_n, "frame": frame, "orientation": np.ones(m)}
        second = np.ones((m, 1)), np.zeros((m, 2, 1))
        super().__init__(value, frame_n, frame_n, *second, **frames)
        self._curvature, self._is_at_end = curvature, False

    def at_end(self) -> "_SurfaceSlip":
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


def _turned_tangents(frame_n: Floats, normal_n: Floats, normal: Floats) -> Floats:
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
        return _SurfaceSlip(value, frame_n, frame, self._curvature(x))

    def _curvature(self, x: Floats) -> Floats:
        """Derivative of the normal w.r.t. the position, shape ``(m, 3, 3)`` [1/m]."""
        size = _DIFFERENCE * max(float(np.abs(x).max(initial=0.0)), np.finfo(float).tiny)
        curvature: Floats = np.zeros((*x.shape, 3))
        for i, h in enumerate(size * np.eye(3)[: self.dim]):
            curvature[:, :, i] = (self._found(x + h)[1] - self._found(x - h)[1]) / (2 * size)
        return curvature

    def frames(self, x_n: Floats, x: Floats) -> tuple[Floats, Floats]:
        """Orthonormal tangents at both ends of a step, each ``(m, 2, 3)``. Local.

        Parallel transport with the normal gives the tangents at the end from the tangents at t_n.
        """
        normal_n, normal = self._found(x_n)[1], self._found(x)[1]
        frame_n = tangents_of(normal_n)
        return frame_n, _turned_tangents(frame_n, normal_n, normal)

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
        return indices(self._nodal_height(x) <= reach)


def tangents_of(normal: Floats) -> Floats:
    """Orthonormal tangents ``(m, 2, 3)``, right-handed with unit normals ``(m, 3)``. Local."""
    # The coordinate axis farthest from the normal. For normals in the plane it is z, so that the
    # first tangent is in the plane.
    axis = np.eye(3)[2 - np.argmin(np.abs(normal[:, ::-1]), axis=1)]
    first = cross(axis, normal)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, cross(normal, first)], axis=1)
