"""Linear systems of Newton's method: Krylov method and its preconditioner.

The operator is the exact tangent, bulk (as an FFCx vector form) and contact,
projected by `elimination`; nothing is assembled for it. The preconditioner
is a factorisation of the bulk tangent without contact, which ages slowly
and is kept over many steps. Where the Krylov method fails the whole system
is factorised.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.active_sets import ActiveSets, Coupling
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.contact_schwarz import ContactSchwarz
from dolfinx_nts.solvers.elimination import Elimination, active_pairs
from dolfinx_nts.solvers.petsc_options import PetscOptions
from dolfinx_nts.solvers.preconditioner import BulkPreconditioner
from dolfinx_nts.solvers.projected_krylov import KrylovMethod, Operator, Preconditioner
from dolfinx_nts.solvers.saddle_point import SaddlePointSystem
from dolfinx_nts.solvers.statistics import SolverStatistics
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["LinearSolver"]

# One assembly and factorisation cost about as much as this many iterations, of
# the stronger preconditioner more.
_REBUILD_COST, _STRONG_REBUILD_COST = 15.0, 40.0
# More iterations per decade than this with a fresh incomplete factorisation
# cost more than a stronger preconditioner (many wave crossings in a step).
_SLOW = 15.0
# The same is known beforehand where waves cross this many cells in a step.
_MOST_CROSSINGS = 50.0
# Iterations per decade of fresh factors are taken over this many decades,
# about those of a step.
_DECADES = 12.0
# Of the reduction asked for: what a right-hand side may leave out.
_NEGLIGIBLE = 0.03


class _Age:
    """What the age of factors costs.

    Attributes:
        rate: Iterations per decade so far.
        excess: Iterations beyond those that fresh factors would need.
    """

    def __init__(
        self,
        iterations: float = 0.0,
        decades: float = 0.0,
        fresh: float = np.nan,
        excess: float = 0.0,
    ) -> None:
        self._iterations, self._decades = iterations, decades
        self._fresh, self.excess = fresh, excess  # iterations per decade of fresh factors

    def values(self) -> Floats:
        """What the constructor takes."""
        return np.array([self._iterations, self._decades, self._fresh, self.excess])

    @property
    def rate(self) -> float:
        return self._iterations / max(self._decades, 0.3)

    def count(self, iterations: int, decades: float) -> None:
        """Add a solve."""
        if np.isnan(self._fresh):
            self._iterations += iterations
            self._decades += decades
            if self._decades >= _DECADES:
                self._fresh = self.rate
        else:
            self.excess += iterations - self._fresh * decades


class LinearSolver:
    """Solves for the increments of a Newton iteration.

    Args:
        bulk: Residual of the bodies.
        tangent: Matrix of its derivative.
        inertia: Share of lumped inertia in the tangent at the owned dofs,
            shape ``(3 n,)`` [N/m]; 0 without inertia.
        options: PETSc options without prefix: ``ksp_...`` for the Krylov
            method, all others for the preconditioner of the bulk.

    Attributes:
        tangent: The matrix.
        num_direct: Systems that were factorised as a whole.

    Raises:
        ValueError: The preconditioner does not exist on several ranks.
    """

    def __init__(
        self,
        bulk: Bulk,
        tangent: Tangent,
        inertia: Callable[[], Floats],
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Create the Krylov method and its preconditioner, without factors."""
        self.tangent, self._inertia = tangent, inertia
        known = PetscOptions(bulk.comm, options)
        self._operator = Operator(bulk)
        self._preconditioner = BulkPreconditioner(tangent, known)
        self._schwarz = ContactSchwarz(tangent)
        context = Preconditioner(self._operator, self._preconditioner, self._schwarz)
        self._krylov = KrylovMethod(self._operator, context, known)
        self._active_sets = ActiveSets(bulk.comm)
        self._coupling = Coupling(bulk.comm)
        self._saddle = SaddlePointSystem(tangent)
        self._age = _Age()
        self._crossings = 0.0
        self.num_direct = 0

    @property
    def num_iterations(self) -> int:
        """Krylov iterations so far."""
        return self._krylov.num_iterations

    def solve(
        self,
        R: Floats,
        steps: Sequence[ContactStep],
        states: Sequence[ContactContribution],
        rtol: float,
    ) -> tuple[Floats, list[Floats] | None]:
        """Increments of one Newton iteration. Collective.

        Args:
            R: Residual on the owned dofs, shape ``(3 n,)`` [N].
            steps: Contact attempts.
            states: Their pairs.
            rtol: Reduction of the projected residual.

        Returns:
            du on the owned dofs [m]; and dlambda_N of the active pairs
            [N] if the whole system was solved, otherwise None.

        Raises:
            ValueError: There are PETSc options that nothing asks for.
        """
        pairs = active_pairs(steps, states)
        elimination = Elimination(pairs, self._active_sets.number(pairs))
        if self._coupling.of(elimination):
            return self._solve_direct(R, steps, states)
        preconditioner = self._preconditioner
        cost = _STRONG_REBUILD_COST if preconditioner.is_strong else _REBUILD_COST
        fresh = preconditioner.point is None or self._age.excess > cost
        if fresh:
            self._build()
        while (du := self._solve_krylov(R, elimination, rtol)) is None:
            # First a new factorisation, then a stronger one, then all of it.
            if fresh and preconditioner.is_strong:
                return self._solve_direct(R, steps, states)
            if fresh:
                preconditioner.strengthen()
            self._build()
            fresh = True
        if fresh and preconditioner.gives_way and self._age.rate > _SLOW:
            preconditioner.strengthen()
            self._build()
        return du, None

    @property
    def statistics(self) -> SolverStatistics:
        """Work so far. Local."""
        bulk, preconditioner = self._operator.bulk, self._preconditioner
        return SolverStatistics(
            preconditioner=str(preconditioner),
            is_strong=preconditioner.is_strong,
            wave_crossings=self._crossings,
            num_iterations=self.num_iterations,
            num_builds=preconditioner.num_builds,
            num_schwarz_builds=self._schwarz.num_builds,
            num_direct=self.num_direct,
            num_residuals=bulk.num_residuals,
            num_actions=bulk.num_actions,
            num_tangents=self.tangent.num_assembled,
            num_cells=bulk.num_cells,
        )

    def serialize(self, archive: Archive) -> None:
        """Serialize what is kept from step to step. Collective."""
        self._preconditioner.serialize(archive)
        self._active_sets.serialize(archive)
        self._schwarz.serialize(archive, self._active_sets.version)
        age = archive.same("age_of_factors", self._age.values())
        if archive.giving:
            known = self._preconditioner.point is not None
            self._age = _Age(*age) if known else _Age()

    def _build(self) -> None:
        preconditioner = self._preconditioner
        self._crossings = self._wave_crossings()
        is_first = preconditioner.point is None
        if is_first and preconditioner.gives_way and self._crossings > _MOST_CROSSINGS:
            preconditioner.strengthen()
        preconditioner.build()
        self._age = _Age()

    def _solve_krylov(self, R: Floats, elimination: Elimination, rtol: float) -> Floats | None:
        bulk = self._operator.bulk
        self._operator.elimination = elimination
        r: Floats = -R.reshape(-1, 3)
        particular: Floats | float = 0.0
        if not elimination.empty:
            self._schwarz.update(elimination)
            particular, parts = elimination.particular(len(r))
            total: Floats = R.reshape(-1, 3).copy()
            # Close to the constraints their part is below what rtol leaves.
            force = 3 * self.tangent.nodal_stiffness()[:, None] * particular
            squares = [float(np.vdot(force, force)), float(R @ R)]
            part, whole = reductions.total(bulk.comm, squares)
            if part > (_NEGLIGIBLE * rtol) ** 2 * whole:
                total += bulk.action(particular)
            r = -elimination.act(parts, total)
        x, iterations = self._krylov.solve(r, rtol)
        if x is None:
            return None
        self._age.count(iterations, -math.log10(rtol))
        elimination.constrain(x)
        du: Floats = (particular + x).ravel()
        return du

    def _wave_crossings(self) -> float:
        """Cells that waves cross in a step, about h c/dx. Collective.

        In a chain of lumped masses m, waves of speed c give K_ii/m =
        2 (c/dx)^2; half of K and 2 m/h^2 make the tangent of a step.
        """
        stiffness, inertia = self.tangent.nodal_stiffness(), self._inertia().reshape(-1, 3)[:, 0]
        # Without inertia any number of cells; nodes may have no stiffness either.
        ratio = stiffness / np.maximum(inertia, np.maximum(1e-30 * stiffness, 1e-300))
        comm = self._operator.bulk.comm
        greatest = reductions.largest(comm, ratio.max(initial=0.0))
        return float(np.sqrt(2 * greatest))

    def _solve_direct(
        self, R: Floats, steps: Sequence[ContactStep], states: Sequence[ContactContribution]
    ) -> tuple[Floats, list[Floats]]:
        self.num_direct += 1
        return self._saddle.solve(R, steps, states)
