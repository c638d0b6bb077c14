"""Sharp edges that cross edges of a rigid obstacle."""

from typing import Any

import numpy as np

from dolfinx_nts._kernels import HYSTERESIS
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.frames import Frame
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.search.edges.crossings import WEIGHTS
from dolfinx_nts.search.edges.edge_candidates import EdgeCandidates
from dolfinx_nts.search.points import ContactPoints

__all__ = ["RigidEdgeCandidates"]


class RigidEdgeCandidates(EdgeCandidates):
    """Edges that cross edges of a rigid obstacle.

    The nodes of a pair belong to the own edge. Positions are in the frame of the obstacle, with
    the vertices of the obstacle as additional rows.

    Args:
        corners: Vertices of the obstacle, shape ``(n, 3)`` [m].
        frame: Frame of the obstacle in the current step.
        *edges: Arguments of `EdgeCandidates`.

    Attributes:
        frame: The argument.
    """

    _weights = WEIGHTS[:, :2]

    def __init__(self, corners: Floats, frame: Frame, *edges: Any) -> None:
        super().__init__(*edges)
        self._corners, self.frame = corners, frame
        self._triangles, self.segments = self.segments, self.segments[:, :1]

    def _with_corners(self, x: Floats) -> Floats:
        """Positions of the nodes of the map, then of the vertices of the obstacle [m]."""
        return np.concatenate([x[: self.scatter.num_local], self._corners])

    def pair(
        self,
        points: ContactPoints,
        x: Floats,
        current: Ints,
        reach: float,
        slack: float = HYSTERESIS,
    ) -> tuple[Ints, Floats]:
        return super().pair(points, self._with_corners(x), current, reach, slack)

    def near(self, points: ContactPoints, x: Floats, reach: float) -> Ints:
        return super().near(points, self._with_corners(x), reach)

    def pairs(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Positions of the equivalent points and triangles, ``(m, 4, 3)`` [m]."""
        pairs = np.empty((len(segment), len(WEIGHTS), 3))
        pairs[:, 0] = points.of(x)
        pairs[:, 1:] = self._with_corners(x)[self._triangles[segment]]
        return WEIGHTS @ pairs

    def contact(
        self, scheme: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> ContactKinematics:
        return self.frame.turned(scheme, super().contact(scheme, points, x_n, x, segment))

    def slip(
        self, measure: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> Slip:
        return self.frame.turned_slip(super().slip(measure, points, x_n, x, segment))
