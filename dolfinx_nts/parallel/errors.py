"""Propagation of errors on one rank to all ranks, to avoid deadlocks.

`agreed` raises the error of one rank on all ranks if all of them reach the end of its context. If
they wait for the failed rank inside the context, the error ends the program on the failed rank, and
`end_together` ends the others.
"""

import math
import pickle
import sys
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any

from mpi4py import MPI

from dolfinx_nts.parallel.collective_calls import PendingCall, different, leave_with_notes

__all__ = ["agreed", "all_come", "end_together", "portable"]

# Time [s] that a failed rank waits for the others at the end of a context. Shorter: the program
# ends although others would have arrived; longer: the error is delayed.
_PATIENCE = 0.5
# Time [s] that a rank waits for error messages of others before it ends the program.
_GRACE = 0.25
# Time [s] between two tests of a request, to leave the core to other processes.
_PAUSE = 1e-3
# Unique tag of error messages.
_TAG = 20110
# Longest error message [characters], short enough for an eager send of MPI.
_LONGEST = 1000
# Requests of messages that may never be received; their memory must exist until the end.
_pending: list[MPI.Request] = []


@contextmanager
def agreed(comm: MPI.Comm, call: str) -> Iterator[list[str]]:
    """Context that raises an error of one rank on all ranks. Collective.

    If several ranks fail, all raise the error of the lowest one. If the others wait inside the
    context, the failed rank raises its own error alone.

    Args:
        comm: Communicator.
        call: Description of the call, as in `meet`.

    Returns:
        Context of a list of texts that must also be the same on all ranks.

    Raises:
        Exception: The error raised in the context on a rank.
        ValueError: Ranks make different calls, or add different texts.
    """
    error: Exception | None = None
    more: list[str] = []
    try:
        yield more
    except Exception as failure:
        error = failure
    if comm.size == 1:
        if error is not None:
            raise error
        return
    # A failed rank does not take part in the comparison of texts.
    code = zlib.crc32("\n".join(more).encode())
    own = (code, -code) if error is None else (-math.inf, -math.inf)
    pending = PendingCall(comm, call, -float(comm.size if error is None else comm.rank), *own)
    if error is not None and not pending.wait(_PATIENCE):
        raise error
    pending.wait()
    largest, *codes = pending.largest()
    if (first := -int(largest)) < comm.size:
        shared = comm.bcast(None if error is None else portable(error), root=first)
        raise error if comm.rank == first and error is not None else shared
    if codes[0] != -codes[1]:
        each = comm.allgather(more)
        calls = (
            ", ".join(item for item in one if any(item not in o for o in each)) for one in each
        )
        raise ValueError(different(f"{call} with {some or 'nothing else'}" for some in calls))


def all_come(comm: MPI.Comm, call: str) -> bool:
    """Whether all ranks make this call within `_PATIENCE`, even after an error on some ranks.

    Args:
        comm: Communicator.
        call: Description of the call, as in `meet`.
    """
    if comm.size == 1:
        return True
    pending = PendingCall(comm, call)
    try:
        return pending.wait(_PATIENCE) and pending.largest() == []
    except ValueError:  # other ranks make a different call
        return False


def portable(error: Exception) -> Exception:
    """Error in a form that can be sent to other ranks. Local.

    Args:
        error: Any error.

    Returns:
        The error itself, or a RuntimeError with its text if it cannot be pickled.
    """
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def end_together() -> None:
    """Let an error, or ``sys.exit``, on one rank end the program on all. Local.

    After an uncaught exception one rank prints the traceback, and `MPI.Comm.Abort` ends the ranks
    that did not fail. A rank that exits normally notifies waiting ranks. On one rank and in an
    interactive session nothing is changed.
    """
    interactive = hasattr(sys, "ps1") or sys.flags.interactive
    if MPI.COMM_WORLD.size > 1 and not interactive and not isinstance(sys.excepthook, _Hook):
        sys.excepthook = _Hook(sys.excepthook)
        leave_with_notes()


class _Hook:
    """Replaces `sys.excepthook`, which it calls on one rank.

    Args:
        former: The hook that it replaces.
    """

    def __init__(self, former: Any) -> None:
        self._former = former

    def __call__(
        self, kind: type[BaseException], error: BaseException, trace: TracebackType | None
    ) -> None:
        if MPI.Is_finalized():
            self._former(kind, error, trace)
            return
        comm = MPI.COMM_WORLD
        notes = _exchanged(comm, f"{kind.__name__}: {error}"[:_LONGEST])
        alone = len(notes) < comm.size
        speaks = comm.rank == min(notes)
        if speaks:
            if alone:
                sys.stderr.write(f"rank {comm.rank} of {comm.size} failed:\n")
            self._former(kind, error, trace)
            others = (item for item in sorted(notes.items()) if item[1] != notes[comm.rank])
            sys.stderr.writelines(f"rank {rank} failed with {note}\n" for rank, note in others)
            sys.stderr.flush()
        if alone:
            # The rank that prints may fail later than this rank.
            time.sleep(0.0 if speaks else 2 * _GRACE)
            comm.Abort(1)


def _exchanged(comm: MPI.Comm, note: str) -> dict[int, str]:
    """Exchange error messages with other failed ranks; returns them by rank."""
    others = (rank for rank in range(comm.size) if rank != comm.rank)
    _pending.extend(comm.isend(note, rank, _TAG) for rank in others)
    notes, start = {comm.rank: note}, time.monotonic()
    while len(notes) < comm.size and time.monotonic() - start < _GRACE:
        status = MPI.Status()
        if comm.iprobe(tag=_TAG, status=status):
            notes[status.source] = comm.recv(source=status.source, tag=_TAG)
        else:
            time.sleep(_PAUSE)
    return notes
