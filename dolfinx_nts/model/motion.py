"""Prescribed rigid motion of an obstacle: translation and rotation as functions of time."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dolfinx_nts.common.arguments import as_call, real_array
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.model.frames import Frame, MovingFrame, Placement

__all__ = ["Motion"]

# By how much a matrix may miss a rotation [-]: more than round-off, less than any mistake.
_ROUND_OFF = 1e-6


class Motion(Declaration):
    r"""Declares how an obstacle moves: :math:`x = c + d(t) + R(t) (X - c)`. Local.

    The obstacle is where it was declared, with positions X, if translation and rotation are
    zero. Both must depend on the time alone: every step evaluates them at its start, in its
    middle and at its end. Several obstacles with one motion are one tool.

    Args:
        translation: Function of the time [s] that returns the displacement d of the centre,
            shape ``(3,)`` [m]; None: the centre stays.
        rotation: Function of the time [s] that returns the rotation R since the start, a rotation
            vector (axis times angle), shape ``(3,)`` [rad], or a matrix, shape ``(3, 3)``; None:
            the obstacle does not turn.
        centre: Point c about which the obstacle turns, shape ``(3,)`` [m].

    Raises:
        TypeError: ``translation`` or ``rotation`` is no function.
        ValueError: ``centre`` is not three finite numbers; in a step: a function returns
            something else than described.

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
        """Check the arguments; the functions are called in steps only."""
        for name, function in (("translation", translation), ("rotation", rotation)):
            if not (function is None or callable(function)):
                raise TypeError(f"expected a function of the time as {name}, given {function!r}")
        self._translation, self._rotation = translation, rotation
        self._centre = _three("centre", centre)

    def __repr__(self) -> str:
        """Return the call that makes such a motion, with the names of functions. Local."""
        given = {"translation": self._translation, "rotation": self._rotation}
        return as_call(self, **given, centre=self._centre)

    @property
    def is_rest(self) -> bool:
        """Whether nothing moves."""
        return self._translation is None and self._rotation is None

    def frame(self, t_n: float, t: float) -> Frame:
        """Frame of the obstacle in a step.

        Args:
            t_n: Time at the start of the step [s].
            t: Time at its end [s].

        Raises:
            TypeError, ValueError: A function returns something else than described.
        """
        if self.is_rest:
            return Frame()
        return MovingFrame(self._centre, *map(self._placement, (t_n, (t_n + t) / 2, t)))

    def _placement(self, t: float) -> Placement:
        centre, rotation = self._centre, np.eye(3)
        if self._translation is not None:
            centre = centre + _three(f"a translation at t = {t:g}", self._translation(t))
        if self._rotation is not None:
            rotation = _rotation(t, self._rotation(t))
        return Placement(centre, rotation)


def _three(name: str, value: Any) -> Floats:
    vector = real_array(name, value)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"expected three finite numbers for {name}, given {value!r}")
    return vector


def _rotation(t: float, value: Any) -> Floats:
    """Rotation matrix of a rotation vector, or the one that is nearest to a matrix."""
    name = f"a rotation at t = {t:g}"
    given = real_array(name, value)
    if given.shape != (3, 3):
        return _by_vector(_three(name, given))
    if np.isfinite(given).all():
        left, _, right = np.linalg.svd(given)
        nearest: Floats = left @ right
        if np.linalg.det(nearest) > 0 and np.abs(given - nearest).max() <= _ROUND_OFF:
            return nearest
    raise ValueError(
        f"expected a rotation matrix, or a rotation vector, for {name}, given {value!r}"
    )


def _by_vector(vector: Floats) -> Floats:
    """Rotation by a vector, axis times angle (Rodrigues)."""
    half = np.linalg.norm(vector) / 2
    w = np.cross(np.eye(3), vector)  # w @ y is vector x y
    sine, factor = np.sinc(2 * half / np.pi), np.sinc(half / np.pi)
    rotation: Floats = np.eye(3) + sine * w + factor**2 / 2 * w @ w
    return rotation
