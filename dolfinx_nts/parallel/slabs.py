"""Redistribution of numbered rows to one sorted, contiguous slab for each rank.

The order does not depend on the partition, and no rank needs all rows. All ranks can write their
slabs to a file, which is the same on any number of ranks.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Array, Floats, GlobalInts, Ints
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import exchanged, joined, rows_by_rank

__all__ = ["Slab", "Slabs", "Some", "fetch_rows"]

# Number of samples of the numbers of each rank [-], from which slab bounds are computed.
_SAMPLES = 64


class Slab(NamedTuple):
    """Contiguous rows of a distributed array.

    Attributes:
        values: Rows of this rank; a scalar (array of shape ``()``) exists on one rank only.
        begin: Position of the first row among all rows.
        length: Number of all rows.
    """

    values: Array
    begin: int
    length: int

    @classmethod
    def whole(cls, values: Array) -> "Slab":
        """Slab of an array on one rank."""
        return cls(values, 0, len(values) if values.ndim else 1)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole array."""
        return (self.length, *self.values.shape[1:]) if self.values.ndim else ()

    @property
    def dtype(self) -> Any:
        """Type of the values."""
        return self.values.dtype

    def split(self, number: int, *shape: int) -> "Slab":
        """Slab in which each row is split into ``number`` rows of a given shape."""
        return Slab(self.values.reshape(-1, *shape), number * self.begin, number * self.length)


class Some(NamedTuple):
    """Some rows of an array; all other rows have the same value.

    Attributes:
        rows: Numbers of the rows, shape ``(r,)``.
        values: These rows, shape ``(r, ...)``.
        elsewhere: Value of all other rows.
    """

    rows: Ints | GlobalInts
    values: Array
    elsewhere: float

    def whole(self, n: int) -> Array:
        """Array of all ``n`` rows."""
        shape = n, *self.values.shape[1:]
        # `np.zeros` is fast, since untouched pages are not allocated.
        rows: Array = np.full(shape, self.elsewhere) if self.elsewhere else np.zeros(shape)
        rows[self.rows] = self.values
        return rows


class Slabs:
    """Redistribution of numbered rows into slabs of similar size. Collective, as its methods.

    Args:
        comm: Communicator.
        ids: Numbers of the rows of this rank, unique over all ranks, shape ``(n,)``.
    """

    def __init__(self, comm: MPI.Comm, ids: GlobalInts) -> None:
        self._comm = comm
        self._order = np.argsort(ids)
        # Position of each row in the slab, for runs on one rank.
        self._place = np.argsort(self._order)
        ids = ids[self._order]
        bounds = _bounds(comm, ids)
        ends = [0, *np.searchsorted(ids, bounds), len(ids)]
        self._sent = np.diff(ends)
        self._received = np.array(comm.alltoall(self._sent.tolist()))
        numbers = self._exchanged(ids)
        self._merge = np.argsort(numbers, kind="stable")
        self._numbers: GlobalInts = numbers[self._merge]
        last = np.cumsum(comm.allgather(len(numbers)))
        self._begin, self._length = int(last[comm.rank]) - len(numbers), int(last[-1])

    def slab(self, rows: Array | Some, room: Array | None = None) -> Slab:
        """Redistribute rows.

        Args:
            rows: Rows of this rank in the order of its numbers, shape ``(n, ...)``, of the same
                type on all ranks.
            room: Contiguous array whose memory is reused for the slab if the shape fits. For `Some`
                rows it must be an earlier slab with the same other rows.
        """
        n = len(self._order)
        if isinstance(rows, Some):
            if self._comm.size == 1:
                some = Some(self._place[rows.rows], *rows[1:])
                if room is None:
                    room = some.whole(n)
                else:
                    room[some.rows] = some.values
                return Slab(room, self._begin, self._length)
            rows = rows.whole(n)
        if self._comm.size == 1:
            return Slab(_taken(rows, self._order, room), self._begin, self._length)
        received = self._exchanged(_taken(rows, self._order))
        return Slab(_taken(received, self._merge, room), self._begin, self._length)

    def together(
        self, fields: Mapping[str, Floats | Some], room: Mapping[str, Array] | None = None
    ) -> dict[str, Slab]:
        """Redistribute rows of several fields, with one message between any two ranks.

        Args:
            fields: Rows of this rank by name, see `slab`.
            room: Arrays by name, see `slab`; several ranks do not use them.
        """
        if self._comm.size == 1 or not fields:
            room = room or {}
            return {name: self.slab(rows, room.get(name)) for name, rows in fields.items()}
        n = len(self._order)
        whole = [rows.whole(n) if isinstance(rows, Some) else rows for rows in fields.values()]
        parts = [rows.reshape(n, -1) for rows in whole]
        ends = np.cumsum([part.shape[1] for part in parts])
        every = self.slab(np.concatenate(parts, axis=1, dtype=np.float64))
        columns = np.split(every.values, ends[:-1], axis=1)
        return {
            name: every._replace(values=part.reshape(-1, *rows.shape[1:]))
            for part, name, rows in zip(columns, fields, whole, strict=True)
        }

    def numbers(self) -> Slab:
        """Numbers of the rows, sorted. Local."""
        return Slab(self._numbers, self._begin, self._length)

    def places(self, ids: GlobalInts) -> GlobalInts:
        """Positions of row numbers among the sorted numbers of all ranks.

        Args:
            ids: Numbers of any rank, shape ``(k,)``.

        Raises:
            ValueError: A rank requests a number that no rank has.
        """
        places = np.arange(self._begin, self._begin + len(self._numbers))
        return fetch_rows(self._comm, ids, self._numbers, places)

    def _exchanged(self, rows: Array) -> Array:
        """Rows from all ranks, in the order of the ranks."""
        if self._comm.size == 1:
            return rows
        received = np.empty((int(self._received.sum()), *rows.shape[1:]), dtype=rows.dtype)
        # Rows as MPI units, since counts of bytes may exceed 32 bits.
        size = rows.dtype.itemsize * int(np.prod(rows.shape[1:], dtype=int))
        row = MPI.BYTE.Create_contiguous(size).Commit()
        self._comm.Alltoallv(
            [np.ascontiguousarray(rows), self._sent, row], [received, self._received, row]
        )
        row.Free()
        return received


