"""Sums and extremes over all ranks.

All functions are collective and return the type of the argument; on one rank they return the
argument itself. Numbers, lists of numbers and arrays are sent as buffers, because sending them as
Python objects takes ten times as long.
"""

from typing import Any, TypeVar

from mpi4py import MPI

import numpy as np

__all__ = ["anywhere", "everywhere", "largest", "least", "total"]

T = TypeVar("T")  # int, float, bool, a list of one of these, or an array


def total(comm: MPI.Comm, value: T) -> T:
    """Sum of a value over all ranks, entry by entry. Collective."""
    return _reduced(comm, value, MPI.SUM)


def largest(comm: MPI.Comm, value: T) -> T:
    """Maximum of a value over all ranks, entry by entry. Collective."""
    return _reduced(comm, value, MPI.MAX)


def least(comm: MPI.Comm, value: T) -> T:
    """Minimum of a value over all ranks, entry by entry. Collective."""
    return _reduced(comm, value, MPI.MIN)


def anywhere(comm: MPI.Comm, flag: T) -> T:
    """Whether a flag is true on any rank, entry by entry. Collective."""
    return _reduced(comm, flag, MPI.LOR)


def everywhere(comm: MPI.Comm, flag: T) -> T:
    """Whether a flag is true on all ranks, entry by entry. Collective."""
    return _reduced(comm, flag, MPI.LAND)


def _reduced(comm: MPI.Comm, value: T, op: MPI.Op) -> T:
    if comm.size == 1:
        return value
    buffer: Any = np.array(value)
    comm.Allreduce(MPI.IN_PLACE, buffer, op=op)
    return buffer if isinstance(value, np.ndarray) else buffer.tolist()  # type: ignore[no-any-return]
