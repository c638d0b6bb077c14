"""Rigid cones in axisymmetric meshes."""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arguments import as_call, real
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.model.obstacles.motion import vector
from dolfinx_nts.model.obstacles.rigid_shapes import RigidPlane

__all__ = ["RigidCone"]


class RigidCone(RigidPlane):
    """Rigid cone about the axis of an axisymmetric mesh. Local.

    Args:
        tip: Tip on the axis, shape ``(2,)``, x = 0 [m].
        half_angle: Angle between the axis and the surface [rad].
        opens: Direction in which the cone opens along the axis: 1 for up, such as an indenter above
            a body, or -1 for down.
        name: Name in messages, columns and legends; empty for the kind of the obstacle.

    Raises:
        ValueError: The tip is not on the axis, the angle is not between 0 and pi/2, or the
            direction is neither 1 nor -1.

    Example:
        >>> nts.RigidCone(tip=(0, 1), half_angle=1.2)
        RigidCone(tip=(0, 1), half_angle=1.2, opens=1)
    """

    def __init__(
        self, tip: Sequence[float], half_angle: float, *, opens: int = 1, name: str = ""
    ) -> None:
        if vector("tip", tip, 2)[0] != 0:
            raise ValueError(f"expected a tip on the axis x = 0, given {tip!r}")
        if not 0 < real("a half_angle [rad]", half_angle) < np.pi / 2:
            raise ValueError(
                "expected 0 < half_angle < pi/2 in radians, such as np.radians(70), given "
                f"{half_angle}"
            )
        if opens not in (1, -1):
            raise ValueError(f"expected opens 1 or -1, given {opens!r}")
        self._half_angle, self._opens = float(half_angle), int(opens)
        super().__init__(tip, (np.cos(half_angle), -opens * np.sin(half_angle)), name=name)

    @property
    def is_of_revolution(self) -> bool:
        return True

    def _declaration(self) -> str:
        tip, angle = self._point[: self.dim], self._half_angle
        return as_call(self, tip=tip, half_angle=angle, opens=self._opens, **self._named())

    def depth(self, x: Floats) -> Floats:
        return super().depth(np.column_stack([np.abs(x[:, :1]), x[:, 1:]]))
