"""Sums and extremes over all ranks.

Numbers, lists of them and arrays go as buffers: as Python objects they take
ten times as long. All functions are collective and return the type that they
are given, on one rank the very object.
"""

from typing import Any, TypeVar

from mpi4py import MPI

import numpy as np

__all__ = ["anywhere", "everywhere", "largest", "least", "total"]

T = TypeVar("T")  # int, float, bool, a list of one of these, or an array


def total(comm: MPI.Comm, value: T) -> T:
    """Sum over all ranks."""
    return _reduced(comm, value, MPI.SUM)


def largest(comm: MPI.Comm, value: T) -> T:
    """Maximum over all ranks."""
    return _reduced(comm, value, MPI.MAX)


def least(comm: MPI.Comm, value: T) -> T:
    """Minimum over all ranks."""
    return _reduced(comm, value, MPI.MIN)


def anywhere(comm: MPI.Comm, flag: T) -> T:
    """Whether it is true on any rank."""
    return _reduced(comm, flag, MPI.LOR)


def everywhere(comm: MPI.Comm, flag: T) -> T:
    """Whether it is true on all ranks."""
    return _reduced(comm, flag, MPI.LAND)


def _reduced(comm: MPI.Comm, value: T, op: MPI.Op) -> T:
    if comm.size == 1:
        return value
    buffer: Any = np.array(value)
    comm.Allreduce(MPI.IN_PLACE, buffer, op=op)
    return buffer if isinstance(value, np.ndarray) else buffer.tolist()  # type: ignore[no-any-return]
