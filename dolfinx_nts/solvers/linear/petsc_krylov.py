"""Krylov method of PETSc, chosen by the user's options."""

from collections.abc import Callable
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.solvers.linear.petsc_options import PetscOptions
from dolfinx_nts.solvers.linear.shells import shell_matrix, use_shell

__all__ = ["PetscKrylov"]


class PetscKrylov:
    """Flexible GMRES, unless the options choose another method. Collective, as are its methods.

    Args:
        comm: Communicator.
        shape: Shape of the nodal vectors of this rank, ``(n, d)``.
        act: Returns the product of the operator with a vector, which it may overwrite. The second
            argument is the remaining reduction of the residual.
        precondition: Returns the approximate solution for a right-hand side.
        options: Options of the user.
        most: Largest number of iterations; the method does not restart before.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        shape: tuple[int, int],
        act: Callable[[Floats, float], Floats],
        precondition: Callable[[Floats], Floats],
        options: PetscOptions,
        most: int,
    ) -> None:
        self._shape, self._act, self._precondition, self._most = shape, act, precondition, most
        matrix = shell_matrix(comm, (shape[0] * shape[1], None), self)
        matrix.setUp()
        self._ksp = PETSc.KSP().create(comm)
        self._ksp.setOptionsPrefix(options.prefix)
        self._ksp.setOperators(matrix)
        self._ksp.setType("fgmres")
        self._ksp.setGMRESRestart(most)
        self._ksp.setPCSide(PETSc.PC.Side.RIGHT)
        self._ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        use_shell(self._ksp.getPC(), self)
        with options.understood():
            self._ksp.setFromOptions()
            self._ksp.setUp()  # PETSc refuses methods without right preconditioning
        self._x, self._b = matrix.createVecs()
        self._target = 0.0

    def __str__(self) -> str:
        return str(self._ksp.getType())

    def solve(self, b: Floats, rtol: float, growth: float) -> tuple[Floats | None, int]:
        """Solve a system.

        Args:
            b: Right-hand side at the owned nodes, shape ``(n, d)``.
            rtol: Reduction of the residual.
            growth: Growth of the residual that counts as divergence.

        Returns:
            The solution, the same shape, or None after a failure; number of iterations.
        """
        self._b.array[:] = b.ravel()
        self._target = rtol * self._b.norm()
        self._ksp.setTolerances(rtol=rtol, atol=0.0, divtol=growth, max_it=self._most)
        self._ksp.solve(self._b, self._x)
        iterations = int(self._ksp.getIterationNumber())
        if self._ksp.getConvergedReason() < 0:
            return None, iterations
        return self._x.array.copy().reshape(b.shape), iterations

    def mult(self, _matrix: Any, x: Any, y: Any) -> None:
        """Set y to the product with x; called by PETSc."""
        left = self._target / max(self._ksp.getResidualNorm(), self._target)
        y.array[:] = self._act(x.array_r.reshape(self._shape).copy(), left).ravel()

    def apply(self, _pc: Any, r: Any, z: Any) -> None:
        """Set z to the approximate solution for r; called by PETSc."""
        z.array[:] = self._precondition(r.array_r.reshape(self._shape)).ravel()
