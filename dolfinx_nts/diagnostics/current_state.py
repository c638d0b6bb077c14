"""Cache of derived quantities of the current state."""

from collections.abc import Sequence
from functools import cached_property

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.tractions import pressure_and_further_area
from dolfinx_nts.integrators.stepper import Stepper

__all__ = ["CurrentState"]


class CurrentState:
    """Derived quantities of the current state, valid until the next step.

    Args:
        stepper: The stepper.

    Attributes:
        stepper: The argument.
        step: Number of completed steps.
        contact_sums: Result of `history.contact_sums` for each pair, shape ``(p, 9)``, and forces
            between bodies, shape ``(b, 3)`` [N], summed over all ranks; None until they are known.
    """

    def __init__(self, stepper: Stepper) -> None:
        self.stepper, self.step = stepper, stepper.step
        self._gaps: Sequence[Floats] | None = None
        self.contact_sums: tuple[Floats, Floats] | None = None

    @cached_property
    def x(self) -> Floats:
        """Positions of the local nodes, owned and ghost, shape ``(l, 3)`` [m]. Local."""
        return self.stepper.x

    @property
    def has_gaps(self) -> bool:
        """Whether the gaps are known. Local."""
        return self._gaps is not None

    def gaps(self) -> Sequence[Floats]:
        """Gaps of the nodes of each pair at any distance, NaN without a candidate segment [m].

        Collective.
        """
        if self._gaps is None:
            self._gaps = [contact.gap(self.x) for contact in self.stepper.contacts]
        return self._gaps

    @property
    def pressures(self) -> Sequence[Floats]:
        """Contact pressures of the nodes of each pair [Pa]. Collective at the first use."""
        return [pressure for pressure, _ in self._pressed]

    @property
    def further_areas(self) -> Sequence[Floats]:
        """Areas of inactive nodes that receive forces [m^2]. Collective at the first use."""
        return [area for _, area in self._pressed]

    @cached_property
    def _pressed(self) -> Sequence[tuple[Floats, Floats]]:
        """Results of `pressure_and_further_area`, pair by pair."""
        return [pressure_and_further_area(contact) for contact in self.stepper.contacts]
