"""Complete LU factors of the bulk tangent in single precision, on one rank."""

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.solvers.block_csr import BlockCSR

__all__ = ["CompleteFactors"]


class CompleteFactors:
    """Complete LU factors of a matrix on one rank, see `cpp/nts/solvers/complete_factors.h`.

    Args:
        rows: All rows of the matrix; their values may change.
        X: Positions of the nodes, for the nested dissection, shape ``(n, 3)`` [m].

    ``str`` is the kind of the factors.
    """

    def __init__(self, rows: BlockCSR, X: Floats) -> None:
        self._rows = rows
        self._factors = _kernels.CompleteFactors(rows.start, rows.column, X)

    def __str__(self) -> str:
        return "LU in single precision"

    def build(self) -> bool:
        """Factorise the current values; return whether the factors exist. Local."""
        rows = self._rows
        exist: bool = self._factors.factorise(rows.start, rows.column, rows.value)
        return exist

    def solve(self, b: Floats) -> Floats:
        """Solution for b, nodal vectors of shape ``(n, d)``. Local."""
        x = np.empty_like(b)
        self._factors.apply(b, x)
        return x

    def solve_all(self, b: Floats) -> Floats:
        """Solve for the columns of an array, shape ``(d n, k)``, by columns. Local."""
        x = np.empty_like(b)
        self._factors.apply(*(v.T.reshape(b.shape[1], -1, self._rows.dim) for v in (b, x)))
        return x
