"""Krylov method for the projected tangent, with its preconditioner."""

import math
from collections.abc import Callable

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.linear.elimination import Elimination
from dolfinx_nts.solvers.linear.petsc_krylov import PetscKrylov
from dolfinx_nts.solvers.linear.petsc_options import PetscOptions
from dolfinx_nts.solvers.precond.contact_corrections import ContactCorrections
from dolfinx_nts.solvers.precond.preconditioner import BulkPreconditioner
from dolfinx_nts.solvers.precond.tangent import Tangent
from dolfinx_nts.solvers.rigid.rigid_motion import RigidMotion
from dolfinx_nts.solvers.statics.negative_curvature import negative_curvature_direction

__all__ = ["KrylovMethod", "Operator", "Preconditioner", "RigidPreconditioner"]

# Largest number of iterations for one system; beyond it new factors are cheaper. All vectors are
# stored.
_MAX_ITERATIONS = 200
# Growth of the residual that counts as divergence [-].
_DIVERGED = 1e6
# Admissible error of products in single precision, relative to the remaining reduction [-]: inexact
# Krylov methods tolerate errors that grow as the residual decreases.
_NEGLIGIBLE = 0.3
# Relative error of products [-] in the search for negative curvature.
_ENOUGH = 1e-3


class Operator:
    """Projected tangent.

    Right-hand sides and products have no component in eliminated directions, and such components of
    the argument have no effect. Products are computed in single precision where this does not
    impair convergence. Newton's method computes the residual in double precision, which determines
    its result.

    Args:
        bulk: Residual of the bodies.

    Attributes:
        bulk: The residual.
        elimination: Elimination of the active contacts of this Newton iteration.
    """

    def __init__(self, bulk: Bulk) -> None:
        self.bulk = bulk
        self.elimination = Elimination((), 0)
        self._rounding = math.inf

    def forget(self) -> None:
        """Measure the error of single precision again at the next product. Local."""
        self._rounding = math.inf

    def serialize(self, archive: Archive) -> None:
        """Serialize the error of products in single precision. Collective."""
        self._rounding = archive.same("rounding_of_products", self._rounding)

    def act(self, x: Floats, reduction: float) -> Floats:
        """Product Z~^T (K + C) Z x. Collective.

        Args:
            x: Vector at the owned nodes, shape ``(n, d)``, overwritten with Z x.
            reduction: Remaining reduction of the residual [-].
        """
        ghosted = self.elimination.constrain(x)
        if math.isinf(self._rounding):
            self._rounding = self.bulk.rounding(x)
        product = self.action(x, _NEGLIGIBLE * reduction)
        return self.bulk.rigid.project(x, self.elimination.act(ghosted, product))

    def action(self, z: Floats, error: float) -> Floats:
        """Tangent of the bodies times a vector, with a relative error of at most ``error``."""
        is_enough = self._rounding < error
        return self.bulk.rounded_action(z) if is_enough else self.bulk.action(z)


class Preconditioner:
    """Preconditioner of the bulk with the contact correction.

    Args:
        operator: The operator.
        bulk: Preconditioner of the bulk.
        contacts: Contact correction.
    """

    def __init__(
        self, operator: Operator, bulk: BulkPreconditioner, contacts: ContactCorrections
    ) -> None:
        self._operator, self._bulk, self._contacts = operator, bulk, contacts

    def solve(self, r: Floats) -> Floats:
        """Approximate solution for r, nodal vectors of shape ``(n, d)``. Collective."""
        z = self._bulk.solve(r)
        if not self._operator.elimination.empty:
            self._contacts.correct(r, z)
        return z


class RigidPreconditioner:
    """Preconditioner with rigid bodies.

    The stiffness of rigid bodies is their inertia only; the system of all other nodes is solved for
    given rigid motions.

    Args:
        others: Preconditioner of the nodes of deformable bodies.
        rigid: Motion of the rigid bodies.
        tangent: Matrix of the bulk, in which nodes of rigid bodies are clamped.
    """

    def __init__(self, others: Preconditioner, rigid: RigidMotion, tangent: Tangent) -> None:
        self._others, self._rigid = others, rigid
        self._clamping = tangent.clamp(rigid.nodes)

    def solve(self, r: Floats) -> Floats:
        """Approximate solution for r, nodal vectors of shape ``(n, d)``. Collective."""
        nodes = self._rigid.nodes
        motion = self._rigid.respond(r.copy())[nodes]
        known = r.copy()
        known[nodes] = self._clamping * motion
        z = self._others.solve(known)
        z[nodes] = motion
        return z


