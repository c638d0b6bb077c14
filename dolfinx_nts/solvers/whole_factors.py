"""Complete factors of a matrix by MUMPS."""

from typing import Any

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.solvers import mumps

__all__ = ["WholeFactors", "solved"]


class WholeFactors:
    """Factors of a matrix by MUMPS. Collective, as all its methods.

    Args:
        A: The matrix.
        is_symmetric: Whether it is symmetric; `num_negative` is available then.
    """

    def __init__(self, A: Any, *, is_symmetric: bool = False) -> None:
        self._x, self._b = A.createVecs()
        self._pc = mumps.factorised(A, is_symmetric=is_symmetric)

    @property
    def num_negative(self) -> int | None:
        """Number of negative eigenvalues of a symmetric matrix, None without factors."""
        signs = mumps.signs(self._pc)
        return None if signs is None else signs[0]

    def solve(self, right: Floats) -> Floats:
        """Owned part of the solution for the owned part of a right-hand side, both ``(n,)``.

        It is not finite if there are no factors.
        """
        self._b.array[:] = right
        self._pc.apply(self._b, self._x)
        solution: Floats = np.array(self._x.array)
        return solution

    def destroy(self) -> None:
        """Free the memory."""
        for item in (self._pc, self._b, self._x):
            item.destroy()


def solved(A: Any, right: Floats) -> Floats:
    """Solve a system with factors that are used once. Collective.

    Args:
        A: The matrix.
        right: Owned part of the right-hand side, shape ``(n,)``.

    Returns:
        Owned part of the solution, shape ``(n,)``; not finite if there are no factors.
    """
    factors = WholeFactors(A)
    solution = factors.solve(right)
    factors.destroy()
    return solution
