"""Calls that all ranks make together, and ranks that do not come.

A collective call waits until every rank has made it. Without more it would wait for ever where
ranks make different calls, or where one of them has left the program. `meet` finds the former;
of the latter it learns by notes that ranks send when they leave.
"""

import atexit
import functools
import inspect
import math
import os
import sys
import time
import zlib
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats

__all__ = ["Meeting", "collective", "different", "leave_with_notes", "meet"]

_Class = TypeVar("_Class", bound=type[Any])

# Most numbers that ranks bring to a meeting; all meetings have messages of one length, so that
# different calls meet as well.
_MOST = 3
# Times [s] after which a waiting rank yields its core between two looks, and sleeps as well.
_AT_ONCE, _SHORT, _PAUSE = 5e-5, 2e-2, 1e-4
# Time [s] after which the second rank that learns of one that has left ends the program, if the
# first has not.
_GRACE = 0.5
# Time [s] for which a rank that leaves waits, so that those which wait for it hear of that before
# PETSc makes calls of its own.
_FAREWELL = 0.1
# Tag of the notes, a number that no other message has.
_TAG = 20111
# Requests of messages that may never be received, whose memory is needed to the end.
_pending: list[Any] = []
# Collective methods of classes that this rank is in.
_calls: list[str] = []


def meet(comm: MPI.Comm, call: str, *numbers: float) -> list[float]:
    """Wait until all ranks make the same call. Collective.

    Args:
        comm: Communicator.
        call: What this rank does, with all arguments that must be the same.
        numbers: At most three numbers of this rank.

    Returns:
        The largest of each number on all ranks.

    Raises:
        ValueError: Ranks make different calls.
    """
    if comm.size == 1:
        return list(numbers)
    meeting = Meeting(comm, call, *numbers)
    meeting.wait()
    return meeting.largest()


class Meeting:
    """A call of this rank that waits for the same call of the others. Local.

    Arguments are those of `meet`.
    """

    def __init__(self, comm: MPI.Comm, call: str, *numbers: float) -> None:
        self._comm, self._call, self._num_numbers = comm, call, len(numbers)
        code, nothing = zlib.crc32(call.encode()), [-np.inf] * (_MOST - len(numbers))
        # MPI reads and writes both arrays until the request is complete.
        self._mine: Floats = np.array([code, -code, *numbers, *nothing])
        self._largest: Floats = np.empty_like(self._mine)
        self._request = comm.Iallreduce(self._mine, self._largest, op=MPI.MAX)

    def wait(self, patience: float = math.inf) -> bool:
        """Wait for the other ranks; end the program if one of them has left it.

        Args:
            patience: Longest time to wait [s].

        Returns:
            Whether all have come.
        """
        start = time.monotonic()
        while not self._request.Test():
            waited = time.monotonic() - start
            if waited > patience:
                _pending.append(self)
                return False
            if waited > _SHORT:
                _end_if_one_has_left(self._call)
                time.sleep(_PAUSE)
            elif waited > _AT_ONCE:
                os.sched_yield()
        return True

    def largest(self) -> list[float]:
        """Largest of each number on all ranks, after all have come. Collective.

        Raises:
            ValueError: Ranks make different calls.
        """
        if self._largest[0] != -self._largest[1]:
            raise ValueError(different(self._comm.allgather(self._call)))
        return [float(number) for number in self._largest[2 : 2 + self._num_numbers]]


def different(calls: Iterable[str]) -> str:
    """Message of an error about calls of ranks that are not the same. Local."""
    each = " on some and ".join(dict.fromkeys(calls))
    return f"expected all ranks to do the same, given {each} on others"


def collective(cls: _Class) -> _Class:
    """Class decorator: all ranks call each public method together, or all raise. Local.

    A method that another one calls is not checked again. Instances have ``_comm``.

    Args:
        cls: The class.

    Returns:
        The same class.
    """
    for name, method in list(vars(cls).items()):
        if inspect.isfunction(method) and not name.startswith("_"):
            setattr(cls, name, _checked(method))
    return cls


def _checked(method: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(method)
    def call(self: Any, *args: Any, **options: Any) -> Any:
        comm: MPI.Comm = self._comm
        if _calls or comm.size == 1:
            return method(self, *args, **options)
        given = (getattr(each, "name", type(each).__name__) for each in (*args, *options.values()))
        text = f"{type(self).__name__}.{method.__name__}({', '.join(map(str, given))})"
        meet(comm, text)
        _calls.append(text)
        try:
            return method(self, *args, **options)
        finally:
            _calls.clear()

    return call


def leave_with_notes() -> None:
    """Let this rank send notes when it leaves the program, in whatever way. Local."""
    atexit.register(_send_notes)


def _readers(rank: int) -> list[int]:
    """Ranks to which one that leaves sends a note: two, as the first may have left too."""
    return [r for r in range(min(MPI.COMM_WORLD.size, 3)) if r != rank][:2]


def _send_notes() -> None:
    comm = MPI.COMM_WORLD
    if not MPI.Is_finalized():
        empty = np.empty(0, dtype=np.int8)
        _pending.extend(comm.Isend(empty, rank, _TAG) for rank in _readers(comm.rank))
        time.sleep(_FAREWELL)


def _end_if_one_has_left(call: str) -> None:
    comm, status = MPI.COMM_WORLD, MPI.Status()
    if not comm.iprobe(tag=_TAG, status=status):
        return
    time.sleep(_GRACE * _readers(status.source).index(comm.rank))
    sys.stderr.write(
        f"rank {status.source} of {comm.size} has left the program, while rank {comm.rank} waits "
        f"for it in {call}: all ranks end\n"
    )
    sys.stderr.flush()
    comm.Abort(1)
