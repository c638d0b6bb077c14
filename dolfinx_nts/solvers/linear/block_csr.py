"""Rows of a distributed block matrix: views, exchange between ranks, and copies for PETSc."""

from typing import Any

from petsc4py import PETSc

import numpy as np
from dolfinx import la

from dolfinx_nts.common.arrays import Array, Floats, GlobalInts, Ints
from dolfinx_nts.parallel.communication import exchanged, rows_by_rank

__all__ = ["BlockCSR", "entries_of_rows", "starts"]


class BlockCSR:
    """Owned rows of a matrix of d x d blocks, as views of the DOLFINx matrix.

    Args:
        matrix: The matrix.

    Attributes:
        matrix: The matrix.
        index_map: Index map of the rows.
        dim: Rows of a block, d.
        start: Offsets of the rows in the blocks, shape ``(n + 1,)``.
        column: Local column of each block, shape ``(b,)``.
        value: Blocks row by row, shape ``(d d b,)``.
    """

    def __init__(self, matrix: la.MatrixCSR) -> None:
        self.matrix = matrix
        self.index_map = matrix.index_map(0)
        n, self.dim = self.index_map.size_local, int(matrix.block_size[0])
        self.start: GlobalInts = matrix.indptr[: n + 1]
        self.column: Ints = matrix.indices[: self.start[n]]
        self.value: Floats = matrix.data[: self.dim**2 * self.start[n]]
        columns = matrix.index_map(1)
        self._global = columns.local_to_global(self.column).astype(PETSc.IntType)
        row = np.repeat(np.arange(n), np.diff(self.start))
        self._diagonal = np.flatnonzero(row == self.column)

    def diagonal(self) -> Floats:
        """Entries on the diagonal, shape ``(n, d)``. Local."""
        return self.value.reshape(-1, self.dim**2)[self._diagonal, :: self.dim + 1]

    def add_to_diagonal(self, values: Floats | float) -> None:
        """Add values that broadcast to ``(n, d)`` to the diagonal. Local."""
        self.value.reshape(-1, self.dim**2)[self._diagonal, :: self.dim + 1] += values

    def set_diagonal(self, dofs: Ints, value: float) -> None:
        """Set entries of owned dofs on the diagonal. Local."""
        node, part = np.divmod(dofs, self.dim)
        blocks = self.value.reshape(-1, self.dim**2)
        blocks[self._diagonal[node], part * (self.dim + 1)] = value

    def petsc(self) -> Any:
        """New PETSc block matrix with a copy of the current values. Collective."""
        d, start = self.dim, self.start.astype(PETSc.IntType)
        n = d * (len(start) - 1)
        csr = start, self._global, self.value
        return PETSc.Mat().createBAIJ(((n, None), (n, None)), d, csr=csr, comm=self.index_map.comm)

    def scalars(self) -> tuple[GlobalInts, GlobalInts, Floats]:
        """Rows with scalar entries instead of blocks. Local.

        Returns:
            Offsets of the rows, shape ``(d n + 1,)``; global columns and values of the entries,
            both ``(d d b,)``.
        """
        d, blocks = self.dim, np.diff(self.start)
        node = np.repeat(np.arange(len(blocks)), blocks)
        part = np.arange(d)
        first = d * d * self.start[:-1, None] + d * blocks[:, None] * part  # of each row
        in_row = d * (np.arange(len(node)) - self.start[node])
        place = first[node][:, :, None] + in_row[:, None, None] + part
        column, value = np.empty(d * d * len(node), dtype=np.int64), np.empty(d * d * len(node))
        column[place] = (d * self.global_columns[:, None] + part)[:, None]
        value[place] = self.value.reshape(-1, d, d)
        return np.append(first.ravel(), len(value)), column, value

    @property
    def global_columns(self) -> GlobalInts:
        """Global column of each block, shape ``(b,)``. Local."""
        columns: GlobalInts = self._global.astype(np.int64)
        return columns

    def gather(self, nodes: GlobalInts, ends: GlobalInts) -> tuple[GlobalInts, GlobalInts, Floats]:
        """Rows of any nodes, gathered from their owners. Collective.

        Args:
            nodes: Global numbers, shape ``(m,)``.
            ends: First number after the rows of each rank, shape ``(ranks,)``.

        Returns:
            Offsets of the rows, shape ``(m + 1,)``; global columns, shape ``(b,)``; blocks, shape
            ``(d d b,)``.
        """
        start, column, value = self._gather(
            nodes, ends, self._global, self.value.reshape(-1, self.dim**2)
        )
        return start, column.astype(np.int64), value.ravel()

    def neighbours(self, nodes: GlobalInts, ends: GlobalInts) -> GlobalInts:
        """Global columns of the rows of any nodes, row by row. Collective."""
        _, column = self._gather(nodes, ends, self._global)
        neighbours: GlobalInts = column.astype(np.int64)
        return neighbours

    def _gather(self, nodes: GlobalInts, ends: GlobalInts, *arrays: Any) -> list[Any]:
        """Offsets of rows of any nodes, and their entries in some arrays over the blocks."""
        comm, first = self.index_map.comm, self.index_map.local_range[0]
        order = np.argsort(nodes)
        wanted = nodes[order]
        owners = rows_by_rank(comm, np.searchsorted(ends, wanted, side="right"))
        answers = {}
        for rank, some in exchanged(comm, {k: wanted[rows] for k, rows in owners.items()}).items():
            start, blocks = entries_of_rows(self.start, some - first)
            answers[rank] = np.diff(start), *(array.take(blocks, axis=0) for array in arrays)
        parts = exchanged(comm, answers).values()
        length, *gathered = (np.concatenate(part) for part in zip(*parts, strict=True))
        start, blocks = entries_of_rows(starts(length), np.argsort(order))
        return [start, *(array.take(blocks, axis=0) for array in gathered)]


def entries_of_rows(start: GlobalInts, rows: Array) -> tuple[GlobalInts, GlobalInts]:
    """Entries of some rows, row by row.

    Args:
        start: Offsets of the rows in the entries, shape ``(n + 1,)``.
        rows: The rows, shape ``(m,)``.

    Returns:
        Offsets of the selected rows, shape ``(m + 1,)``; their entries.
    """
    taken = starts(start[rows + 1] - start[rows])
    return taken, np.arange(taken[-1]) + np.repeat(start[rows] - taken[:-1], np.diff(taken))


def starts(lengths: Array) -> GlobalInts:
    """Offsets of rows, ``(n + 1,)``, from their lengths, ``(n,)``."""
    return np.concatenate([[0], np.cumsum(lengths)], dtype=np.int64)
