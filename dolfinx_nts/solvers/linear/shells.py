"""PETSc shell matrices and shell preconditioners with Python contexts.

A shell holds only a weak reference to its worker; the owner of the shell must keep both. PETSc does
not free the contexts of shells at the end of a program, so strong references would keep bodies,
contacts and kernels alive.
"""

import weakref
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["shell_matrix", "use_shell"]


def shell_matrix(comm: MPI.Comm, size: tuple[int, int | None], worker: Any) -> Any:
    """Create a square shell matrix. Collective.

    Args:
        comm: Communicator of the matrix.
        size: Numbers of rows of this rank and of all ranks; None for their sum.
        worker: Object with a method ``mult(matrix, x, y)``, kept by the caller.

    Returns:
        The matrix.
    """
    return PETSc.Mat().createPython((size, size), _Context(worker), comm=comm)


def use_shell(pc: Any, worker: Any) -> None:
    """Turn a PETSc preconditioner into a shell. Local.

    Args:
        pc: The preconditioner.
        worker: Object with a method ``apply(pc, r, z)``, kept by the caller.
    """
    pc.setType("python")
    pc.setPythonContext(_Context(worker))


class _Context:
    """Context of a shell, with a weak reference to its worker.

    Args:
        worker: The object with the methods `mult` or `apply`.
    """

    def __init__(self, worker: Any) -> None:
        self._worker: Any = weakref.ref(worker)

    def mult(self, *arguments: Any) -> None:
        """Set y to the product of the worker with x; called by PETSc."""
        self._worker().mult(*arguments)

    def apply(self, *arguments: Any) -> None:
        """Set z to the solution of the worker for r; called by PETSc."""
        self._worker().apply(*arguments)
