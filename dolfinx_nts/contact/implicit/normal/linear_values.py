r"""Gaps and slips of springs extrapolated by the linear system.

With rotations and curved surfaces, gaps and slips of an iterate differ from those of the linear
system by terms of second order in the increment. Times the stiffness of a spring these may far
exceed its force: a node that moves by s along the tangent of a circle of radius R is
:math:`s^2/(2R)` away from it. The linear forces are the unknowns of a mixed formulation. Using them
for decisions and for the geometric tangent, Newton's method converges as with multipliers, while
the residual has the forces of the measured gaps and slips. Both agree in equilibrium (D. Magisano,
L. Leonetti, G. Garcea, Comput. Methods Appl. Mech. Engrg. 313 (2017), for stresses).
"""

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.model.frames import Frame, Placement

__all__ = ["LinearValues"]


class LinearValues:
    """Linearly extrapolated values of ``n`` nodes. Local.

    Args:
        frame: Frame of the segments, which may move between iterates.
        num_nodes: Number of nodes.
        shape: Shape of the value of a node: empty for gaps, ``2`` for slips.
    """

    def __init__(self, frame: Frame, num_nodes: int, *shape: int) -> None:
        self._frame = frame
        self._values: Floats = np.empty((num_nodes, *shape))
        self._segment: Ints = np.empty(num_nodes, dtype=np.int32)
        self._last: tuple[PairKinematics, Floats, Placement, Floats, Floats] | None = None

    def of(self, pairs: PairKinematics, x: Floats, measured: Floats, gradients: Floats) -> Floats:
        """Values of ``m`` pairs, extrapolated from the last iterate.

        Args:
            pairs: Pairs of this iterate.
            x: Positions with ghosts in the frame, shape ``(l, 3)`` [m].
            measured: Measured values, shape ``(m,)`` or ``(m, 2)``, used for pairs that did not
                exist in the last iterate.
            gradients: Gradients of these values in space, shape ``(m, d)`` or ``(m, 2, d)``.
        """
        values, x = measured, self._frame.in_space(x)
        if self._last is not None:
            last, x_last, end, before, slopes = self._last
            dx = (x - x_last - self._frame.displacement_from(end, x_last)).take(last.dofs, axis=0)
            dx = dx.reshape(len(slopes), slopes.shape[-1])
            self._segment[:] = -1
            self._segment[last.node] = last.segment
            self._values[last.node] = before + np.einsum("m...d,md->m...", slopes, dx)
            is_same = self._segment[pairs.node] == pairs.segment
            values = measured.copy()
            values[is_same] = self._values[pairs.node[is_same]]
        self._last = pairs, x, self._frame.end, measured, gradients
        return values

    def forget(self) -> None:
        """Discard the last iterate, after a change of the contact points."""
        self._last = None
