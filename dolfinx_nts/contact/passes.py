"""Passes of contact: pairs of a stepper, of which some are opposite to others.

Where nodes of both sides of a contact have springs, as with `two_half_passes`, each pair has a
part of the force only.
"""

import weakref
from collections.abc import Callable
from typing import Protocol

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.pair import ContactPair

__all__ = ["Pass", "Passes"]


class Pass(Protocol):
    """Contact of a pair in a stepper."""

    pair: ContactPair

    @property
    def history(self) -> ContactHistory:
        """Contact of the last accepted step. Local."""


class Passes:
    """All passes of a stepper in the order of its pairs. Local.

    Args:
        positions: Returns the positions of the local nodes of the last step, ``(l, 3)`` [m].
        time: Returns the time at its end [s].

    Attributes:
        positions, time: The arguments.
    """

    def __init__(self, positions: Callable[[], Floats], time: Callable[[], float]) -> None:
        """Begin without a pass."""
        self.positions, self.time = positions, time
        # Weak, as those in a circle would be removed at another time on each rank.
        self._all: list[weakref.ref[Pass]] = []

    def join(self, member: Pass) -> None:
        """Add a pass."""
        self._all.append(weakref.ref(member))

    def opposite_to(self, pair: ContactPair) -> list[Pass]:
        """Passes whose nodes are the segments of a pair, and the reverse."""
        passes = [member for ref in self._all if (member := ref()) is not None]
        return [
            other
            for other in passes
            if (other.pair.nodes, other.pair.segments) == (pair.segments, pair.nodes)
        ]
