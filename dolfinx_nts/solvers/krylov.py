"""Linear systems of Newton's method: Krylov method and its preconditioner.

The operator is the exact tangent, bulk (as an FFCx vector form) and contact,
projected by `elimination`; nothing is assembled for it. The preconditioner
is a factorisation of the bulk tangent without contact, which ages slowly
and is kept over many steps. Where the Krylov method fails the whole system
is factorised.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.elimination import Coupling, Elimination
from dolfinx_nts.solvers.preconditioner import Operator, Preconditioner
from dolfinx_nts.solvers.saddle_point import SaddlePointSystem
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["LinearSolver"]


_number = itertools.count()  # of solvers, for their prefixes

_MAX_ITERATIONS = 200
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
        num_iterations: Krylov iterations so far.
        num_direct: Systems that were factorised as a whole.

    ``str`` tells the choice of the preconditioner and counts of work.
    """

    def __init__(
        self,
        bulk: Bulk,
        tangent: Tangent,
        inertia: Callable[[], Floats],
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Create the PETSc objects, which live as long as the solver."""
        prefix = f"nts_{next(_number)}_"
        self._bulk, self.tangent, self._inertia = bulk, tangent, inertia
        self._crossings = 0.0
        self._operator = Operator(bulk)
        n = bulk.num_owned
        self._matrix = PETSc.Mat().createPython(((n, None), (n, None)), comm=bulk.comm)
        self._matrix.setPythonContext(self._operator)
        self._matrix.setUp()
        database = PETSc.Options()
        for key, value in ({} if options is None else options).items():
            database[f"{prefix}{'' if key.startswith('ksp_') else 'bulk_'}{key}"] = value
        self._preconditioner = Preconditioner(self._operator, tangent, f"{prefix}bulk_")
        self._ksp = PETSc.KSP().create(bulk.comm)
        self._ksp.setOptionsPrefix(prefix)
        self._ksp.setOperators(self._matrix)
        # Flexible: what the preconditioner gave is kept, not made once more.
        self._ksp.setType("fgmres")
        self._ksp.setGMRESRestart(_MAX_ITERATIONS)
        self._ksp.setPCSide(PETSc.PC.Side.RIGHT)
        self._ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        pc = self._ksp.getPC()
        pc.setType("python")
        pc.setPythonContext(self._preconditioner)
        self._ksp.setFromOptions()
        self._x, self._b = self._matrix.createVecs()
        self._coupling = Coupling(bulk.comm)
        self._saddle = SaddlePointSystem(tangent)
        self._age = _Age()
        self.num_iterations = self.num_direct = 0

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
        """
        elimination = Elimination(steps, states)
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
        if fresh and not preconditioner.is_strong and self._age.rate > _SLOW:
            preconditioner.strengthen()
            self._build()
        return du, None

    def __str__(self) -> str:
        """Choice of the preconditioner, and counts of work so far. Local."""
        pc = self._preconditioner
        if pc.num_builds == 0:
            return "not used so far"
        return (
            f"GMRES with {pc}, waves cross {self._crossings:.3g} cells a step; "
            f"{self.num_iterations} iterations, {pc.num_builds} factorisations, "
            f"{pc.num_patches} of patches, {self.num_direct} systems factorised as a whole"
        )

    def serialize(self, archive: Archive) -> None:
        """Serialize what is kept from step to step. Collective."""
        self._preconditioner.serialize(archive)
        age = archive.same("age_of_factors", self._age.values())
        if archive.giving:
            known = self._preconditioner.point is not None
            self._age = _Age(*age) if known else _Age()

    def _build(self) -> None:
        self._crossings = self._wave_crossings()
        if self._preconditioner.point is None and self._crossings > _MOST_CROSSINGS:
            self._preconditioner.strengthen()
        self._preconditioner.build()
        self._age = _Age()

    def _solve_krylov(self, R: Floats, elimination: Elimination, rtol: float) -> Floats | None:
        operator = self._operator
        operator.elimination = elimination
        r: Floats = -R.reshape(-1, 3)
        particular: Floats | float = 0.0
        if not elimination.empty:
            self._preconditioner.prepare()
            particular, parts = elimination.particular(len(r))
            total: Floats = R.reshape(-1, 3).copy()
            # Close to the constraints their part is below what rtol leaves.
            force = 3 * self.tangent.nodal_stiffness()[:, None] * particular
            squares = [float(np.vdot(force, force)), float(R @ R)]
            part, whole = reductions.total(self._bulk.comm, squares)
            if part > (_NEGLIGIBLE * rtol) ** 2 * whole:
                total += self._bulk.action(particular)
            r = -elimination.act(parts, total)
        self._b.array[:] = r.ravel()
        self._ksp.setTolerances(rtol=rtol, atol=0.0, divtol=1e6, max_it=_MAX_ITERATIONS)
        self._ksp.solve(self._b, self._x)
        iterations = self._ksp.getIterationNumber()
        self.num_iterations += iterations
        if self._ksp.getConvergedReason() < 0:
            return None
        self._age.count(iterations, -math.log10(rtol))
        x = self._x.array.reshape(-1, 3)
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
        greatest = reductions.largest(self._bulk.comm, ratio.max(initial=0.0))
        return float(np.sqrt(2 * greatest))

    def _solve_direct(
        self, R: Floats, steps: Sequence[ContactStep], states: Sequence[ContactContribution]
    ) -> tuple[Floats, list[Floats]]:
        self.num_direct += 1
        return self._saddle.solve(R, steps, states)
