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

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_nts.archive import Archive
from dolfinx_nts.assembly import Bulk, SaddleSystem
from dolfinx_nts.contact_rows import ContactState
from dolfinx_nts.contact_step import ContactStep
from dolfinx_nts.elimination import Elimination, coupled
from dolfinx_nts.patch import Patch

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
# On several ranks the order of the unknowns decides: reverse Cuthill-McKee, the
# order of DOLFINx on one rank, needs 7 iterations for 8 decades, without it 12.
_ON_RANKS = {
    "pc_asm_overlap": 1,
    "sub_pc_type": "ilu",
    "sub_pc_factor_mat_ordering_type": "rcm",
}
# One sweep with incomplete factors smooths best (elasticity of stiff bodies).
_MULTIGRID = {
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "asm",
    "mg_levels_sub_pc_type": "ilu",
}
# Iterations per decade of fresh factors are taken over this many decades,
# about those of a step.
_DECADES = 12.0
# Of the reduction asked for: what a right-hand side may leave out.
_NEGLIGIBLE = 0.03


class _Operator:
    """Context of the shell matrix: projected tangent.

    Right-hand sides and products have no part in the directions that
    nodes give up, and such a part of what is multiplied has no effect.
    """

    def __init__(self, bulk: Bulk) -> None:
        self.bulk = bulk
        self.elimination = Elimination((), ())

    def mult(self, _matrix: Any, x: Any, y: Any) -> None:
        """Z~^T (K + C) Z x."""
        z = x.array_r.reshape(-1, 3).copy()
        parts = self.elimination.constrain(z)
        y.array[:] = self.elimination.act(parts, self.bulk.action(z)).ravel()


