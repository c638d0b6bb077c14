"""Communication of Python objects and of rows between ranks."""

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Array, GlobalInts
from dolfinx_nts.parallel.errors import portable

__all__ = ["exchanged", "joined", "on_root", "places_among_all"]

T = TypeVar("T")


def on_root(comm: MPI.Comm, action: Callable[[], T]) -> T:
    """Call a function on rank 0 and give all ranks its result or its error.

    Collective.

    Args:
        comm: Communicator.
        action: Function that is called on rank 0.

    Returns:
        What the function returned.

    Raises:
        Exception: What the function raised, as `errors.portable` sends it.
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


def exchanged(comm: MPI.Comm, parts: Iterable[T]) -> list[T]:
    """Send one object to each rank, and receive one from each. Collective.

    What a rank has for itself is not sent, as that would take as long as a message to another
    rank.

    Args:
        comm: Communicator.
        parts: One object for each rank, in the order of the ranks.

    Returns:
        One object from each rank, in the order of the ranks; that of this rank is the very
        object.
    """
    received: Any = list(parts)
    if comm.size > 1:
        own, received[comm.rank] = received[comm.rank], None
        received = comm.alltoall(received)
        received[comm.rank] = own
    return received  # type: ignore[no-any-return]


def joined(comm: MPI.Comm, values: Array) -> Array:
    """Collect rows of all ranks on all ranks, in the order of the ranks. Collective.

    Args:
        comm: Communicator.
        values: Rows of this rank, shape ``(n, ...)``.

    Returns:
        All rows; on one rank the very array.
    """
    return np.concatenate(comm.allgather(values)) if comm.size > 1 else values


def places_among_all(comm: MPI.Comm, rows: GlobalInts) -> GlobalInts:
    """Places of rows when those of all ranks are sorted by their columns. Collective.

    Args:
        comm: Communicator.
        rows: Rows of this rank, of which no two ranks have the same, shape ``(n, k)``.

    Returns:
        Places from 0 on, the same on any partition, shape ``(n,)``.
    """
    parts = comm.allgather(rows)
    order = np.lexsort(np.concatenate(parts).T[::-1])
    places = np.empty(len(order), dtype=np.int64)
    places[order] = np.arange(len(order))
    first = sum(len(part) for part in parts[: comm.rank])
    return places[first : first + len(rows)]
