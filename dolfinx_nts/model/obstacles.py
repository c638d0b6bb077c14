r"""Rigid obstacles: analytical surfaces that bodies cannot enter.

An obstacle stands in the place of a surface's segments, has no unknowns and
never moves. Gap and normal are those of the exact surface; the contact force
of the energy-momentum scheme is a discrete gradient,
:math:`F \cdot (x_{n+1} - x_n) = g_{n+1} - g_n`, in closed form. Obstacles
of facets are in `rigid_surface`.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arguments import as_call
from dolfinx_nts.common.arrays import Array, Flags, Floats, GlobalInts, Ints

__all__ = ["Contact", "Obstacle", "RigidCylinder", "RigidPlane", "RigidSphere"]

Contact = tuple[Array, ...]


class Obstacle(ABC):
    """One rigid surface, seen from the nodes of one rank. Local.

    Its pairs consist of the node alone, d = 3.

    Attributes:
        key: Number of each facet, shape ``(f,)``.
    """

    key: GlobalInts = np.zeros(1, dtype=np.int64)

    def __repr__(self) -> str:
        """Size, or what defines the surface [m]. Local."""
        return as_call(self, num_facets=len(self.key))

    @abstractmethod
    def contact(self, scheme: str, x_n: Floats, x: Floats, segment: Ints) -> Contact:
        """Contact of nodes, as the kernels give it for pairs with d = 3.

        Args:
            scheme: ``"conserving"``, ``"midpoint"`` or ``"static"``.
            x_n: Positions at t_n, shape ``(m, 3)`` [m].
            x: Positions at t_{n+1}, shape ``(m, 3)`` [m].
            segment: Facet of each node, shape ``(m,)``.

        Returns:
            gap_n, gap, force, gradient, tangent, turn (NaN if any is not
            finite), status.
        """

    @abstractmethod
    def slip(self, x_n: Floats, x: Floats, segment: Ints) -> Contact:
        """Slip of nodes, as the kernel gives it, and orientations.

        Args:
            x_n: Positions at t_n, shape ``(m, 3)`` [m].
            x: Positions at t_{n+1}, shape ``(m, 3)`` [m].
            segment: Facet of each node, shape ``(m,)``.

        Returns:
            value, force, gradient, w, b, frame_n, frame, orientation.
        """

    @abstractmethod
    def find(self, x: Floats, current: Ints, slack: float, reach: float) -> tuple[Ints, Floats]:
        """Facet of each node or -1, and gap.

        Args:
            x: Positions, shape ``(m, 3)`` [m].
            current: Last facets or -1, shape ``(m,)``.
            slack: By how much a node may be beside the last facet and keeps
                it, see `SegmentCandidates.pair`.
            reach: Largest gap of interest [m].

        Returns:
            Facet and gap [m], shape ``(m,)``.
        """

    @abstractmethod
    def near(self, x: Floats, reach: float) -> Ints:
        """Numbers of the nodes within reach of a facet, at least.

        Args:
            x: Positions, shape ``(m, 3)`` [m].
            reach: [m].
        """

    def beside(self, x: Floats, segment: Ints) -> Flags:
        """Whether nodes have left their facets sideways, over a rim. Local.

        Args:
            x: Positions, shape ``(m, 3)`` [m].
            segment: Facet of each node, shape ``(m,)``.

        Returns:
            Flags, shape ``(m,)``; an exact surface has no rim.
        """
        return np.zeros(len(x), dtype=bool)


class _Exact(Obstacle):
    """Obstacle given by its distance."""

    @abstractmethod
    def distance(self, x: Floats) -> tuple[Floats, Floats]:
        """Gap and normal of points. Local.

        Args:
            x: Positions, shape ``(m, 3)`` [m].

        Returns:
            Gap [m], shape ``(m,)``, > 0 open, and unit normal out of the
            obstacle, shape ``(m, 3)``.
        """

    @abstractmethod
    def _force(self, scheme: str, x_n: Floats, x: Floats) -> tuple[Floats, Floats]:
        """Force per multiplier (m, 3) and its derivative (m, 3, 3)."""

    def contact(self, scheme: str, x_n: Floats, x: Floats, segment: Ints) -> Contact:
        """Contact of nodes, see `Obstacle.contact`."""
        gap_n, normal_n = self.distance(x_n)
        gap, normal = self.distance(x)
        force, tangent = self._force(scheme, x_n, x)
        turn = np.einsum("mi,mi->m", normal_n, normal)
        valid = np.isfinite(gap_n + gap + turn)
        turn, status = np.where(valid, turn, np.nan), np.where(valid, 0, 1).astype(np.int8)
        return gap_n, gap, force, normal, tangent, turn, status

    def slip(self, x_n: Floats, x: Floats, segment: Ints) -> Contact:
        """Displacement in the tangent plane of t_n, see `Obstacle.slip`."""
        frame_n, frame = (_frame(self.distance(y)[1]) for y in (x_n, x))
        value = np.einsum("mij,mj->mi", frame_n, x - x_n)
        m = len(x)
        w, b, orientation = np.ones((m, 1)), np.zeros((m, 2, 1)), np.ones(m)
        return value, frame_n, frame_n, w, b, frame_n, frame, orientation

    def find(self, x: Floats, current: Ints, slack: float, reach: float) -> tuple[Ints, Floats]:
        """Facet 0 for all nodes in reach, see `Obstacle.find`."""
        gap, _ = self.distance(x)
        return np.where(gap <= reach, 0, -1).astype(np.int32), gap

    def near(self, x: Floats, reach: float) -> Ints:
        """Numbers of the nodes in reach or inside, see `Obstacle.near`."""
        return np.flatnonzero(self.distance(x)[0] <= reach).astype(np.int32)


class RigidPlane(_Exact):
    """Half space that bodies cannot enter.

    Args:
        point: A point of the plane, shape ``(3,)`` [m].
        normal: Direction out of the obstacle, of any length, ``(3,)``.

    Raises:
        ValueError: No three finite numbers, or no direction.
    """

    def __init__(self, point: Sequence[float], normal: Sequence[float]) -> None:
        """Normalise the direction."""
        self._point = _vector("point", point)
        self._normal = _direction("normal", normal)

    def __repr__(self) -> str:
        """Point [m] and unit normal. Local."""
        return as_call(self, point=self._point, normal=self._normal)

    def distance(self, x: Floats) -> tuple[Floats, Floats]:
        """Gap and normal of points, see `_Exact.distance`."""
        return (x - self._point) @ self._normal, np.tile(self._normal, (len(x), 1))

    def _force(self, scheme: str, x_n: Floats, x: Floats) -> tuple[Floats, Floats]:
        return np.tile(self._normal, (len(x), 1)), np.zeros((len(x), 3, 3))


class _Round(_Exact):
    """Points at a given distance from a centre, in a subspace."""

    def __init__(
        self, centre: Sequence[float], radius: float, projector: Floats, hollow: bool
    ) -> None:
        if not (np.isfinite(radius) and radius > 0):
            raise ValueError(f"expected a radius > 0, given {radius}")
        self._centre, self._radius = _vector("centre", centre), float(radius)
        self._projector, self._sign = projector, -1.0 if hollow else 1.0

    def _radial(self, x: Floats) -> tuple[Floats, Floats]:
        r = (x - self._centre) @ self._projector
        return r, np.linalg.norm(r, axis=1)

    def distance(self, x: Floats) -> tuple[Floats, Floats]:
        """Gap and normal of points, see `_Exact.distance`."""
        r, length = self._radial(x)
        normal = self._sign * r / np.where(length > 0, length, np.nan)[:, None]
        return self._sign * (length - self._radius), normal

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
    """Ball, or the inside of a sphere.

    Args:
        centre: Centre, shape ``(3,)`` [m].
        radius: Radius [m].
        hollow: Whether bodies are kept inside instead of outside.

    Raises:
        ValueError: No three finite numbers, or ``radius`` is not positive.
    """

    def __init__(self, centre: Sequence[float], radius: float, *, hollow: bool = False) -> None:
        """Check the numbers."""
        super().__init__(centre, radius, np.eye(3), hollow)

    def __repr__(self) -> str:
        """Centre and radius [m]. Local."""
        return as_call(self, centre=self._centre, radius=self._radius, hollow=self._sign < 0)


class RigidCylinder(_Round):
    """Cylinder of infinite length, or the inside of a tube.

    Args:
        point: A point of the axis, shape ``(3,)`` [m].
        axis: Direction of the axis, of any length, ``(3,)``.
        radius: Radius [m].
        hollow: Whether bodies are kept inside instead of outside.

    Raises:
        ValueError: No three finite numbers, no direction, or ``radius`` is
            not positive.
    """

    def __init__(
        self,
        point: Sequence[float],
        axis: Sequence[float],
        radius: float,
        *,
        hollow: bool = False,
    ) -> None:
        """Check the numbers."""
        self._axis = a = _direction("axis", axis)
        super().__init__(point, radius, np.eye(3) - np.outer(a, a), hollow)

    def __repr__(self) -> str:
        """Point and radius [m], unit vector of the axis. Local."""
        return as_call(
            self,
            point=self._centre,
            axis=self._axis,
            radius=self._radius,
            hollow=self._sign < 0,
        )


def _vector(name: str, value: Sequence[float]) -> Floats:
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise ValueError(f"expected three finite numbers for {name}, given {value}")
    return vector


def _direction(name: str, value: Sequence[float]) -> Floats:
    vector = _vector(name, value)
    length = np.linalg.norm(vector)
    if length == 0:
        raise ValueError(f"expected a direction for {name}, given {value}")
    direction: Floats = vector / length
    return direction


def _frame(normal: Floats) -> Floats:
    """Orthonormal tangents (m, 2, 3), right-handed with the normals."""
    # Any axis that is not near the normal; the same for small turns.
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    first = np.cross(axis, normal)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normal, first)], axis=1)
