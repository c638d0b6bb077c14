"""Communication of Python objects and of rows between ranks."""

import os
from collections.abc import Callable, Mapping
from typing import TypeVar

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Array, GlobalInts
from dolfinx_nts.parallel.errors import portable

__all__ = ["exchanged", "joined", "on_root", "places_among_all", "rows_by_rank"]

T = TypeVar("T")

# Alternating message tags of exchanges, not used by other messages.
_TAGS = 20112, 20113
# Attribute of a communicator with its number of exchanges.
_NUM_EXCHANGES = MPI.Comm.Create_keyval()


def on_root(comm: MPI.Comm, action: Callable[[], T]) -> T:
    """Call a function on rank 0 and give all ranks its result or its error.

    Collective.

    Args:
        comm: Communicator.
        action: Function that is called on rank 0.

    Returns:
        Result of the function.

    Raises:
        Exception: Error of the function, as `errors.portable` sends it.
    """
    result: T | None = None
    error: Exception | None = None
    if comm.rank == 0:
        try:
            result = action()
        except Exception as failure:
            error = portable(failure)
    if comm.size > 1:
        result, error = comm.bcast((result, error))
    if error is not None:
        raise error
    return result  # type: ignore[return-value]


def exchanged(comm: MPI.Comm, parts: Mapping[int, T]) -> dict[int, T]:
    """Send an object to each of several ranks, and receive objects of others. Collective.

    Receivers do not know their senders beforehand. The algorithm uses messages to the given ranks
    and a nonblocking barrier that a rank enters when all its messages have arrived (T. Hoefler, C.
    Siebert, A. Lumsdaine, PPoPP 2010). The work of a rank does not grow with the number of ranks.

    Args:
        comm: Communicator.
        parts: Objects by receiving rank. An object for this rank itself is not sent.

    Returns:
        Objects by sending rank, in the order of the ranks; the object of this rank is not copied.
    """
    if comm.size == 1:
        return dict(parts)
    tag, status = _next_tag(comm), MPI.Status()
    received = {rank: part for rank, part in parts.items() if rank == comm.rank}
    sent = [comm.issend(part, rank, tag) for rank, part in parts.items() if rank != comm.rank]
    barrier = None
    while barrier is None or not barrier.Test():
        message = comm.improbe(tag=tag, status=status)
        if message is not None:
            received[status.source] = message.recv()
        elif barrier is None and MPI.Request.Testall(sent):
            barrier = comm.Ibarrier()
        else:
            os.sched_yield()
    return dict(sorted(received.items()))


def rows_by_rank(comm: MPI.Comm, ranks: Array) -> dict[int, Array]:
    """Group rows by the rank that receives them. Local.

    Args:
        comm: Communicator.
        ranks: Rank that receives each row, shape ``(n,)``.

    Returns:
        Sorted numbers of rows by rank, with an entry for this rank in any case.
    """
    order = np.argsort(ranks, kind="stable")
    some, first = np.unique(ranks[order], return_index=True)
    rows = {int(rank): own for rank, own in zip(some, np.split(order, first[1:]), strict=False)}
    return {comm.rank: order[:0], **rows}


def _next_tag(comm: MPI.Comm) -> int:
    """Tag of the next exchange; alternates, since exchanges of ranks may overlap."""
    number = comm.Get_attr(_NUM_EXCHANGES) or 0
    comm.Set_attr(_NUM_EXCHANGES, number + 1)
    return _TAGS[number % len(_TAGS)]


def joined(comm: MPI.Comm, values: Array) -> Array:
    """Collect rows of all ranks on all ranks, in the order of the ranks. Collective.

    Args:
        comm: Communicator.
        values: Rows of this rank, shape ``(n, ...)``.

    Returns:
        All rows; on one rank the array itself.
    """
    return np.concatenate(comm.allgather(values)) if comm.size > 1 else values


def places_among_all(comm: MPI.Comm, rows: GlobalInts) -> GlobalInts:
    """Positions of rows in the sorted rows of all ranks. Collective.

    Args:
        comm: Communicator.
        rows: Rows of this rank, unique over all ranks, shape ``(n, k)``.

    Returns:
        Positions from 0, independent of the partition, shape ``(n,)``.
    """
    parts = comm.allgather(rows)
    order = np.lexsort(np.concatenate(parts).T[::-1])
    places = np.empty(len(order), dtype=np.int64)
    places[order] = np.arange(len(order))
    first = sum(len(part) for part in parts[: comm.rank])
    return places[first : first + len(rows)]
