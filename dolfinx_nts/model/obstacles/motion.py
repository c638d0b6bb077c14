"""Prescribed rigid motion of an obstacle: translation and rotation as functions of time."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dolfinx_nts.common.arguments import as_call, real_array
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.model.frames import Frame, MovingFrame, Placement, rotation_by

__all__ = ["Motion", "vector"]

# Largest deviation of a matrix from a rotation [-]: larger than round-off, and smaller than user
# errors.
_ROUND_OFF = 1e-6


class Motion(Declaration):
    r"""Prescribed rigid motion of an obstacle, :math:`x = c + d(t) + R(t) (X - c)`. Local.

    X are the declared positions of the obstacle. Translation and rotation must only depend on the
    time: every step evaluates them at its start, middle and end. Several obstacles may share one
    motion.

    Args:
        translation: Function of the time [s] that returns the displacement d of the centre,
            shape ``(3,)``, in the plane ``(2,)`` [m]; None for no translation.
        rotation: Function of the time [s] that returns the total rotation R, as a rotation
            vector (axis times angle), shape ``(3,)`` [rad], or a matrix, shape ``(3, 3)``; in the
            plane about z, or as an angle [rad]; None for no rotation.
        centre: Centre c of the rotation, shape ``(3,)`` or ``(2,)`` [m].

    Raises:
        TypeError: ``translation`` or ``rotation`` is not a function.
        ValueError: ``centre`` is not three (or two) finite numbers; in a step: a function returns
            an invalid value.

    Example:
        >>> down = nts.Motion(translation=lambda t: (0.0, 0.0, -0.1 * t))
        >>> drum = nts.Motion(rotation=lambda t: (0.0, 2.0 * t, 0.0), centre=(0.0, 0.0, 1.0))
        >>> roller = nts.RigidCylinder(point=(0, 0, 1), axis=(0, 1, 0), radius=1.0).moving(drum)
        >>> isinstance(roller, nts.RigidCylinder)
        True
    """

    def __init__(
        self,
        translation: Callable[[float], Any] | None = None,
        rotation: Callable[[float], Any] | None = None,
        centre: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        for name, function in (("translation", translation), ("rotation", rotation)):
            if not (function is None or callable(function)):
                raise TypeError(f"expected a function of the time as {name}, given {function!r}")
        self._translation, self._rotation = translation, rotation
        self._given = real_array("centre", centre)
        self._centre = vector("centre", self._given, 2 if self._given.shape == (2,) else 3)

    def __repr__(self) -> str:
        """Constructor call with the names of functions. Local."""
        given = {"translation": self._translation, "rotation": self._rotation}
        return as_call(self, **given, centre=self._given)

    @property
    def is_rest(self) -> bool:
        """Whether there is neither a translation nor a rotation."""
        return self._translation is None and self._rotation is None

    @property
    def turns(self) -> bool:
        """Whether the motion includes a rotation."""
        return self._rotation is not None

    def check(self, dim: int) -> None:
        """Check the number of coordinates of the centre for a space dimension.

        Raises:
            ValueError: The centre has two coordinates, and the dimension is 3.
        """
        if dim == 3:
            vector("centre", self._given, 3)

    def frame(self, t_n: float, t: float, dim: int = 3) -> Frame:
        """Frame of the obstacle in a step.

        Args:
            t_n: Time at the start of the step [s].
            t: Time at its end [s].
            dim: Dimension of the space of the obstacle, 2 or 3.

        Raises:
            TypeError, ValueError: A function returns an invalid value.
        """
        if self.is_rest:
            return Frame()
        placements = (self._placement(time, dim) for time in (t_n, (t_n + t) / 2, t))
        return MovingFrame(self._centre, *placements)

    def _placement(self, t: float, dim: int) -> Placement:
        centre, rotation = self._centre, np.eye(3)
        if self._translation is not None:
            centre = centre + vector(f"a translation at t = {t:g}", self._translation(t), dim)
        if self._rotation is not None:
            value = self._rotation(t)
            rotation = (_rotation if dim == 3 else _rotation_about_z)(t, value)
        return Placement(centre, rotation)


def vector(name: str, value: Any, dim: int) -> Floats:
    """Check a vector of ``dim`` numbers; returns three, with 0 appended in the plane. Local.

    Raises:
        ValueError: It has another shape, or is not finite.
    """
    given = real_array(name, value)
    if given.shape != (dim,) or not np.isfinite(given).all():
        number = {2: "two", 3: "three"}[dim]
        raise ValueError(f"expected {number} finite numbers for {name}, given {value!r}")
    return in_space(given)


def _rotation_about_z(t: float, value: Any) -> Floats:
    """Rotation matrix of an angle about z, or of a rotation about z."""
    name = f"a rotation at t = {t:g}"
    given = real_array(name, value)
    rotation = _rotation(t, np.array([0.0, 0.0, given]) if given.shape == () else given)
    if np.abs(rotation[2] - [0.0, 0.0, 1.0]).max() > _ROUND_OFF:
        raise ValueError(
            f"expected an angle, or a rotation about z, for {name} in the plane, given {value!r}"
        )
    return rotation


def _rotation(t: float, value: Any) -> Floats:
    """Rotation matrix of a rotation vector, or nearest rotation to a matrix."""
    name = f"a rotation at t = {t:g}"
    given = real_array(name, value)
    if given.shape != (3, 3):
        return rotation_by(vector(name, given, 3))
    if np.isfinite(given).all():
        left, _, right = np.linalg.svd(given)
        nearest: Floats = left @ right
        if np.linalg.det(nearest) > 0 and np.abs(given - nearest).max() <= _ROUND_OFF:
            return nearest
    raise ValueError(
        f"expected a rotation matrix, or a rotation vector, for {name}, given {value!r}"
    )
