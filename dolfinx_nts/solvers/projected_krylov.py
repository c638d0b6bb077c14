"""Krylov method on the projected tangent, with its preconditioner."""

import math
from collections.abc import Callable
from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.contact_corrections import ContactCorrections
from dolfinx_nts.solvers.elimination import Elimination
from dolfinx_nts.solvers.falling_motion import falling_motion
from dolfinx_nts.solvers.petsc_options import PetscOptions
from dolfinx_nts.solvers.preconditioner import BulkPreconditioner
from dolfinx_nts.solvers.rigid_motion import RigidMotion
from dolfinx_nts.solvers.shells import shell_matrix, use_shell
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["KrylovMethod", "Operator", "Preconditioner", "RigidPreconditioner"]

# Iterations of one system, which are all stored; new factors cost less than more.
_MAX_ITERATIONS = 200
# Growth of the residual at which an iteration is given up [-].
_DIVERGED = 1e6
# Rounding of products relative to the reduction that is still asked for, at which it does not
# matter [-]: what products contribute to the solution becomes smaller as the residual does.
_NEGLIGIBLE = 0.3
# Relative error of products [-] that is enough to look for negative curvatures.
_ENOUGH = 1e-3


class Operator:
    """Context of the shell matrix: projected tangent.

    Right-hand sides and products have no part in the directions that
    nodes give up, and such a part of what is multiplied has no effect. Products are
    computed with half of the digits where that leaves the convergence as it is: Newton's method
    computes the residual in double precision, and only that decides on its result.

    Args:
        bulk: Residual of the bodies.

    Attributes:
        bulk: The residual.
        elimination: Contacts of this Newton iteration.
        reduction: Gives the reduction of the residual that is still asked for [-].
    """

    def __init__(self, bulk: Bulk) -> None:
        """Create the operator, without contact."""
        self.bulk = bulk
        self.elimination = Elimination((), 0)
        self.reduction: Callable[[], float] = float
        self._rounding = math.inf

    def forget(self) -> None:
        """Measure at the next product what single precision costs it. Local."""
        self._rounding = math.inf

    def serialize(self, archive: Archive) -> None:
        """Serialize what decides on the precision of products. Collective."""
        self._rounding = archive.same("rounding_of_products", self._rounding)

    def mult(self, _matrix: Any, x: Any, y: Any) -> None:
        """Set y to Z~^T (K + C) Z x; called by PETSc."""
        z = x.array_r.reshape(-1, self.bulk.rigid.dim).copy()
        parts = self.elimination.constrain(z)
        if math.isinf(self._rounding):
            self._rounding = self.bulk.rounding(z)
        product = self.action(z, _NEGLIGIBLE * self.reduction())
        forces = self.elimination.act(parts, product)
        y.array[:] = self.bulk.rigid.project(z, forces).ravel()

    def action(self, z: Floats, error: float) -> Floats:
        """Tangent of the bodies times a vector, with a relative error up to ``error``."""
        is_enough = self._rounding < error
        return self.bulk.rounded_action(z) if is_enough else self.bulk.action(z)


class Preconditioner:
    """Context of the shell preconditioner: that of the bulk, corrected around contacts.

    Args:
        operator: The operator.
        bulk: Preconditioner of the bulk.
        contacts: Correction for the contacts.
    """

    def __init__(
        self, operator: Operator, bulk: BulkPreconditioner, contacts: ContactCorrections
    ) -> None:
        """Create the composition of both."""
        self._operator, self._bulk, self._contacts = operator, bulk, contacts

    def apply(self, pc: Any, r: Any, z: Any) -> None:
        """Set z to the approximate solution for r; called by PETSc."""
        self._bulk.apply(pc, r, z)
        if not self._operator.elimination.empty:
            dim = self._operator.bulk.rigid.dim
            self._contacts.correct(r.array_r.reshape(-1, dim), z.array.reshape(-1, dim))


class RigidPreconditioner:
    """Context of the shell preconditioner with rigid bodies.

    They move as their inertia alone lets them, and all other nodes follow them.

    Args:
        others: Preconditioner of the other nodes.
        rigid: Motion of the rigid bodies.
        tangent: Matrix of the bulk, which holds their nodes.
    """

    def __init__(self, others: Preconditioner, rigid: RigidMotion, tangent: Tangent) -> None:
        """Let the matrix hold the nodes of rigid bodies."""
        self._others, self._rigid = others, rigid
        self._holding = tangent.hold(rigid.nodes)

    def apply(self, pc: Any, r: Any, z: Any) -> None:
        """Set z to the approximate solution for r; called by PETSc."""
        forces, nodes = r.copy(), self._rigid.nodes
        known, unknown = (v.array.reshape(-1, self._rigid.dim) for v in (forces, z))
        motion = self._rigid.respond(known.copy())[nodes]
        known[nodes] = self._holding * motion
        self._others.apply(pc, forces, z)
        unknown[nodes] = motion
        forces.destroy()