class KrylovMethod:
    """Flexible GMRES, or another method by the user's options.

    Args:
        operator: The projected tangent.
        preconditioner: Its preconditioner.
        options: Options of the user.

    Attributes:
        others: PETSc method chosen by the user's options, if any.
        num_iterations: Number of iterations so far.
        num_local_iterations: Additional iterations of local solves.
    """

    def __init__(
        self,
        operator: Operator,
        preconditioner: Preconditioner | RigidPreconditioner,
        options: PetscOptions,
    ) -> None:
        bulk = operator.bulk
        self._operator, self._preconditioner = operator, preconditioner
        self._options: PetscOptions | None = options  # until their use has been checked
        self.others: PetscKrylov | None = None
        if options.krylov:
            shape = bulk.num_owned // bulk.rigid.dim, bulk.rigid.dim
            functions = operator.act, preconditioner.solve
            self.others = PetscKrylov(bulk.comm, shape, *functions, options, _MAX_ITERATIONS)
        self._sums: Callable[[Floats], Floats] | None = None
        if bulk.comm.size > 1:
            self._sums = lambda values: reductions.total(bulk.comm, values)
        self.num_iterations = self.num_local_iterations = 0

    def solve(
        self, b: Floats, rtol: float, *, most: int | None = None, is_local: bool = False
    ) -> tuple[Floats | None, int]:
        """Solve a system with the current operator. Collective.

        Args:
            b: Right-hand side at the owned nodes, shape ``(n, d)``.
            rtol: Reduction of the residual.
            most: Largest number of iterations, if it is less than the general one; not with a
                method of the user's options.
            is_local: Whether most nodes are clamped.

        Returns:
            The solution, the same shape, or None after a failure; number of iterations.

        Raises:
            ValueError: There are unused options.
        """
        if self.others is not None:
            x, iterations = self.others.solve(b, rtol, _DIVERGED)
        else:
            x, iterations = self._iterate(b, rtol, min(most or _MAX_ITERATIONS, _MAX_ITERATIONS))
        if is_local:
            self.num_local_iterations += iterations
        else:
            self.num_iterations += iterations
        if self._options is not None and iterations > 0:
            self._options.check_used()
            self._options = None
        return x, iterations

    def _iterate(self, b: Floats, rtol: float, most: int) -> tuple[Floats | None, int]:
        gmres, iterations = _kernels.FlexibleGmres(b, self._sums), 0
        residual = first = gmres.residual
        target = rtol * first
        while not residual <= target < math.inf:
            if iterations == most or not residual < _DIVERGED * first:
                return None, iterations
            z = self._preconditioner.solve(gmres.vector)
            residual = gmres.add(z, self._operator.act(z, target / residual))
            iterations += 1
        return gmres.solution(), iterations

    def precondition_once(self, b: Floats) -> Floats:
        """Apply the preconditioner once, which counts as an iteration. Collective.

        Args:
            b: Right-hand side at the owned nodes, shape ``(n, d)``.

        Returns:
            The approximate solution, the same shape.
        """
        self.num_iterations += 1
        return self._preconditioned(b)

    def _preconditioned(self, r: Floats) -> Floats:
        x = self._preconditioner.solve(r)
        x.reshape(-1)[self._operator.bulk.is_prescribed] = 0
        self._operator.elimination.constrain(x)
        return x

    def negative_curvature_direction(self, weight: Floats, numbers: Floats) -> Floats | None:
        """Direction of negative curvature of the current operator. Collective.

        Args:
            weight: Square root of the stiffness at the owned nodes, shape ``(n, 1)``.
            numbers: Independent random numbers of unit variance, shape ``(n, d)``.

        Returns:
            The direction at the owned nodes, shape ``(n, d)``, or None.
        """
        bulk, elimination = self._operator.bulk, self._operator.elimination

        def free(values: Floats) -> Floats:
            """Set prescribed values to zero, shape ``(d n,)``."""
            values = values.ravel()
            values[bulk.is_prescribed] = 0
            return values

        def precondition(r: Floats) -> Floats:
            return self._preconditioned(r.reshape(numbers.shape)).ravel()

        def act(p: Floats) -> Floats:
            return free(self._operator.act(p.reshape(numbers.shape).copy(), accuracy))

        accuracy = _ENOUGH
        rest = np.zeros(numbers.shape)
        b = elimination.act(elimination.constrain(rest), weight * numbers)
        b = free(bulk.rigid.project(None, b))
        weights = np.broadcast_to(weight, numbers.shape).ravel()
        motion = negative_curvature_direction(bulk.comm, b, weights, precondition, act)
        if motion is None:
            return None
        accuracy = 0.0  # in double precision, to exclude round-off
        curvature = reductions.total(bulk.comm, float(motion @ act(motion)))
        return motion.reshape(numbers.shape) if curvature < 0 else None
