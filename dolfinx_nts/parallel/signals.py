"""Interrupts by Ctrl-C or SIGTERM that wait for the end of a step."""

import signal
import threading
from types import FrameType
from typing import Any

from mpi4py import MPI

from dolfinx_nts.parallel import reductions

__all__ = ["Interrupts"]

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupts:
    """Context in which a first signal is only noted, and a second takes effect at once.

    Only the main thread of Python receives signals; in other threads the context does nothing.
    Local, except where a method says otherwise.

    Args:
        comm: Communicator whose ranks stop together.

    Attributes:
        took_effect: Whether a signal that had waited for the end of a step took effect.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        """Change nothing before the context is entered."""
        self._comm = comm
        self._signum, self.took_effect = 0, False
        self._former: dict[int, Any] = {}

    def __enter__(self) -> "Interrupts":
        """Note signals from now on."""
        if threading.current_thread() is threading.main_thread():
            self._former = {signum: signal.signal(signum, self._note) for signum in _SIGNALS}
        return self

    def __exit__(self, *error: object) -> None:
        """Restore the handlers that were there before."""
        for signum, handler in self._former.items():
            signal.signal(signum, signal.SIG_DFL if handler is None else handler)
        self._former = {}

    def received(self) -> int:
        """Number of a signal that any rank has received, or 0. Collective."""
        return int(reductions.largest(self._comm, self._signum))

    def take_effect(self, signum: int) -> None:
        """Do what a signal would have done: raise an error, or end the process.

        Args:
            signum: Number of the signal.
        """
        self.took_effect = True
        self._raise(signum)

    def _note(self, signum: int, frame: FrameType | None) -> None:
        if self._signum:
            self._raise(signum)
        self._signum = signum

    def _raise(self, signum: int) -> None:
        self.__exit__()
        signal.raise_signal(signum)