def _taken(rows: Array, order: GlobalInts, room: Array | None = None) -> Array:
    """Rows in another order, written to the buffer ``room`` if its shape fits."""
    shape = len(order), *rows.shape[1:]
    width = math.prod(shape[1:])
    fits = room is not None and room.dtype == rows.dtype and room.size == len(order) * width
    out = room.reshape(shape) if room is not None and fits else np.empty(shape, rows.dtype)
    if rows.dtype == np.float64:
        _kernels.take_rows(rows.reshape(-1, width), order, out.reshape(-1, width))
    else:
        rows.take(order, axis=0, out=out)
    return out


def _bounds(comm: MPI.Comm, ids: GlobalInts) -> GlobalInts:
    """Smallest number of each slab except the first, from sorted numbers of this rank."""
    step = max(1, reductions.total(comm, len(ids)) // (_SAMPLES * comm.size))
    samples = np.sort(joined(comm, ids[step // 2 :: step]))
    cuts = [len(samples) * rank // comm.size for rank in range(1, comm.size)]
    return samples[cuts] if len(samples) else np.zeros(len(cuts), dtype=np.int64)


def fetch_rows(comm: MPI.Comm, ids: GlobalInts, known: GlobalInts, rows: Array) -> Array:
    """Fetch numbered rows from the ranks that own them. Collective.

    Args:
        comm: Communicator.
        ids: Numbers of the requested rows, shape ``(n,)``.
        known: Sorted numbers of the rows of this rank, larger than on lower ranks, shape
            ``(m,)``.
        rows: Rows of this rank, shape ``(m, ...)``.

    Returns:
        The requested rows, shape ``(n, ...)``.

    Raises:
        ValueError: A rank requests a number that no rank has.
    """
    largest = int(known[-1]) if len(known) else -1
    lasts = np.maximum.accumulate(comm.allgather(largest))
    rank = np.minimum(np.searchsorted(lasts, ids), comm.size - 1)
    parts = rows_by_rank(comm, rank)
    requests = exchanged(comm, {owner: ids[part] for owner, part in parts.items()})
    is_known = all(np.isin(part, known).all() for part in requests.values())
    if not reductions.everywhere(comm, is_known):
        raise ValueError("expected numbers of existing rows, given one that no rank has")
    places = {asker: np.searchsorted(known, part) for asker, part in requests.items()}
    found = np.empty((len(ids), *rows.shape[1:]), dtype=rows.dtype)
    for owner, answer in exchanged(comm, {k: rows[place] for k, place in places.items()}).items():
        found[parts[owner]] = answer
    return found
