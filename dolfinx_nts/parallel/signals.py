"""Interrupts that wait for the end of a step: Ctrl-C and SIGTERM."""

import signal
import threading
from types import FrameType
from typing import Any

from mpi4py import MPI

from dolfinx_nts.parallel import reductions

__all__ = ["Interrupts"]

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupts:
    """Context in which the first signal only raises a flag.

    The second takes effect at once. Only the main thread of Python gets
    signals; in another one the context does nothing.

    Args:
        comm: Communicator whose ranks stop together.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        """Wait to be entered."""
        self._comm = comm
        self._signum = 0
        self._former: dict[int, Any] = {}

    def __enter__(self) -> "Interrupts":
        """Take over the signals."""
        if threading.current_thread() is threading.main_thread():
            self._former = {signum: signal.signal(signum, self._note) for signum in _SIGNALS}
        return self

    def __exit__(self, *error: object) -> None:
        """Give them back."""
        for signum, handler in self._former.items():
            signal.signal(signum, signal.SIG_DFL if handler is None else handler)
        self._former = {}

    def received(self) -> int:
        """Number of a signal that any rank has got, 0 if none. Collective."""
        return int(reductions.largest(self._comm, self._signum))

    def take_effect(self, signum: int) -> None:
        """Do what the signal would have done: raise, or end the process."""
        self.__exit__()
        signal.raise_signal(signum)

    def _note(self, signum: int, frame: FrameType | None) -> None:
        if self._signum:
            self.take_effect(signum)
        self._signum = signum
