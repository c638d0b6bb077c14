r"""Line search of Newton's method, for forces whose tangent jumps.

At the onset and the end of plastic flow the tangent of a point may change by a factor of a
thousand. With the plastic tangent Newton's method overshoots. An unloading point becomes elastic
after a small part of the increment, and then flows in the opposite direction. The iterates
oscillate or diverge. Along an increment :math:`\Delta u` the virtual work of the residual,

.. math:: g(s) = \Delta u \cdot R(u + s \Delta u),

begins with :math:`g(0) = -E < 0` and would be 0 at :math:`s = 1` with a constant tangent. If the
stiffness increases along the increment, :math:`g(1) > 0`. As it may increase late, with g up to a
hundred times E, the secant method would underestimate the zero by far. Bisection is used instead,
until the work is less than half of E. Contact is linearised: the work of its constraints and
springs is the difference of E and the work of the bodies, :math:`E_b = \Delta u \cdot K \Delta u`.

Contact springs resist more or less as they close and open, so that iterates may alternate between
two sets of loaded springs. If all contact is by springs, their forces are part of the residual
above, and nothing is linearised.
"""

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk

__all__ = ["LineSearch"]

# Virtual work at the end of an increment, relative to that at its start [-], above which the
# increment is bisected; and largest number of bisections. Increments that are too short are not
# lengthened.
_LEFT, _MOST_CUTS = 0.5, 8


class LineSearch:
    """Bisection of increments along which forces exceed the linear prediction. Collective.

    Args:
        bulk: Residual of the bodies; its ``u`` moves.
        springs: Whether all contact is by springs, so that residuals contain its forces.

    Attributes:
        springs: The argument.
    """

    def __init__(self, bulk: Bulk, *, springs: bool) -> None:
        self._bulk, self.springs = bulk, springs
        self._du: Floats | None = None

    def forget(self) -> None:
        """Accept the last increment. Local."""
        self._du = None

    def begin(self, du: Floats, fraction: float, R: Floats, R_bulk: Floats) -> None:
        """Store an increment before it is applied.

        Args:
            du: Increment of Newton's method on the owned dofs, shape ``(d n,)`` [m].
            fraction: Fraction of the increment that is applied [-].
            R: Residual from which the increment was computed, shape ``(d n,)`` [N].
            R_bulk: Contribution of the bodies to ``R``, shape ``(d n,)`` [N].
        """
        self._du, self._fraction, self._cuts = du, fraction, 0
        self._short, self._long = 0.0, fraction
        self._start, self._before = self._nodes.copy(), R if self.springs else R_bulk
        work = float(-du @ R)
        if self.springs:
            self._work = self._resisted = float(reductions.total(self._bulk.comm, work))
            return
        resistance = self._bulk.rounded_action(du.reshape(self._start.shape))
        works = np.array([work, du @ resistance.ravel()])
        self._work, self._resisted = map(float, reductions.total(self._bulk.comm, works))

    def cuts(self, R: Floats) -> bool:
        """Change the applied fraction of the increment by bisection, if necessary.

        Args:
            R: Residual of the bodies after the increment, including contact if it is by springs,
                shape ``(d n,)`` [N].

        Returns:
            Whether ``u`` was changed.
        """
        if self._du is None or self._resisted <= 0 or self._cuts == _MOST_CUTS:
            return False
        change = float(reductions.total(self._bulk.comm, float(self._du @ (R - self._before))))
        # Constraints that close gaps also do work.
        work = max(self._work, self._resisted)
        rest = change + self._fraction * (work - self._resisted) - work
        if not (abs(rest) if self._cuts else rest) > _LEFT * work:
            return False
        if rest > 0:
            self._long = self._fraction
        else:
            self._short = self._fraction
        self._fraction = 0.5 * (self._short + self._long)
        self._cuts += 1
        increment = self._fraction * self._du.reshape(self._start.shape)
        self._nodes[:] = self._bulk.rigid.moved(self._start, increment)
        self._bulk.u.x.scatter_forward()
        return True

    @property
    def _nodes(self) -> Floats:
        """Displacements of the owned nodes, a view of shape ``(n, d)`` [m]."""
        u: Floats = self._bulk.u.x.array[: self._bulk.num_owned]
        return u.reshape(-1, dimension(self._bulk.u.function_space))
