"""Guides, which hold or lead a rigid body in some directions and leave it free in the others."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_nts.common.arguments import as_call, real_array
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.model.motion import Motion, vector

__all__ = ["Guide"]


class Guide(Declaration):
    r"""Declares in which directions a rigid body moves freely, and leads it in the others. Local.

    The body slides along and turns about the given directions, which are fixed in space. All
    other motions are held at zero or prescribed by ``motion``: the displacement of the guided
    point in the directions that do not slide, and the rotation of a body that does not turn
    freely. Loads drive the free directions; the reaction of the guide balances the rest of them.

    Args:
        slides: Axes along which the point of the body moves freely: letters as in ``"z"`` or
            ``"xy"``, or one direction, shape ``(3,)``, in the plane ``(2,)``.
        turns: Axes about which it turns freely: one letter, ``"xyz"`` for all, or one direction,
            shape ``(3,)``; in the plane ``"z"``. Two axes alone are refused, as the order of two
            turns matters.
        motion: How the guide moves; None: it is at rest. A body that turns freely has no other
            rotation.
        point: The guided point of the body in the reference state, through which axes go,
            shape ``(3,)``, in the plane ``(2,)`` [m]; None: its centre of mass.

    Raises:
        TypeError: ``motion`` is no Motion.
        ValueError: Axes are no letters or directions as described, or both ``turns`` and
            ``motion`` have a rotation.

    Example:
        >>> pressed = nts.Guide(slides="z")  # by a load, without tilting
        >>> driven = nts.Guide(motion=nts.Motion(translation=lambda t: (0.0, 0.0, -0.1 * t)))
        >>> hinge = nts.Guide(turns=(0, 1, 0), point=(0.0, 0.0, 2.0))
        >>> hinge
        Guide(slides='', turns=(0, 1, 0), motion=None, point=(0, 0, 2))
    """

    def __init__(
        self,
        *,
        slides: str | Sequence[float] = "",
        turns: str | Sequence[float] = "",
        motion: Motion | None = None,
        point: Sequence[float] | None = None,
    ) -> None:
        if not (motion is None or isinstance(motion, Motion)):
            raise TypeError(f"expected a Motion of a guide, given {type(motion).__name__}")
        self._slides, self._turns = _axes("slides", slides), _axes("turns", turns)
        if len(self._turns) == 2:
            raise ValueError(
                f"expected one axis or 'xyz' as turns, given {turns!r}: free turns about two "
                "axes have no meaning without their order"
            )
        if motion is not None and motion.turns and len(self._turns):
            raise ValueError(
                f"expected a motion without rotation beside turns={turns!r}: a body that turns "
                "freely is driven by a Moment"
            )
        self.motion = Motion() if motion is None else motion
        self.point = None if point is None else real_array("point", point)
        self._given = {
            "slides": slides if isinstance(slides, str) else np.asarray(slides),
            "turns": turns if isinstance(turns, str) else np.asarray(turns),
            "motion": motion,
            "point": self.point,
        }

    def __repr__(self) -> str:
        """Return the call that makes such a guide. Local."""
        return as_call(self, **self._given)

    def check(self, dim: int) -> None:
        """Raise unless axes, point and motion are those of a body in this dimension.

        Raises:
            ValueError: They are not.
        """
        if self.point is not None:
            vector("the point of a guide", self.point, dim)
        self.motion.check(dim)
        along, about = self._slides, self._turns
        if dim == 2 and (np.any(along[:, 2:]) or np.any(about[:, :2])):
            raise ValueError(
                f"expected slides in x and y and turns about z in the plane, given {self}"
            )

    def check_axis(self) -> None:
        """Raise unless all motions of the guide may be along the axis y of bodies of revolution.

        Raises:
            ValueError: They are not, as of slides across the axis and of turns.
        """
        if np.any(self._slides[:, ::2]) or len(self._turns) or self.motion.turns:
            raise ValueError(
                "expected slides along the axis y, and no turns, in an axisymmetric mesh, given "
                f"{self}: a mesh in space can have them"
            )

    def free(self, dim: int) -> Floats:
        """Free motions as sums of translations and rotations, orthonormal. Local.

        Returns:
            Shape ``(k, 6)``, translations in x, y, z first, in the plane ``(k, 3)``.
        """
        slides, turns = self._slides[:, :dim], self._turns if dim == 3 else self._turns[:, 2:]
        rows = np.zeros((len(slides) + len(turns), slides.shape[1] + turns.shape[1]))
        rows[: len(slides), : slides.shape[1]] = slides
        rows[len(slides) :, slides.shape[1] :] = turns
        return rows

    def led(self, point: Floats, t_n: float, t: float, dim: int) -> Floats:
        """Tell how the guide moves the body between two times [s]. Local.

        Args:
            point: The guided point in the reference state, shape ``(3,)`` [m].
            t_n: Time at the start of the step [s].
            t: Time at its end [s].
            dim: Dimension of the space, 2 or 3.

        Returns:
            The displacement of the point and the Cayley vector of the turn, ``(6,)``, in the
            plane ``(3,)``, without what is free.

        Raises:
            TypeError, ValueError: A function of the motion returns something else than described.
        """
        frame = self.motion.frame(t_n, t, dim)
        turn = frame.turn if dim == 3 else frame.turn[2:]
        shift = frame.carried(point, point)[:dim]
        motion = np.concatenate([shift, turn])
        free = self.free(dim)
        led: Floats = motion - free.T @ (free @ motion)
        return led


def _axes(name: str, given: Any) -> Floats:
    """Unit vectors along axes, shape ``(k, 3)``."""
    if isinstance(given, str):
        if len(set(given)) < len(given) or set(given) - set("xyz"):
            raise ValueError(f"expected letters of 'xyz' as {name}, each once, given {given!r}")
        return np.eye(3)[["xyz".index(letter) for letter in given]]
    direction = real_array(name, given)
    axis = vector(f"a direction of {name}", direction, 2 if direction.shape == (2,) else 3)
    if not (length := np.linalg.norm(axis)):
        raise ValueError(f"expected a direction of {name} that is not zero, given {given!r}")
    return axis[None] / length
