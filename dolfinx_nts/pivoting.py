"""Pivoting: which nodes of a set of violators change their state.

Contact or none and stick or slip are decided node by node, but each decision
changes what all others see.
"""

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_nts.parallel import reductions

__all__ = ["Pivoting"]

Flags = npt.NDArray[np.bool_]
GlobalInts = npt.NDArray[np.int64]

_PATIENCE = 3  # iterations without fewer violators until one node changes at a time
_PERIOD = 3  # of the changes afterwards, so that Newton's method settles in between


class Pivoting:
    """Block pivoting (Judice, Pires 1994) within Newton's method.

    All violators change while they become fewer; Murty's rule, only the
    lowest, ends cycles. The rule knows linear problems: between its changes
    an iteration without any brings the iterate near to equilibrium, where
    decisions are to be trusted.

    Args:
        comm: Communicator.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        """Start with nothing known."""
        self._comm = comm
        self._fewest: float = np.inf
        self._last: float = np.inf
        self._patience = _PATIENCE

    def select(self, violates: Flags, ids: GlobalInts, iteration: int) -> tuple[Flags, int]:
        """Which nodes change. Collective.

        Args:
            violates: Nodes whose state contradicts its condition, ``(m,)``.
            ids: Their global numbers, shape ``(m,)``.
            iteration: Number of the Newton iteration.

        Returns:
            Flags, shape ``(m,)``; and the violators on this rank.
        """
        here = int(np.count_nonzero(violates))
        count = reductions.total(self._comm, here)
        if count < self._fewest:
            self._fewest, self._patience = count, _PATIENCE
        elif count and count >= self._last:
            self._patience -= 1
        self._last = count
        if count and self._patience < 0:
            if iteration % _PERIOD:
                return np.zeros_like(violates), here
            last = np.iinfo(np.int64).max
            lowest = reductions.least(self._comm, ids[violates].min(initial=last))
            violates = violates & (ids == lowest)
        return violates, here
