"""Conditions that end a run: a time, a contact force, or a function of the step."""

import math
from collections.abc import Callable, Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arguments import as_call, finite, kind_of, positive
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.errors import agreed

__all__ = ["Conditions", "ContactForce", "Until", "split"]


class ContactForce(Declaration):
    """Ends a run after the first step in which a contact force reaches a value. Local.

    Args:
        pair: A contact pair of the stepper.
        at_least: Magnitude of the resultant force on its nodes [N].

    Attributes:
        pair, at_least: The arguments.

    Raises:
        TypeError: ``pair`` is not a ContactPair, or ``at_least`` not a number.
        ValueError: ``at_least`` is not positive.

    Example:
        >>> until = nts.ContactForce(stepper.pairs[0], at_least=1.0e-3)  # N
        >>> steps = list(stepper.run(until=[1.0, until]))  # at most 1 s
        >>> float(np.linalg.norm(nts.Diagnostics(stepper).contact_force())) >= 1.0e-3
        True
    """

    def __init__(self, pair: ContactPair, *, at_least: float) -> None:
        if not isinstance(pair, ContactPair):
            raise TypeError(f"expected a ContactPair for a ContactForce, given {kind_of(pair)}")
        self.pair, self.at_least = pair, positive("at_least", at_least)

    def __repr__(self) -> str:
        return as_call(self, pair=self.pair, at_least=self.at_least)

    def holds(self, contacts: Sequence[PairState]) -> bool:
        """Whether the force of the last step has reached the value. Collective.

        Args:
            contacts: Contact of the stepper.

        Raises:
            ValueError: The stepper has no such pair.
        """
        own = [contact for contact in contacts if contact.pair.declared is self.pair.declared]
        if not own:
            raise ValueError(f"expected a pair of this stepper, given {self.pair.between}")
        comm: MPI.Comm = self.pair.nodes.V.mesh.comm
        force = reductions.total(comm, own[0].history.force.sum(axis=0))
        return bool(np.linalg.norm(force) >= self.at_least)


Condition = ContactForce | Callable[[StepReport], bool]
# End of a run: a time [s], a condition, or several of them; the first one ends the run.
Until = float | Condition | Sequence[float | Condition]


class Conditions:
    """Conditions that end a run, in addition to a time. Collective.

    Args:
        conditions: The conditions.
        comm: Communicator.
    """

    def __init__(self, conditions: Sequence[Condition], comm: MPI.Comm) -> None:
        self._all, self._comm = conditions, comm

    def hold(self, step: StepReport, contacts: Sequence[PairState]) -> bool:
        """Whether one of the conditions is met, the same on all ranks.

        A function need only be true on one rank.
        """
        if not self._all:
            return False
        found = False
        with agreed(self._comm, "evaluate until"):
            for condition in self._all:
                if not isinstance(condition, ContactForce):
                    found = bool(condition(step)) or found
        for condition in self._all:
            if isinstance(condition, ContactForce):
                found = condition.holds(contacts) or found
        return bool(reductions.anywhere(self._comm, found))


def split(until: Until, comm: MPI.Comm) -> tuple[float, Conditions]:
    """Split ``until`` into a time [s], infinite if none is given, and conditions. Local.

    Raises:
        TypeError: ``until`` is neither a number, nor a condition, nor a list of these.
        ValueError: A time is negative or not finite, or a list is empty.
    """
    items = list(until) if isinstance(until, Sequence) and not isinstance(until, str) else [until]
    if not items:
        raise ValueError("expected a time or condition as until, given an empty list")
    conditions: list[Condition] = []
    time = math.inf
    for item in items:
        if isinstance(item, ContactForce) or callable(item):
            conditions.append(item)
            continue
        if finite("until", item) < 0:
            raise ValueError(f"expected a time until >= 0 for the end of a run, given {item}")
        time = min(time, float(item))
    return time, Conditions(conditions, comm)
