"""Choice of new or stronger factors of the bulk, if they save time."""

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.linear.projected_krylov import Operator
from dolfinx_nts.solvers.precond.preconditioner import BulkPreconditioner
from dolfinx_nts.solvers.precond.tangent import Tangent

__all__ = ["FactorAge"]

# Cost of assembling and factorising the bulk, in Krylov iterations; the strongest
# factors cost more.
_REBUILD_COST, _STRONG_REBUILD_COST = 15.0, 40.0
# Largest number of iterations [-] with the strongest complete factors. It is their cost plus the
# cost of factors of the complete system, in iterations.
_MOST_ITERATIONS = 80
# Iterations per decade of reduction [-] above which stronger factors are cheaper than new factors
# of the same kind; above which ILU(1) is cheaper than ILU(0), with the number of decades over which
# they are measured; and above which factors of the derivative replace complete factors of the
# approximate matrix.
_SLOW, _SLOW_ILU0, _LEAST_DECADES, _SLOW_NEARBY = 15.0, 6.0, 4.0, 4.0
# Courant number above which strong factors are used from the start.
_MOST_CROSSINGS = 50.0
# Decades of reduction over which the iterations of new factors are measured, about as many as in a
# step; and ratio of later iterations to these below which the reference is lowered, as contact had
# increased it.
_DECADES, _EASIER = 12.0, 0.7
# Lower bound on the reduction by one application of the preconditioner [-]: unlike a Krylov
# iteration, it does not scale its result.
_UNSCALED = 0.1
# Lower bound on the reduction of the residual in a solve, in decades [-], since every solve takes
# at least one iteration.
_FEWEST_DECADES = 0.3
# Ratio of inertia to stiffness [-] that counts as no inertia.
_NO_INERTIA = 1e-30


@dataclass
class _SolveCounts:
    """Iterations of some solves, and their reduction of the residual in decades."""

    iterations: float = 0.0
    decades: float = 0.0

    @property
    def rate(self) -> float:
        """Iterations per decade."""
        return self.iterations / max(self.decades, _FEWEST_DECADES)

    def add(self, iterations: int, decades: float) -> None:
        self.iterations += iterations
        self.decades += decades


class FactorAge:
    """Decision when to factorise the bulk again, by the additional iterations with old factors.

    Args:
        tangent: Matrix of the bulk.
        factors: Its preconditioner.
        operator: The projected tangent, whose precision is measured again with new factors.
        inertia: Argument of `LinearSolver`.

    Attributes:
        crossings: Estimated Courant number of the step in which the factors were computed.
    """

    def __init__(
        self,
        tangent: Tangent,
        factors: BulkPreconditioner,
        operator: Operator,
        inertia: Callable[[], Floats],
    ) -> None:
        self._tangent, self._factors, self._operator = tangent, factors, operator
        self._inertia = inertia
        self.crossings = 0.0
        self._begin()

    def _begin(self) -> None:
        """Reset the counts of solves: the first decades, recent decades, and decades in contact."""
        self._first, self._last, self._in_contact = _SolveCounts(), _SolveCounts(), _SolveCounts()
        # Iterations per decade with new factors, NaN until measured, and accumulated number of
        # iterations in excess of these.
        self._fresh, self._excess = math.nan, 0.0

    @property
    def one_application_reduction(self) -> float:
        """Reduction by one application of the preconditioner in contact. Local.

        It is at least 0.1, and NaN if it is unknown. Solves without contact are not counted.
        """
        seen = self._in_contact
        if not (self._factors.is_ilu0 and seen.decades >= _DECADES and seen.iterations > 0):
            return math.nan
        return max(float(10 ** (-1 / seen.rate)), _UNSCALED)

    @property
    def most_iterations(self) -> int | None:
        """Number of iterations after which factors of the complete system are cheaper. Local.

        None if there are stronger factors of the bulk, or multigrid instead.
        """
        return _MOST_ITERATIONS if self._factors.is_of_derivative else None

    def are_slower_than_complete(self, iterations: int) -> bool:
        """Whether the iterations of a solve cost more than complete factors. Local."""
        return self._factors.is_of_derivative and iterations > _STRONG_REBUILD_COST

    def count(self, iterations: int, decades: float, *, in_contact: bool = False) -> None:
        """Count the iterations of a solve. Local."""
        if in_contact:
            self._in_contact.add(iterations, decades)
        if math.isnan(self._fresh):
            self._first.add(iterations, decades)
            if self._first.decades >= _DECADES:
                self._fresh = self._first.rate
            return
        self._excess += iterations - self._fresh * decades
        self._last.add(iterations, decades)
        if self._last.decades >= _DECADES:
            rate, self._last = self._last.rate, _SolveCounts()
            if rate < _EASIER * self._fresh:
                self._fresh, self._excess = rate, 0.0

    def renew(self) -> bool:
        """Factorise again if that saves time; return whether factors are new. Collective."""
        factors = self._factors
        cost = _STRONG_REBUILD_COST if factors.is_strong else _REBUILD_COST
        is_due = factors.point is None or self._excess > cost
        if is_due:
            self.build()
        return is_due

    def build(self) -> None:
        """Factorise the current matrix, and reset the age of the factors. Collective."""
        factors = self._factors
        self.crossings = self._wave_crossings()
        is_first = factors.point is None
        if is_first and factors.may_be_strengthened and self.crossings > _MOST_CROSSINGS:
            factors.strengthen(fully=True)
        factors.build()
        self._operator.forget()
        self._begin()

    def strengthen_if_slow(self, is_new: bool) -> None:
        """Replace the factors by stronger ones if these are cheaper. Collective.

        Args:
            is_new: Whether the current factors were computed for the last system.
        """
        factors = self._factors
        if not factors.may_be_strengthened:
            return
        shown, rate = self._first.decades > _LEAST_DECADES, self._first.rate
        is_slow = (is_new or shown) and rate > _SLOW
        needs_fill = factors.is_ilu0 and shown and rate > _SLOW_ILU0
        is_far = factors.is_complete and self._fresh > _SLOW_NEARBY
        if is_slow or needs_fill or is_far:
            factors.strengthen()
            self.build()

    def serialize(self, archive: Archive) -> None:
        """Serialize the age, after the factors. Collective."""
        paces = self._first, self._last, self._in_contact
        age = np.array([self._fresh, self._excess, *np.ravel([astuple(pace) for pace in paces])])
        age = archive.same("age_of_factors", age)
        if not archive.restores:
            return
        self._begin()
        if self._factors.point is not None:
            numbers = [float(number) for number in age]
            self._fresh, self._excess = numbers[:2]
            self._first, self._last, self._in_contact = map(
                _SolveCounts, numbers[2::2], numbers[3::2]
            )

    def _wave_crossings(self) -> float:
        """Courant number c h/dx, the number of cells that waves cross in a step. Collective.

        In a chain of lumped masses m with the wave speed c, K_ii/m is 2 (c/dx)^2. The tangent of a
        step is the sum of K/2 and 2 m/h^2.
        """
        stiffness = self._tangent.nodal_stiffness()
        inertia = self._inertia().reshape(-1, self._operator.bulk.rigid.dim)[:, 0]
        # Without inertia the number is infinite.
        moves = inertia > _NO_INERTIA * stiffness
        infinite = np.where(stiffness > 0, np.inf, 0.0)
        ratio = np.where(moves, stiffness, infinite) / np.where(moves, inertia, 1.0)
        greatest = reductions.largest(self._tangent.comm, ratio.max(initial=0.0))
        return float(np.sqrt(2 * greatest))