class _Preconditioner:
    """Context of the shell preconditioner: kept factors and a patch.

    The factors are of the bulk and age slowly; the patch is of the
    contacts of this Newton iteration (`cpp/nts/patch.h`).
    """

    def __init__(self, operator: _Operator, prefix: str) -> None:
        self._operator = operator
        self._pc = PETSc.PC().create(operator.bulk.comm)
        self._pc.setOptionsPrefix(prefix)
        self._matrix: Any = None
        self._scalar: Any = None
        self._patch: Patch | None = None
        self.is_strong = False
        self.point: Sequence[npt.NDArray[Any]] | None = None  # `Bulk.point` of the factors
        self.num_builds = 0

    def build(self) -> None:
        """Assemble the bulk tangent at u and factorise it. Collective."""
        if self._matrix is None:
            if self._operator.bulk.comm.size == 1:
                self._use("ilu", {})
            else:
                self._use("asm", _ON_RANKS)
        self._matrix = self._operator.bulk.tangent()
        if self.is_strong:
            # What a first factorisation chose would last.
            self._pc.reset()
        if self.is_strong and self._pc.getType() in ("lu", "gamg"):
            # They want scalar entries.
            self._scalar = self._matrix.convert("aij", self._scalar or PETSc.Mat())
            if self._pc.getType() == "gamg":
                self._scalar.setBlockSize(3)
                self._scalar.setNearNullSpace(self._operator.bulk.rigid_modes())
            self._pc.setOperators(self._scalar)
        else:
            self._pc.setOperators(self._matrix)
        self._pc.setUp()
        self.point = self._operator.bulk.point
        self.num_builds += 1

    def exchange(self, archive: Archive) -> None:
        """Exchange where factors and patch were made. Collective."""
        bulk = self._operator.bulk
        shared = archive.same("factors_are_last", self.point is bulk.point)
        strong = archive.same("factors_are_strong", self.is_strong)
        last = archive.local("tangent", bulk.point)
        point = last if shared else archive.local("factors", self.point)
        if archive.giving and not (last is bulk.point and point is self.point):
            self._restore(point, last, strong)
        if self._patch is None and bulk.point is not None:
            self._patch = Patch(bulk.rows)
        if self._patch is not None:
            self._patch.exchange(archive, bulk.num_tangents)

    def _restore(
        self,
        point: Sequence[npt.NDArray[Any]] | None,
        last: Sequence[npt.NDArray[Any]] | None,
        strong: bool,
    ) -> None:
        bulk = self._operator.bulk
        self._matrix, self.is_strong, self.point = None, False, None
        bulk.forget()
        if point is not None:
            with bulk.at(point):
                self.build()
                if strong:
                    self.strengthen()
                    self.build()
        if last is not None and last is not point:
            with bulk.at(last):
                bulk.tangent()

    def strengthen(self) -> None:
        """Change to a complete factorisation or multigrid. Collective."""
        self.is_strong = True
        if self._matrix.getSize()[0] <= _DIRECT_UP_TO:
            self._use("lu", {"pc_factor_mat_solver_type": "mumps"})
        else:
            self._use("gamg", _MULTIGRID)

    def _use(self, kind: str, defaults: Mapping[str, Any]) -> None:
        """Set type and options, but for what the user has set."""
        options, prefix = PETSc.Options(), self._pc.getOptionsPrefix()
        self._pc.setType(kind)
        if options.getString(f"{prefix}pc_type", kind) == kind:
            for key, value in defaults.items():
                if not options.hasName(prefix + key):
                    options[prefix + key] = value
        self._pc.setFromOptions()

    def prepare(self) -> None:
        """Bring the patch up to the present pairs and factors. Collective."""
        if self._patch is None:
            self._patch = Patch(self._operator.bulk.rows)
        self._patch.update(self._operator.elimination, self._operator.bulk.num_tangents)

    def apply(self, _pc: Any, r: Any, z: Any) -> None:
        self._pc.apply(r, z)
        elimination = self._operator.elimination
        if elimination.empty:
            return
        assert self._patch is not None
        x = z.array.reshape(-1, 3)
        elimination.constrain(x)
        self._patch.correct(r.array_r.reshape(-1, 3), x)


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
        self._age = _Age()
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
        fresh = preconditioner.point is None or self._age.excess > _REBUILD_COST
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

    def exchange(self, archive: Archive) -> None:
        """Exchange what is kept from step to step. Collective."""
        self._preconditioner.exchange(archive)
        age = archive.same("age_of_factors", self._age.values())
        if archive.giving:
            known = self._preconditioner.point is not None
            self._age = _Age(*age) if known else _Age()

    def _build(self) -> None:
        self._preconditioner.build()
        self._age = _Age()

    def _solve_krylov(self, R: Floats, elimination: Elimination, rtol: float) -> Floats | None:
        operator = self._operator
        operator.elimination = elimination
        r: Floats = -R.reshape(-1, 3)
        particular: Floats = np.zeros_like(r)
        if not elimination.empty:
            self._preconditioner.prepare()
            particular = elimination.particular(len(r))
            parts = elimination.with_ghosts(particular)
            total: Floats = R.reshape(-1, 3)
            # Close to the constraints their part is below what rtol leaves.
            force = 3 * self._bulk.nodal_stiffness()[:, None] * particular
            sums = self._bulk.comm.allreduce(np.array([np.vdot(force, force), R @ R]))
            if sums[0] > (_NEGLIGIBLE * rtol) ** 2 * sums[1]:
                total = total + self._bulk.action(particular)
            r = -elimination.act(parts, total)
        self._b.array[:] = r.ravel()
        self._ksp.setTolerances(rtol=rtol, atol=0.0, divtol=1e6, max_it=_MAX_ITERATIONS)
        self._ksp.solve(self._b, self._x)
        iterations = self._ksp.getIterationNumber()
        self.num_iterations += iterations
        if self._ksp.getConvergedReason() < 0:
            return None
        self._age.count(iterations, -np.log10(rtol))
        x = self._x.array.reshape(-1, 3)
        elimination.constrain(x)
        du: Floats = (particular + x).ravel()
        return du

    def _solve_direct(
        self, R: Floats, steps: Sequence[ContactStep], states: Sequence[ContactState]
    ) -> tuple[Floats, list[Floats]]:
        self.num_direct += 1
        return self._saddle.solve(R, steps, states)
