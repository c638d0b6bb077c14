"""Failures on one rank: the others learn of them, so that none waits for ever.

`agreed` raises the error of one rank on all, where all get to the same place.
Where they do not, as they wait for each other inside, the error of the one
leaves the program, and `end_together` ends the others.
"""

import pickle
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any

from mpi4py import MPI

import numpy as np

__all__ = ["agreed", "end_together", "portable"]

# Seconds that a rank which failed waits for the others to agree,
_PATIENCE = 0.5
# and before it ends the program for others that fail as well.
_GRACE = 0.25
_TAG = 20110  # of the notes that ranks send when they fail
_LONGEST = 1000  # characters of a note, which is sent without being awaited
# Messages that may never be received need their memory to the end.
_pending: list[MPI.Request] = []


@contextmanager
def agreed(comm: MPI.Comm) -> Iterator[None]:
    """Context in which an error of one rank is raised on all. Collective.

    Of several errors it is that of the lowest rank. A rank that waits for
    the others in vain, because they wait for it inside the context,
    raises its own error alone.

    Args:
        comm: Communicator.

    Raises:
        Exception: That of a rank.
    """
    error: Exception | None = None
    try:
        yield
    except Exception as failure:
        error = failure
    mine = np.array([comm.size if error is None else comm.rank])
    first = np.empty_like(mine)
    request, start = comm.Iallreduce(mine, first, op=MPI.MIN), time.monotonic()
    while error is not None and not request.Test():
        if time.monotonic() - start > _PATIENCE:
            _pending.append(request)
            raise error
        time.sleep(1e-3)
    request.Wait()
    if first[0] < comm.size:
        shared = comm.bcast(None if error is None else portable(error), root=first[0])
        raise error if comm.rank == first[0] and error is not None else shared


def portable(error: Exception) -> Exception:
    """Error as it can be sent to other ranks. Local."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def end_together() -> None:
    """Let an exception that leaves the program on one rank end it on all. Local.

    One rank says what happened, with its traceback, and `MPI.Comm.Abort` ends
    the ranks that did not fail. With one rank, and in an interactive session,
    nothing is changed.
    """
    interactive = hasattr(sys, "ps1") or sys.flags.interactive
    if MPI.COMM_WORLD.size > 1 and not interactive and not isinstance(sys.excepthook, _Hook):
        sys.excepthook = _Hook(sys.excepthook)


class _Hook:
    """Takes the place of `sys.excepthook`, which it calls on one rank.

    Args:
        former: The hook that was there.
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
            # Who speaks may have failed later than this rank.
            time.sleep(0.0 if speaks else 2 * _GRACE)
            comm.Abort(1)


def _exchanged(comm: MPI.Comm, note: str) -> dict[int, str]:
    """Notes of the ranks that fail within the grace, by rank."""
    others = (rank for rank in range(comm.size) if rank != comm.rank)
    _pending.extend(comm.isend(note, rank, _TAG) for rank in others)
    notes, start = {comm.rank: note}, time.monotonic()
    while len(notes) < comm.size and time.monotonic() - start < _GRACE:
        status = MPI.Status()
        if comm.iprobe(tag=_TAG, status=status):
            notes[status.source] = comm.recv(source=status.source, tag=_TAG)
        else:
            time.sleep(1e-3)
    return notes
