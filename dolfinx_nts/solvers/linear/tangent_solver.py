"""Linear systems with the tangent of a solved step, or with its transpose, to round-off."""

from collections.abc import Callable

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.linear.petsc_options import PetscOptions
from dolfinx_nts.solvers.newton_report import ConvergenceError
from dolfinx_nts.solvers.precond.preconditioner import BulkPreconditioner
from dolfinx_nts.solvers.precond.tangent import Tangent

__all__ = ["TangentSolver"]

# Reduction of the residual [-]: a derivative is as accurate as these solutions.
_REDUCTION = 1e-12
# Number of iterations after which factors are computed again, and largest number.
_SLOW, _MOST = 30, 400
# Directions lose their orthogonality where contact is by far stiffer than the factors, as below
# bodies that only contact supports. The iteration restarts from its residual if the residual is
# below this fraction of the first one [-], but has not been halved in this number of iterations
# [-].
_PART, _STALLED = 1e-4, 10


class TangentSolver:
    """Flexible GMRES with factors of a nearby symmetric matrix.

    The factors serve the tangent and its transpose, and many steps. Collective, as is `solve`.

    Args:
        tangent: The nearby matrix; it is assembled for the current state when factors are needed.
        comm: Communicator of the mesh.
    """

    def __init__(self, tangent: Tangent, comm: MPI.Comm) -> None:
        self._factors = BulkPreconditioner(tangent, PetscOptions(comm, None))
        # Complete factors, in single precision on one rank, or multigrid for many unknowns.
        for _ in range(2):
            self._factors.strengthen()
        self._comm, self._is_old = comm, True

    def solve(self, act: Callable[[Floats], Floats], b: Floats) -> Floats:
        """Solve a system.

        Args:
            act: Returns the product of the matrix with a nodal vector, a new array.
            b: Right-hand side at the owned nodes, shape ``(n, d)``.

        Returns:
            The solution, the same shape.

        Raises:
            ConvergenceError: The iteration does not converge with new factors.
        """
        if not reductions.anywhere(self._comm, bool(b.any())):
            return np.zeros_like(b)
        for _ in range(2):
            is_new = self._is_old
            if is_new:
                self._factors.build()
            x, iterations = self._iterate(act, b)
            self._is_old = iterations > _SLOW or x is None
            if x is not None:
                return x
            if is_new:
                break
        raise ConvergenceError(
            f"expected the linear system of a derivative to converge in {_MOST} iterations: the "
            "tangent is nearly singular, as at a limit point of the load",
            [],
        )

    def _iterate(self, act: Callable[[Floats], Floats], b: Floats) -> tuple[Floats | None, int]:
        sums = None if self._comm.size == 1 else lambda v: reductions.total(self._comm, v)
        gmres, x = _kernels.FlexibleGmres(b, sums), np.zeros_like(b)
        first = last = gmres.residual
        target, iterations = _REDUCTION * first, 0
        while gmres.residual > target:
            if iterations == _MOST:
                return None, iterations
            z = self._factors.solve(gmres.vector)
            gmres.add(z, act(z))
            iterations += 1
            if iterations % _STALLED == 0:
                if last / 2 < gmres.residual < _PART * first:
                    x += gmres.solution()
                    gmres = _kernels.FlexibleGmres(b - act(x), sums)
                last = gmres.residual
        return x + gmres.solution(), iterations
