r"""Gaps and slips of springs as the last linear system left them.

Where bodies turn and surfaces curve, gaps and slips of an iterate differ from those of the linear
system it comes from by what is of second order in the increment. Times the stiffness of a spring
this may be far more than the force on it: a node that goes a way s along a circle of radius R is
:math:`s^2/(2R)` away from it, and so lets go of it or stretches all it is connected with. The
linear forces are those of a formulation in which they are unknowns of their own. What is decided by
them, and the change of directions of force that goes with them, make Newton's method converge as it
does with multipliers, while the residual has the forces of the measured gaps and slips; both are
the same in equilibrium (D. Magisano, L. Leonetti, G. Garcea, Comput. Methods Appl. Mech. Engrg. 313
(2017), who do so with stresses).
"""

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.model.frames import Frame, Placement

__all__ = ["LinearValues"]


class LinearValues:
    """Values of ``n`` nodes in an iterate by the linear system. Local.

    Args:
        frame: That of what the nodes face, which may go on its way from one iterate to the next.
        num_nodes: Number of nodes.
        shape: That of the value of a node: none, or ``2``.
    """

    def __init__(self, frame: Frame, num_nodes: int, *shape: int) -> None:
        self._frame = frame
        self._values: Floats = np.empty((num_nodes, *shape))
        self._segment: Ints = np.empty(num_nodes, dtype=np.int32)
        self._last: tuple[PairKinematics, Floats, Placement, Floats, Floats] | None = None

    def of(self, pairs: PairKinematics, x: Floats, measured: Floats, gradients: Floats) -> Floats:
        """Values of ``m`` pairs by those of the last call and their gradients there.

        Args:
            pairs: Pairs of this iterate.
            x: Positions with ghosts in the frame, shape ``(l, 3)`` [m].
            measured: Values there, shape ``(m,)`` or ``(m, 2)``: the result where the last iterate
                had no pair of the node with the same segment.
            gradients: Their gradients in space, shape ``(m, d)`` or ``(m, 2, d)``.
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
        """Forget the last iterate, as where contact points are other ones."""
        self._last = None
