"""Number of systems that skip the Krylov method after failures."""

import numpy as np

from dolfinx_nts.common.archive import Archive

__all__ = ["KrylovFailures"]

# Largest number of doublings.
_MOST_DOUBLINGS = 5


class KrylovFailures:
    """Consecutive failures with new and strong factors, and remaining systems to skip."""

    def __init__(self) -> None:
        self._in_a_row = self._left = 0

    def count(self) -> None:
        """Record a failure: skip twice as many systems as after the last one. Local."""
        self._in_a_row = min(self._in_a_row + 1, _MOST_DOUBLINGS)
        self._left = 2**self._in_a_row

    def forget(self) -> None:
        """Record a success. Local."""
        self._in_a_row = self._left = 0

    def skip(self) -> bool:
        """Whether to skip the method for the next system, which is counted. Local."""
        is_left_out = self._left > 0
        self._left -= is_left_out
        return is_left_out

    def serialize(self, archive: Archive) -> None:
        """Serialize the numbers. Collective."""
        numbers = archive.same("hopeless_systems", np.array([self._in_a_row, self._left]))
        if archive.giving:
            self._in_a_row, self._left = map(int, numbers)
