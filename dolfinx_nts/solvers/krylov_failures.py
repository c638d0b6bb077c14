"""For how many systems a Krylov method that failed is not tried again."""

import numpy as np

from dolfinx_nts.common.archive import Archive

__all__ = ["KrylovFailures"]

# How often the number of systems doubles.
_MOST_DOUBLINGS = 5


class KrylovFailures:
    """Failures in a row with new and strong factors, and systems that are still left out."""

    def __init__(self) -> None:
        """Begin without a failure."""
        self._in_a_row = self._left = 0

    def count(self) -> None:
        """Note a failure: leave out twice as many systems as last time. Local."""
        self._in_a_row = min(self._in_a_row + 1, _MOST_DOUBLINGS)
        self._left = 2**self._in_a_row

    def forget(self) -> None:
        """Note that the method has not failed. Local."""
        self._in_a_row = self._left = 0

    def skip(self) -> bool:
        """Whether the next system is left out, which counts. Local."""
        is_left_out = self._left > 0
        self._left -= is_left_out
        return is_left_out

    def serialize(self, archive: Archive) -> None:
        """Serialize the numbers. Collective."""
        numbers = archive.same("hopeless_systems", np.array([self._in_a_row, self._left]))
        if archive.giving:
            self._in_a_row, self._left = map(int, numbers)
