"""The present state of a stepper for several who describe it, each part evaluated once."""

from functools import cached_property

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.integrators.stepper import Stepper

__all__ = ["Present", "PresentPair"]


class PresentPair:
    """Contact of one pair at present. Collective, as its attributes are when they are first used.

    Args:
        state: State of the pair.
        x: Positions of the local nodes, owned and ghost, shape ``(l, 3)`` [m].

    Attributes:
        state: The argument.
        gap: Gap of each node at any distance, NaN where it faces nothing, shape ``(n,)`` [m].
        pressure: Contact pressure of each node, shape ``(n,)`` [Pa].
    """

    def __init__(self, state: PairState, x: Floats) -> None:
        """Take the pair."""
        self.state, self._x = state, x

    @cached_property
    def gap(self) -> Floats:
        """Gap of each node, see above."""
        return self.state.gap(self._x)

    @cached_property
    def pressure(self) -> Floats:
        """Contact pressure of each node, see above."""
        return self.state.pressure

    @property
    def history(self) -> ContactHistory:
        """Contact of the last step. Local."""
        return self.state.history


class Present:
    """Present state of a stepper, valid until the stepper changes. Local.

    Args:
        stepper: The stepper.

    Attributes:
        stepper: The argument.
        x: Positions of the local nodes, owned and ghost, shape ``(l, 3)`` [m].
        pairs: Contact of its pairs.
        has_gaps: Whether the gaps of all pairs have been found.
    """

    def __init__(self, stepper: Stepper) -> None:
        """Take the positions."""
        self.stepper, self.x = stepper, stepper.x
        self.pairs = [PresentPair(contact, self.x) for contact in stepper.contacts]
        self.has_gaps = False

    def find_gaps(self) -> None:
        """Find the gaps of all pairs, as fields need them. Collective."""
        self.has_gaps = all(pair.gap is not None for pair in self.pairs)
