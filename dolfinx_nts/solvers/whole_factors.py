"""Complete factors of a whole system, with as much room as its pivots turn out to need."""

from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx_nts.common.arrays import Floats

__all__ = ["WholeFactors", "solved"]

# Memory beyond what MUMPS estimates from the places of the entries alone [%], one after another.
# Pivots on the rows of multipliers, whose diagonal is nearly nothing, are delayed, and fill more.
_ROOM = (50, 200, 800, 3200)
# Numbers of MUMPS's parameters for it and for a last block on one rank, whose signs it knows, and
# of those which tell how it went and how many pivots are negative.
_ROOM_PARAMETER, _LAST_BLOCK, _OUTCOME, _NEGATIVE = 14, 13, 1, 12
# Outcomes [-] with which more room helps: of integers, of values, and of buffers.
_TOO_LITTLE = {-8, -9, -14, -15, -17, -18, -20}


class WholeFactors:
    """Factors of a matrix by MUMPS. Collective, as all its methods.

    Args:
        A: The matrix.
        is_symmetric: Whether it is known to be symmetric; signs of pivots are known then.
    """

    def __init__(self, A: Any, *, is_symmetric: bool = False) -> None:
        """Factorise."""
        self._x, self._b = A.createVecs()
        for room in _ROOM:
            self._ksp = PETSc.KSP().create(A.comm)
            self._ksp.setOperators(A)
            self._ksp.setType("preonly")
            pc = self._ksp.getPC()
            pc.setType("cholesky" if is_symmetric else "lu")
            pc.setFactorSolverType("mumps")
            pc.setFactorSetUpSolverType()
            self._factors = pc.getFactorMatrix()
            self._factors.setMumpsIcntl(_ROOM_PARAMETER, room)
            if is_symmetric:
                self._factors.setMumpsIcntl(_LAST_BLOCK, 1)
            self._ksp.setUp()
            self._outcome: int = self._factors.getMumpsInfog(_OUTCOME)
            if self._outcome not in _TOO_LITTLE or room == _ROOM[-1]:
                break
            self._ksp.destroy()

    @property
    def num_negative(self) -> int | None:
        """Number of negative eigenvalues of a symmetric matrix, None without factors."""
        return None if self._outcome < 0 else int(self._factors.getMumpsInfog(_NEGATIVE))

    def solve(self, right: Floats) -> Floats:
        """Owned part of the solution for that of a right-hand side, both ``(n,)``.

        It is not finite where there are no factors.
        """
        self._b.array[:] = right
        self._ksp.solve(self._b, self._x)
        solution: Floats = np.array(self._x.array)
        return solution

    def destroy(self) -> None:
        """Free the memory."""
        for item in (self._ksp, self._b, self._x):
            item.destroy()


def solved(A: Any, right: Floats) -> Floats:
    """Solve a system with factors that serve once. Collective.

    Args:
        A: The matrix.
        right: Owned part of the right-hand side, shape ``(n,)``.

    Returns:
        Owned part of the solution, shape ``(n,)``; not finite where there are no factors.
    """
    factors = WholeFactors(A)
    solution = factors.solve(right)
    factors.destroy()
    return solution
