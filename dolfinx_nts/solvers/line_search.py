r"""Line search of Newton's method, for stresses whose tangent jumps.

Where a point at the yield stress begins or ceases to flow, its tangent changes by a factor that may
be a thousand. Newton's method goes by the tangent of flow as far as it takes to turn a force by
flow alone, which is far beyond the point at which the stress lies inside the yield surface and
resists elastically: from flow one way it comes to flow the other way, and back, or farther away
each time. Along an increment :math:`\Delta u` the virtual work of the balance,

.. math:: g(s) = \Delta u \cdot R(u + s \Delta u),

begins with :math:`g(0) = -E < 0` and would be 0 at :math:`s = 1` if the tangent told all. Bodies
that resist by more have :math:`g(1) > 0`. The resistance may come late on the way, with the points
that cease to flow, and be a hundred times E then, so that a chord has its zero far too early. The
zero is enclosed by halving instead, until the work is less than half of E. Contact is taken as the
linear system has it: the work of its constraints and springs is what is left of E beside that of
the bodies, :math:`E_b = \Delta u \cdot K \Delta u`.
"""

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk

__all__ = ["LineSearch"]

# Virtual work at the end of an increment, relative to that at its start [-], from which on it is
# cut, or made longer after a cut; and how often. Increments that are too short as a whole are left
# as they are: others follow.
_LEFT, _MOST_CUTS = 0.5, 8


class LineSearch:
    """Cuts increments along which bodies resist by more than their tangent tells. Collective.

    Args:
        bulk: Residual of the bodies; its ``u`` moves.
    """

    def __init__(self, bulk: Bulk) -> None:
        """Begin without an increment."""
        self._bulk = bulk
        self._du: Floats | None = None

    def forget(self) -> None:
        """Leave the last increment as it is. Local."""
        self._du = None

    def begin(self, du: Floats, part: float, R: Floats, R_bulk: Floats) -> None:
        """Note an increment before it is made.

        Args:
            du: Increment of Newton's method on the owned dofs, shape ``(d n,)`` [m].
            part: Part of it that is made [-].
            R: Residual that it is to balance, shape ``(d n,)`` [N].
            R_bulk: Part of the bodies in it, shape ``(d n,)`` [N].
        """
        self._du, self._part, self._cuts = du, part, 0
        self._short, self._long = 0.0, part
        self._start, self._R_bulk = self._nodes.copy(), R_bulk
        resistance = self._bulk.rounded_action(du.reshape(self._start.shape))
        works = np.array([-du @ R, du @ resistance.ravel()])
        self._work, self._of_bulk = map(float, reductions.total(self._bulk.comm, works))

    def cuts(self, R_bulk: Floats) -> bool:
        """Cut the increment that was made, if it went too far, or was cut too much.

        Args:
            R_bulk: Residual of the bodies after it, shape ``(d n,)`` [N].

        Returns:
            Whether ``u`` was changed.
        """
        if self._du is None or self._of_bulk <= 0 or self._cuts == _MOST_CUTS:
            return False
        change = float(reductions.total(self._bulk.comm, float(self._du @ (R_bulk - self._R_bulk))))
        # Constraints that close gaps do work, too.
        work = max(self._work, self._of_bulk)
        rest = change + self._part * (work - self._of_bulk) - work
        if not (abs(rest) if self._cuts else rest) > _LEFT * work:
            return False
        if rest > 0:
            self._long = self._part
        else:
            self._short = self._part
        self._part = 0.5 * (self._short + self._long)
        self._cuts += 1
        increment = self._part * self._du.reshape(self._start.shape)
        self._nodes[:] = self._bulk.rigid.moved(self._start, increment)
        self._bulk.u.x.scatter_forward()
        return True

    @property
    def _nodes(self) -> Floats:
        """Displacements of the owned nodes, a view of shape ``(n, d)`` [m]."""
        u: Floats = self._bulk.u.x.array[: self._bulk.num_owned]
        return u.reshape(-1, dimension(self._bulk.u.function_space))
