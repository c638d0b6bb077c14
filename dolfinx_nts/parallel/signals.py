"""Deferral of interrupts (Ctrl-C, SIGTERM, closed pipe) to the end of a step."""

import errno
import os
import signal
import sys
import threading
from types import FrameType
from typing import Any

from mpi4py import MPI

from dolfinx_nts.parallel import reductions

__all__ = ["Interrupts", "restore_broken_pipe"]

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
# Streams of `sys` that a script and the traceback of an error write to.
_STREAMS = ("stdout", "stderr")


def restore_broken_pipe() -> None:
    """Restore Python's own handling of SIGPIPE, which PETSc replaces. Local.

    Python ignores the signal, so that writing to a closed pipe raises ``BrokenPipeError``. The
    handler of PETSc aborts the program instead, and hangs if Open MPI reports a killed ``mpirun``
    by such a pipe.
    """
    if threading.current_thread() is threading.main_thread():
        handler = signal.getsignal(signal.SIGPIPE)
        if handler is not None:
            signal.signal(signal.SIGPIPE, handler)


class Interrupts:
    """Context that registers a first signal; a second one takes effect immediately.

    A pipe that its reader has closed counts as a signal, SIGPIPE: output to it is dropped from
    then on. The reader, such as ``tee``, often ends by the Ctrl-C that interrupts the run.
    Signals that the program ignores stay ignored. Only the main thread of Python receives
    signals; in other threads the context does nothing. Local, except where a method says
    otherwise.

    Args:
        comm: Communicator whose ranks stop together.

    Attributes:
        took_effect: Whether a signal that had waited for the end of a step took effect.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        self._comm = comm
        self._signum, self.took_effect = 0, False
        self._former: dict[int, Any] = {}
        self._streams: dict[str, Any] = {}

    def __enter__(self) -> "Interrupts":
        """Install the signal handlers."""
        if threading.current_thread() is threading.main_thread():
            self._signum = 0
            for signum in _SIGNALS:
                if signal.getsignal(signum) is not signal.SIG_IGN:
                    self._former[signum] = signal.signal(signum, self._note)
            for name in _STREAMS:
                stream = getattr(sys, name)
                if stream is not None:
                    self._streams[name] = stream
                    setattr(sys, name, _Stream(stream, self._note))
        return self

    def __exit__(self, *error: object) -> None:
        """Restore the handlers and streams that were there before."""
        for signum, handler in self._former.items():
            signal.signal(signum, signal.SIG_DFL if handler is None else handler)
        for name, stream in self._streams.items():
            if isinstance(getattr(sys, name), _Stream):
                setattr(sys, name, stream)
        self._former, self._streams = {}, {}

    def received(self) -> int:
        """Number of a signal that any rank has received, or 0. Collective."""
        return int(reductions.largest(self._comm, self._signum))

    def take_effect(self, signum: int) -> None:
        """Raise the error, or end the process, as the signal would have done immediately.

        If the handler of the script returns, the run continues and signals are registered again.

        Args:
            signum: Number of the signal.

        Raises:
            BrokenPipeError: The signal is SIGPIPE.
        """
        self.took_effect = True
        if self._former and signum in _SIGNALS and signum not in self._former:
            # Ignored on this rank, but not on all: the ranks stop together.
            default = signal.default_int_handler if signum == signal.SIGINT else signal.SIG_DFL
            signal.signal(signum, default)
        self._raise(signum)
        self.took_effect = False
        self.__enter__()

    def _note(self, signum: int, frame: FrameType | None) -> None:
        if signum == signal.SIGPIPE:
            self._signum = self._signum or signum
        elif self._signum in (0, signal.SIGPIPE):
            self._signum = signum
        else:
            self._raise(signum)

    def _raise(self, signum: int) -> None:
        self.__exit__()
        if signum == signal.SIGPIPE:
            raise BrokenPipeError(
                errno.EPIPE, f"{os.strerror(errno.EPIPE)}: nobody reads the output"
            )
        signal.raise_signal(signum)


class _Stream:
    """Text stream that registers a closed pipe once, and drops further output.

    Args:
        stream: The stream. Its other attributes are available through this object.
        note: Handler that is called with SIGPIPE.
    """

    def __init__(self, stream: Any, note: Any) -> None:
        self._stream, self._note, self._is_closed = stream, note, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write text, unless the pipe is closed."""
        self._forward("write", text)
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write several texts, unless the pipe is closed."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Write the buffered output, unless the pipe is closed."""
        self._forward("flush")

    def _forward(self, method: str, *given: str) -> None:
        if self._is_closed:
            return
        try:
            getattr(self._stream, method)(*given)
        except BrokenPipeError:
            self._is_closed = True
            self._note(signal.SIGPIPE, None)
