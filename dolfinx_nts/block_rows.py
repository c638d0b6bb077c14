"""Rows of a distributed matrix, to be read, gathered and given to PETSc."""

from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from dolfinx import la

__all__ = ["BlockRows"]

Floats = npt.NDArray[np.float64]


class BlockRows:
    """Owned rows of a matrix of 3 x 3 blocks, as DOLFINx stores it.

    Args:
        matrix: Matrix in compact blocks.

    Attributes:
        matrix: The matrix.
        index_map: Of the rows.
        start: Where each row begins, and the end, shape ``(n + 1,)``.
        column: Local column of each block, shape ``(b,)``.
        value: Blocks by rows, shape ``(9 b,)``.
    """

    def __init__(self, matrix: la.MatrixCSR) -> None:
        """Take views on the owned rows."""
        self.matrix = matrix
        self.index_map = matrix.index_map(0)
        n = self.index_map.size_local
        self.start: npt.NDArray[np.int64] = matrix.indptr[: n + 1]
        self.column: npt.NDArray[np.int32] = matrix.indices[: self.start[n]]
        self.value: Floats = matrix.data[: 9 * self.start[n]]
        columns = matrix.index_map(1)
        self._global = columns.local_to_global(self.column).astype(PETSc.IntType)
        row = np.repeat(np.arange(n), np.diff(self.start))
        self._diagonal = np.flatnonzero(row == self.column)

    def diagonal(self) -> Floats:
        """Entries on the diagonal, shape ``(n, 3)``. Local."""
        return self.value.reshape(-1, 9)[self._diagonal, ::4]

    def insert(self, matrix: Any) -> None:
        """Copy the values to a PETSc matrix of the same pattern. Collective."""
        start = self.start.astype(PETSc.IntType)
        matrix.setValuesBlockedCSR(start, self._global, self.value)
        matrix.assemble()

    def gather(
        self, nodes: npt.NDArray[np.int64], ends: npt.NDArray[np.int64]
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Floats]:
        """Rows of any nodes. Collective.

        Args:
            nodes: Global numbers, shape ``(m,)``.
            ends: First number after those of each rank, shape ``(ranks,)``.

        Returns:
            Where each row begins and the end, shape ``(m + 1,)``; global
            columns, shape ``(b,)``; blocks, shape ``(9 b,)``.
        """
        comm = self.index_map.comm
        order = np.argsort(nodes)
        asked = comm.alltoall(np.split(nodes[order], np.searchsorted(nodes[order], ends[:-1])))
        answers = []
        for wanted in asked:
            length, blocks = _blocks(self.start, wanted - self.index_map.local_range[0])
            answers.append((length, self._global[blocks], self.value.reshape(-1, 9)[blocks]))
        parts = comm.alltoall(answers)
        length, column, value = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        length, blocks = _blocks(_start(length), np.argsort(order))
        return _start(length), column[blocks].astype(np.int64), value[blocks].ravel()


def _blocks(start: Any, rows: Any) -> tuple[Any, Any]:
    """Number of blocks of some rows, and where they lie."""
    length = start[rows + 1] - start[rows]
    begin = _start(length)
    return length, np.arange(begin[-1]) + np.repeat(start[rows] - begin[:-1], length)


def _start(length: Any) -> Any:
    return np.concatenate([[0], np.cumsum(length)])
