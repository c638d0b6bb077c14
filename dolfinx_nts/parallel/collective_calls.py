"""Check that all ranks make the same collective call, to avoid deadlocks.

`meet` detects that ranks make different calls. It also detects that a rank has left the program,
by messages that ranks send when they exit.
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

__all__ = ["PendingCall", "collective", "different", "leave_with_notes", "meet"]

_Class = TypeVar("_Class", bound=type[Any])

# Largest number of values in a call. All messages have one length, so that different calls are
# detected.
_MOST = 3
# Times [s] after which a waiting rank yields its core between two tests, and after which it sleeps;
# length of a sleep [s].
_AT_ONCE, _SHORT, _PAUSE = 5e-5, 2e-2, 1e-4
# An exiting rank notifies two ranks. Time [s] after which the second one ends the program if the
# first one has not.
_GRACE = 0.5
# Time [s] for which an exiting rank waits, so that waiting ranks are notified before PETSc makes
# its own collective calls.
_FAREWELL = 0.1
# Unique tag of the messages.
_TAG = 20111
# Requests of messages that may never be received; their memory must exist until the end.
_pending: list[Any] = []
# Collective methods that this rank is currently in.
_calls: list[str] = []


def meet(comm: MPI.Comm, call: str, *numbers: float) -> list[float]:
    """Wait until all ranks make the same call. Collective.

    Args:
        comm: Communicator.
        call: Description of the call, with all arguments that must be the same.
        numbers: At most three numbers, of which the maximum over all ranks is returned.

    Returns:
        Maximum of each number over all ranks.

    Raises:
        ValueError: Ranks make different calls.
    """
    if comm.size == 1:
        return list(numbers)
    pending = PendingCall(comm, call, *numbers)
    pending.wait()
    return pending.largest()


class PendingCall:
    """Pending check of a collective call. Local.

    Arguments as for `meet`.
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
            Whether all ranks have made the call.
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
        """Maximum of each number over all ranks, after a successful `wait`. Collective.

        Raises:
            ValueError: Ranks make different calls.
        """
        if self._largest[0] != -self._largest[1]:
            raise ValueError(different(self._comm.allgather(self._call)))
        return [float(number) for number in self._largest[2 : 2 + self._num_numbers]]


def different(calls: Iterable[str]) -> str:
    """Error message for different calls of ranks. Local."""
    each = " on some and ".join(dict.fromkeys(calls))
    return f"expected all ranks to do the same, given {each} on others"


def collective(cls: _Class) -> _Class:
    """Class decorator that checks collective calls of public methods with `meet`. Local.

    Nested calls are not checked again. Instances need an attribute ``_comm``.

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
    """Notify waiting ranks when this rank exits for any reason. Local."""
    atexit.register(_send_notes)


def _notified_by(rank: int) -> list[int]:
    """Ranks that an exiting rank notifies: two of them, as one may have exited as well."""
    return [r for r in range(min(MPI.COMM_WORLD.size, 3)) if r != rank][:2]


def _send_notes() -> None:
    comm = MPI.COMM_WORLD
    if not MPI.Is_finalized():
        empty = np.empty(0, dtype=np.int8)
        _pending.extend(comm.Isend(empty, rank, _TAG) for rank in _notified_by(comm.rank))
        time.sleep(_FAREWELL)


def _end_if_one_has_left(call: str) -> None:
    comm, status = MPI.COMM_WORLD, MPI.Status()
    if not comm.iprobe(tag=_TAG, status=status):
        return
    time.sleep(_GRACE * _notified_by(status.source).index(comm.rank))
    sys.stderr.write(
        f"rank {status.source} of {comm.size} has left the program, while rank {comm.rank} waits "
        f"for it in {call}: all ranks end\n"
    )
    sys.stderr.flush()
    comm.Abort(1)
