"""Communication of Python objects and of numbered rows between ranks.

Rows with numbers, such as values of nodes, are collected on rank 0 in the order of the numbers,
which does not depend on the partition, and sent back from there.
"""

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Array, GlobalInts
from dolfinx_nts.parallel.errors import portable

__all__ = ["exchanged", "gathered", "joined", "on_root", "scattered"]

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


def gathered(comm: MPI.Comm, ids: GlobalInts, values: Array) -> tuple[GlobalInts, Array]:
    """Collect numbered rows of all ranks on rank 0. Collective.

    Args:
        comm: Communicator.
        ids: Numbers of this rank's rows, of which no two ranks have the same, shape ``(n,)``.
        values: The rows, shape ``(n, ...)``.

    Returns:
        On rank 0 all numbers, sorted, and their rows; on other ranks the arguments.
    """
    parts = comm.gather((ids, values))
    if parts is None:
        return ids, values
    ids, values = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.argsort(ids, kind="stable")
    return ids[order], values[order]


def scattered(comm: MPI.Comm, ids: GlobalInts, all_ids: GlobalInts, values: Array) -> Array:
    """Send each rank the numbered rows that it asks for. Collective.

    This is the inverse of `gathered`.

    Args:
        comm: Communicator.
        ids: Numbers of the rows that this rank wants, shape ``(n,)``.
        all_ids: On rank 0 the sorted numbers of all rows, shape ``(m,)``.
        values: On rank 0 the rows, shape ``(m, ...)``.

    Returns:
        Rows of this rank, shape ``(n, ...)``.

    Raises:
        ValueError: A rank asks for a number that is not among all numbers.
    """
    wanted = comm.gather(ids)

    def rows() -> None:
        if not all(np.isin(part, all_ids).all() for part in wanted or ()):
            raise ValueError("expected the numbers of the same nodes, given others")

    on_root(comm, rows)
    parts = [values[np.searchsorted(all_ids, part)] for part in wanted] if wanted else None
    mine: Array = comm.scatter(parts)
    return mine
