"""Linear systems of Newton's method: Krylov method and its preconditioner.

The operator is the exact tangent, bulk (as an FFCx vector form) and contact,
projected by `elimination`; nothing is assembled for it. The preconditioner
is a factorisation of the bulk tangent without contact, which ages slowly
and is kept over many steps. Where the Krylov method fails the whole system
is factorised.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any
from weakref import WeakKeyDictionary

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_nts.assembly import Bulk, SaddleSystem
from dolfinx_nts.contact_rows import ContactState
from dolfinx_nts.contact_step import ContactStep
from dolfinx_nts.elimination import Elimination, coupled
from dolfinx_nts.obstacles import ObstacleNeighbourhood
from dolfinx_nts.search import Neighbourhood

__all__ = ["LinearSolver"]

Floats = npt.NDArray[np.float64]

_number = itertools.count()  # of solvers, for their prefixes

_MAX_ITERATIONS = 200
# One assembly and factorisation cost about as much as this many iterations.
_REBUILD_COST = 15.0
# More iterations per decade than this with a fresh incomplete factorisation
# cost more than a stronger preconditioner (many wave crossings in a step).
_SLOW = 15.0
# Unknowns up to which the stronger one is a complete factorisation.
_DIRECT_UP_TO = 50_000


class _Operator:
    """Context of the shell matrix: projected tangent."""

    def __init__(self, bulk: Bulk) -> None:
        self.bulk = bulk
        self.elimination = Elimination((), ())
        self.weight = 1.0  # sigma, puts E E^T on the scale of the tangent

    def apply(self, x: Floats) -> Floats:
        """Z~^T (K + C) Z x + sigma E E^T x, shape (n, 3)."""
        z = x.copy()
        parts = self.elimination.constrain(z)
        y = self.elimination.act(parts, self.bulk.action(z))
        return y + self.weight * self.elimination.given_up(x)

    def mult(self, _matrix: Any, x: Any, y: Any) -> None:
        y.array[:] = self.apply(x.array_r.reshape(-1, 3)).ravel()


class _Preconditioner:
    """Context of the shell preconditioner: kept factorisation of the bulk."""

    def __init__(self, operator: _Operator, prefix: str) -> None:
        self._operator = operator
        self._pc = PETSc.PC().create(operator.bulk.comm)
        self._pc.setOptionsPrefix(prefix)
        self._matrix: Any = None
        self._scalar: Any = None
        self.is_strong = False
        self._inverse_diagonal: Floats
        # Neighbourhoods come and go; their addresses are used again.
        self._ghosted: WeakKeyDictionary[Neighbourhood | ObstacleNeighbourhood, Floats]
        self._ghosted = WeakKeyDictionary()
        self.num_builds = 0

    def build(self) -> None:
        """Assemble the bulk tangent at u and factorise it. Collective."""
        if self._matrix is None:
            if self._operator.bulk.comm.size == 1:
                self._pc.setType("ilu")
            else:
                self._pc.setType("asm")
                self._pc.setASMOverlap(1)
            self._pc.setFromOptions()
        self._matrix = self._operator.bulk.tangent()
        if self.is_strong and self._pc.getType() == "lu":
            # MUMPS wants scalar entries.
            self._scalar = self._matrix.convert("aij", self._scalar or PETSc.Mat())
            self._pc.setOperators(self._scalar)
        else:
            self._pc.setOperators(self._matrix)
        self._pc.setUp()
        self._inverse_diagonal = self._matrix.invertBlockDiagonal().copy()
        self._ghosted.clear()
        self.num_builds += 1

    def strengthen(self) -> None:
        """Change to a complete factorisation or multigrid. Collective."""
        self.is_strong = True
        if self._matrix.getSize()[0] <= _DIRECT_UP_TO:
            self._pc.setType("lu")
            self._pc.setFactorSolverType("mumps")
        else:
            self._pc.setType("gamg")
        self._pc.setFromOptions()

    def inverse_diagonal(self, here: Neighbourhood | ObstacleNeighbourhood) -> Floats:
        """Inverse diagonal blocks on the nodes of a neighbourhood."""
        if here not in self._ghosted:
            columns = [here.with_ghosts(self._inverse_diagonal[:, :, j]) for j in range(3)]
            self._ghosted[here] = np.stack(columns, axis=2)
        return self._ghosted[here]

    def apply(self, _pc: Any, r: Any, z: Any) -> None:
        self._pc.apply(r, z)
        elimination = self._operator.elimination
        if elimination.empty:
            return
        x = z.array.reshape(-1, 3)
        elimination.constrain(x)
        x += elimination.given_up(r.array_r.reshape(-1, 3) / self._operator.weight - x)


class LinearSolver:
    """Solves for the increments of a Newton iteration.

    Args:
        bulk: Forms of the bodies.
        options: PETSc options without prefix: ``ksp_...`` for the Krylov
            method, all others for the preconditioner of the bulk.

    Attributes:
        num_iterations: Krylov iterations so far.
        num_direct: Systems that were factorised as a whole.
    """

    def __init__(self, bulk: Bulk, options: Mapping[str, Any] | None = None) -> None:
        """Create the PETSc objects, which live as long as the solver."""
        prefix = f"nts_{next(_number)}_"
        self._bulk = bulk
        self._operator = _Operator(bulk)
        n = bulk.num_owned
        self._matrix = PETSc.Mat().createPython(((n, None), (n, None)), comm=bulk.comm)
        self._matrix.setPythonContext(self._operator)
        self._matrix.setUp()
        database = PETSc.Options()
        for key, value in ({} if options is None else options).items():
            database[f"{prefix}{'' if key.startswith('ksp_') else 'bulk_'}{key}"] = value
        self._preconditioner = _Preconditioner(self._operator, f"{prefix}bulk_")
        self._ksp = PETSc.KSP().create(bulk.comm)
        self._ksp.setOptionsPrefix(prefix)
        self._ksp.setOperators(self._matrix)
        self._ksp.setType("gmres")
        self._ksp.setGMRESRestart(_MAX_ITERATIONS)
        self._ksp.setPCSide(PETSc.PC.Side.RIGHT)
        self._ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        pc = self._ksp.getPC()
        pc.setType("python")
        pc.setPythonContext(self._preconditioner)
        self._ksp.setFromOptions()
        self._x, self._b = self._matrix.createVecs()
        self._saddle = SaddleSystem(bulk)
        self._fresh_rate: float | None = None
        self._excess_iterations = 0.0
        self.num_iterations = self.num_direct = 0

    def solve(
        self,
        R: Floats,
        steps: Sequence[ContactStep],
        states: Sequence[ContactState],
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
        if coupled(steps, states):
            return self._solve_direct(R, steps, states)
        elimination = Elimination(steps, states)
        preconditioner = self._preconditioner
        fresh = preconditioner.num_builds == 0 or self._is_old()
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
        if fresh and not preconditioner.is_strong and (self._fresh_rate or 0.0) > _SLOW:
            preconditioner.strengthen()
            self._build()
        return du, None

    def _build(self) -> None:
        self._preconditioner.build()
        self._fresh_rate, self._excess_iterations = None, 0.0

    def _is_old(self) -> bool:
        return self._excess_iterations > _REBUILD_COST

    def _solve_krylov(self, R: Floats, elimination: Elimination, rtol: float) -> Floats | None:
        operator = self._operator
        operator.elimination = elimination
        r: Floats = -R.reshape(-1, 3)
        particular: Floats = np.zeros_like(r)
        if not elimination.empty:
            compliance = elimination.compliance(self._preconditioner.inverse_diagonal)
            sums = operator.bulk.comm.allreduce(
                np.array([sum(part.sum() for part in compliance), sum(map(len, compliance))])
            )
            if sums[1]:
                operator.weight = float(sums[1] / sums[0])
            particular = elimination.particular(len(r))
            parts = elimination.with_ghosts(particular)
            r = -elimination.act(parts, R.reshape(-1, 3) + self._bulk.action(particular))
        self._b.array[:] = r.ravel()
        self._ksp.setTolerances(rtol=rtol, atol=0.0, divtol=1e6, max_it=_MAX_ITERATIONS)
        self._ksp.solve(self._b, self._x)
        iterations = self._ksp.getIterationNumber()
        self.num_iterations += iterations
        if self._ksp.getConvergedReason() < 0:
            return None
        rate = iterations / max(-np.log10(rtol), 0.3)
        if self._fresh_rate is None:
            self._fresh_rate = rate
        self._excess_iterations += max(0.0, rate - self._fresh_rate) * -np.log10(rtol)
        x = self._x.array.reshape(-1, 3)
        elimination.constrain(x)
        du: Floats = (particular + x).ravel()
        return du

    def _solve_direct(
        self, R: Floats, steps: Sequence[ContactStep], states: Sequence[ContactState]
    ) -> tuple[Floats, list[Floats]]:
        self.num_direct += 1
        return self._saddle.solve(R, steps, states)
