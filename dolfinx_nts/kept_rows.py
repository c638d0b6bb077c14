"""Rows of the bulk tangent in single precision, for products in preconditioners."""

from typing import Any

from petsc4py import PETSc

from dolfinx import la

from dolfinx_nts import _kernels
from dolfinx_nts.block_rows import BlockRows

__all__ = ["KeptRows"]


class KeptRows:
    """Context of a shell matrix: the present values of some rows. Collective.

    They are copied, in single precision: products wait for memory.

    Args:
        rows: Owned rows of the matrix.
    """

    def __init__(self, rows: BlockRows) -> None:
        """Copy."""
        self._map = rows.index_map
        self._matrix = _kernels.SingleMatrix(rows.start, rows.column, rows.value)
        self._vector = la.vector(rows.matrix.index_map(1), 3)

    def matrix(self) -> Any:
        """PETSc matrix whose products are those of the rows. Collective."""
        size = 3 * self._map.size_local, 3 * self._map.size_global
        return PETSc.Mat().createPython((size, size), self, comm=self._map.comm)

    def mult(self, _matrix: Any, x: Any, y: Any) -> None:
        """Y = A x; called by PETSc."""
        owned = x.array_r
        self._vector.array[: len(owned)] = owned
        self._vector.scatter_forward()
        self._matrix.multiply(self._vector.array.reshape(-1, 3), y.array.reshape(-1, 3))
