"""Guides: prescribed and free directions of the motion of a rigid body."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_nts.common.arguments import as_call, label, real_array
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.model.obstacles.motion import Motion, vector

__all__ = ["Guide"]


class Guide(Declaration):
    r"""Guide of a rigid body: free in some directions, prescribed in all others. Local.

    The body slides along and rotates about the given directions, which are fixed in space. All
    other motions are zero or prescribed by ``motion``: the displacement of the guided point in the
    other directions, and the rotation of a body that does not rotate freely. Loads drive the free
    motions. The reaction of the guide balances forces and moments in all other directions.

    Args:
        slides: Axes along which the guided point moves freely: letters as in ``"z"`` or ``"xy"``,
            or one direction, shape ``(3,)``, in the plane ``(2,)``.
        turns: Axes of free rotation: one letter, ``"xyz"`` for all, or one direction, shape
            ``(3,)``; in the plane ``"z"``. Two axes are refused, since their order would matter.
        motion: Motion of the guide; None for a guide at rest. It has no rotation if the body
            rotates freely.
        point: Guided point in the reference configuration, on the axes, shape ``(3,)``, in the
            plane ``(2,)`` [m]; None for the centre of mass.
        name: Name in columns and messages; empty for the name of the body.

    Raises:
        TypeError: ``motion`` is not a Motion, or ``name`` not a string.
        ValueError: Axes are not letters or directions as described, or both ``turns`` and
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
        name: str = "",
    ) -> None:
        if not (motion is None or isinstance(motion, Motion)):
            raise TypeError(f"expected a Motion of a guide, given {type(motion).__name__}")
        self._slides, self._turns = _axes("slides", slides), _axes("turns", turns)
        if len(self._turns) == 2:
            raise ValueError(
                f"expected one axis or 'xyz' as turns, given {turns!r}: free rotations about two "
                "axes would depend on their order"
            )
        if motion is not None and motion.turns and len(self._turns):
            raise ValueError(
                f"expected a motion without rotation together with turns={turns!r}: a body that "
                "rotates freely is driven by a Moment"
            )
        self.name = label(name)
        self.motion = Motion() if motion is None else motion
        self.point = None if point is None else real_array("point", point)
        self._given = {
            "slides": slides if isinstance(slides, str) else np.asarray(slides),
            "turns": turns if isinstance(turns, str) else np.asarray(turns),
            "motion": motion,
            "point": self.point,
        }

    def __repr__(self) -> str:
        """Constructor call of an equal guide. Local."""
        return as_call(self, **self._given, **({"name": self.name} if self.name else {}))

    def check(self, dim: int) -> None:
        """Check axes, point and motion for a space dimension.

        Raises:
            ValueError: Axes, point or motion do not fit the dimension.
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
        """Check that the guide only allows motion along the axis y of an axisymmetric mesh.

        Raises:
            ValueError: The guide allows sliding across the axis, or rotation.
        """
        if np.any(self._slides[:, ::2]) or len(self._turns) or self.motion.turns:
            raise ValueError(
                "expected slides along the axis y, and no turns, in an axisymmetric mesh, given "
                f"{self}: use a mesh in space for them"
            )

    def free(self, dim: int) -> Floats:
        """Orthonormal basis of the free translations and rotations. Local.

        Returns:
            Shape ``(k, 6)``, translations in x, y, z first, in the plane ``(k, 3)``.
        """
        slides, turns = self._slides[:, :dim], self._turns if dim == 3 else self._turns[:, 2:]
        rows = np.zeros((len(slides) + len(turns), slides.shape[1] + turns.shape[1]))
        rows[: len(slides), : slides.shape[1]] = slides
        rows[len(slides) :, slides.shape[1] :] = turns
        return rows

    def prescribed(self, point: Floats, t_n: float, t: float, dim: int) -> Floats:
        """Prescribed motion of the body between two times. Local.

        Args:
            point: Guided point in the reference configuration, shape ``(3,)`` [m].
            t_n: Time at the start of the step [s].
            t: Time at its end [s].
            dim: Dimension of the space, 2 or 3.

        Returns:
            Displacement of the point and Cayley vector of the rotation, ``(6,)``, in the plane
            ``(3,)``, without free components.

        Raises:
            TypeError, ValueError: A function of the motion returns an invalid value.
        """
        frame = self.motion.frame(t_n, t, dim)
        turn = frame.turn if dim == 3 else frame.turn[2:]
        shift = frame.carried(point, point)[:dim]
        motion = np.concatenate([shift, turn])
        free = self.free(dim)
        prescribed: Floats = motion - free.T @ (free @ motion)
        return prescribed


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
