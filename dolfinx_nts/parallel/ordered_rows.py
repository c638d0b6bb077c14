"""Numbered rows that are collected again and again, in the order of their numbers."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats, GlobalInts

__all__ = ["OrderedRows"]


class OrderedRows:
    """Collects rows of all ranks on rank 0, in the order of their numbers. Collective.

    `communication.gathered` does so once; this one finds the order at the start only.

    Args:
        comm: Communicator.
        ids: Numbers of this rank's rows, of which no two ranks have the same, shape ``(n,)``.
    """

    def __init__(self, comm: MPI.Comm, ids: GlobalInts) -> None:
        """Find the order."""
        self._comm = comm
        parts = comm.gather(ids) or [ids]
        self._sizes = [len(part) for part in parts]
        self._order: Array = np.argsort(np.concatenate(parts), kind="stable")

    def collected(self, rows: Floats) -> Floats:
        """Collect rows, of the same number of values on all ranks.

        Args:
            rows: Rows of this rank, shape ``(n, c)``.

        Returns:
            On rank 0 all rows in their order; on other ranks nothing that has a meaning.
        """
        rows = np.ascontiguousarray(rows, dtype=np.float64)
        if self._comm.size > 1:
            width, received = rows.shape[1], None
            if self._comm.rank == 0:
                every: Floats = np.empty((sum(self._sizes), width))
                received = (every, [size * width for size in self._sizes])
            self._comm.Gatherv(rows, received)
            if self._comm.rank > 0:
                return rows
            rows = every
        ordered: Floats = rows.take(self._order, axis=0)
        return ordered
