"""What ranks do for each other: exchange, gather, scatter, files."""

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Array, GlobalInts
from dolfinx_nts.parallel.errors import portable

__all__ = ["exchanged", "gathered", "on_root", "scattered"]

T = TypeVar("T")


def on_root(comm: MPI.Comm, action: Callable[[], T]) -> T:
    """Do something on rank 0 only; all ranks get its result or its error.

    Collective.

    Args:
        comm: Communicator.
        action: Called on rank 0.

    Returns:
        What it returned.

    Raises:
        Exception: What it raised, as `errors.portable` sends it.
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
    """What all ranks have for this one, in their order. Collective.

    A message to oneself takes as long as one to another rank: there is none.

    Args:
        comm: Communicator.
        parts: What this rank has for each.

    Returns:
        One part of each; this rank's own is the very object.
    """
    received: Any = list(parts)
    if comm.size > 1:
        own, received[comm.rank] = received[comm.rank], None
        received = comm.alltoall(received)
        received[comm.rank] = own
    return received  # type: ignore[no-any-return]


def gathered(comm: MPI.Comm, ids: GlobalInts, values: Array) -> tuple[GlobalInts, Array]:
    """Rows of all ranks on rank 0, sorted by their numbers. Collective.

    Args:
        comm: Communicator.
        ids: Numbers of this rank's rows, unique over all, shape ``(n,)``.
        values: The rows, shape ``(n, ...)``.

    Returns:
        Numbers and rows; those of this rank elsewhere.
    """
    parts = comm.gather((ids, values))
    if parts is None:
        return ids, values
    ids, values = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.argsort(ids, kind="stable")
    return ids[order], values[order]


def scattered(comm: MPI.Comm, ids: GlobalInts, all_ids: GlobalInts, values: Array) -> Array:
    """Rows that this rank asks for, the inverse of `gathered`. Collective.

    Args:
        comm: Communicator.
        ids: Numbers that this rank wants, shape ``(n,)``.
        all_ids: Sorted numbers of the rows, on rank 0, shape ``(m,)``.
        values: The rows, on rank 0, shape ``(m, ...)``.

    Returns:
        Rows of this rank, shape ``(n, ...)``.

    Raises:
        ValueError: A number is not there.
    """
    wanted = comm.gather(ids)

    def rows() -> None:
        if not all(np.isin(part, all_ids).all() for part in wanted or ()):
            raise ValueError("expected the numbers of the same nodes, given others")

    on_root(comm, rows)
    parts = [values[np.searchsorted(all_ids, part)] for part in wanted] if wanted else None
    mine: Array = comm.scatter(parts)
    return mine