class KrylovMethod:
    """Iterations of flexible GMRES, or of another method by the user's options.

    Args:
        operator: Context of the shell matrix.
        preconditioner: Context of the shell preconditioner.
        options: Options of the user.

    Attributes:
        num_iterations: Iterations so far.
        num_local_iterations: Those beside them of systems of few nodes.
    """

    def __init__(
        self,
        operator: Operator,
        preconditioner: Preconditioner | RigidPreconditioner,
        options: PetscOptions,
    ) -> None:
        """Create the PETSc objects, which live as long as the solver."""
        comm, n = operator.bulk.comm, operator.bulk.num_owned
        self._operator, self._preconditioner = operator, preconditioner
        matrix = shell_matrix(comm, (n, None), operator)
        matrix.setUp()
        self._options: PetscOptions | None = options  # until they are known to be used
        self._ksp = PETSc.KSP().create(comm)
        self._ksp.setOptionsPrefix(options.prefix)
        self._ksp.setOperators(matrix)
        # Flexible: it stores what the preconditioner gave, instead of applying it once more.
        self._ksp.setType("fgmres")
        self._ksp.setGMRESRestart(_MAX_ITERATIONS)
        self._ksp.setPCSide(PETSc.PC.Side.RIGHT)
        self._ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        use_shell(self._ksp.getPC(), preconditioner)
        with options.understood():
            self._ksp.setFromOptions()
        self._x, self._b = matrix.createVecs()
        self.num_iterations = self.num_local_iterations = 0

    def solve(self, b: Floats, rtol: float, *, is_local: bool = False) -> tuple[Floats | None, int]:
        """Solve with the present operator. Collective.

        Args:
            b: Right-hand side at the owned nodes, shape ``(n, d)``.
            rtol: Reduction of the residual.
            is_local: Whether all but few nodes are given.

        Returns:
            The solution, a view that the next call overwrites, or None where
            the method fails; number of iterations.

        Raises:
            ValueError: There are options that nothing asks for.
        """
        self._b.array[:] = b.ravel()
        target = rtol * self._b.norm()
        self._operator.reduction = lambda: target / max(self._ksp.getResidualNorm(), target)
        self._ksp.setTolerances(rtol=rtol, atol=0.0, divtol=_DIVERGED, max_it=_MAX_ITERATIONS)
        self._ksp.solve(self._b, self._x)
        iterations = int(self._ksp.getIterationNumber())
        if is_local:
            self.num_local_iterations += iterations
        else:
            self.num_iterations += iterations
        if self._options is not None and iterations > 0:
            self._options.check_used()
            self._options = None
        if self._ksp.getConvergedReason() < 0:
            return None, iterations
        return self._x.array.reshape(-1, self._operator.bulk.rigid.dim), iterations

    def solve_roughly(self, b: Floats) -> Floats:
        """Solve as well as the preconditioner does by itself, in one iteration. Collective.

        Args:
            b: Right-hand side at the owned nodes, shape ``(n, d)``.

        Returns:
            The solution, the same shape.
        """
        self.num_iterations += 1
        return self._preconditioned(b)

    def _preconditioned(self, r: Floats) -> Floats:
        self._b.array[:] = r.ravel()
        self._preconditioner.apply(None, self._b, self._x)
        x: Floats = self._x.array.copy()
        x[self._operator.bulk.given] = 0
        x = x.reshape(r.shape)
        self._operator.elimination.constrain(x)
        return x

    def falling_motion(self, weight: Floats, numbers: Floats) -> Floats | None:
        """Motion along which the energy falls, by the present operator. Collective.

        Args:
            weight: Square root of the stiffness at the owned nodes, shape ``(n, 1)``.
            numbers: Independent random numbers of unit variance, shape ``(n, d)``.

        Returns:
            The motion at the owned nodes, shape ``(n, d)``, or None.
        """
        bulk, elimination = self._operator.bulk, self._operator.elimination

        def free(values: Floats) -> Floats:
            """Set values of what is given to zero, shape ``(d n,)``."""
            values = values.ravel()
            values[bulk.given] = 0
            return values

        def precondition(r: Floats) -> Floats:
            return self._preconditioned(r.reshape(numbers.shape)).ravel()

        def act(p: Floats) -> Floats:
            self._b.array[:] = p
            self._operator.mult(None, self._b, self._x)
            return free(self._x.array.copy())

        self._operator.reduction = lambda: _ENOUGH
        rest = np.zeros(numbers.shape)
        b = elimination.act(elimination.constrain(rest), weight * numbers)
        b = free(bulk.rigid.project(None, b))
        weights = np.broadcast_to(weight, numbers.shape).ravel()
        motion = falling_motion(bulk.comm, b, weights, precondition, act)
        if motion is None:
            return None
        self._operator.reduction = float  # to all digits: no round-off is told
        curvature = reductions.total(bulk.comm, float(motion @ act(motion)))
        return motion.reshape(numbers.shape) if curvature < 0 else None
