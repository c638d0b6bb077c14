"""Stored states of a run, and repetition of parts of it to bound the memory."""

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.archive import Snapshot
from dolfinx_nts.contact.implicit.contact_step import ContactStep, contact_forces
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.gradients.contact_derivative import ContactDerivative
from dolfinx_nts.gradients.contact_difference import ContactDifference
from dolfinx_nts.gradients.forces import StepForces
from dolfinx_nts.gradients.step_derivative import MotionState, StepRecord
from dolfinx_nts.gradients.support import check_open, check_resisted, has_exact_derivative
from dolfinx_nts.integrators.implicit.generalized_alpha import NewmarkRates
from dolfinx_nts.integrators.implicit.implicit_stepper import (
    ImplicitStepper,
    StepEquations,
    observed,
)

__all__ = ["StoredRun"]


class _Segment(NamedTuple):
    """Consecutive steps: state of the stepper at their start, and time at their end [s]."""

    start: Snapshot
    end: float


class StoredRun:
    """A run whose steps can be visited again in both directions. Collective, as are its methods.

    Args:
        stepper: The stepper, at the start of the run.
        carried: Rates that its scheme carries from step to step.
        every: Number of steps whose states are stored at a time; None for all.
        equations: Equations of its steps.
        forces: Forces of its steps in the objective.

    Attributes:
        has_differences: Whether any step has contact without an adjoint.
        computes_acceleration: Whether the first step computes the acceleration at its start.
    """

    def __init__(
        self,
        stepper: ImplicitStepper,
        carried: Sequence[fem.Function],
        every: int | None,
        equations: StepEquations,
        forces: StepForces,
    ) -> None:
        self._stepper, self._carried, self._every = stepper, carried, every
        self._forces, self._relief, self._released = forces, equations.relief, equations.released
        self.has_differences, rates = False, equations.rates
        self.computes_acceleration = isinstance(rates, NewmarkRates) and not rates.is_known
        self._segments: list[_Segment] = []
        # Steps of one segment, and its number.
        self._records: list[StepRecord] = []
        self._known = -1

    def forward(self, until: float) -> Iterator[StepRecord]:
        """Run until a time [s] and return the steps."""
        steps = self._recorded(until)
        while True:
            start = Snapshot()
            self._stepper.serialize(start)
            records: list[StepRecord] = []
            for record in islice(steps, self._every):
                records.append(record)
                self.has_differences |= len(record.differences) > 0
                yield record
            if not records:
                break
            self._records, self._known = records, len(self._segments)
            self._segments.append(_Segment(start, self._stepper.t))

    def steps(self, *, backwards: bool) -> Iterator[tuple[StepRecord, bool]]:
        """Steps of the run in either order, each with a flag whether it is the last step."""
        numbers = range(len(self._segments))
        for number in reversed(numbers) if backwards else numbers:
            self._repeat(number)
            count = len(self._records)
            for i in reversed(range(count)) if backwards else range(count):
                is_last = number == len(self._segments) - 1 and i == count - 1
                yield self._records[i], is_last

    def _repeat(self, number: int) -> None:
        """Run the steps of a segment again, unless their states are stored."""
        if number != self._known:
            segment = self._segments[number]
            self._stepper.serialize(segment.start.rewind())
            self._records = list(self._recorded(segment.end))
            self._known = number

    def _recorded(self, until: float) -> Iterator[StepRecord]:
        stepper = self._stepper
        # The first step may compute the acceleration at its start.
        start, t_n = self._state(), stepper.t
        rates_n, is_first = start.rates, self.computes_acceleration and not self._segments
        contacts: list[ContactDerivative] = []
        differences: list[ContactDifference] = []
        contact_force = np.zeros(self._forces.shape)

        def observe(steps: Sequence[ContactStep], states: Sequence[ContactContribution]) -> None:
            nonlocal rates_n, is_first, contact_force
            contacts.clear()
            differences.clear()
            rates_n = self._state().rates
            if is_first:
                check_open(steps)
            is_first = False
            if self._forces.has_contact:
                contact_force = contact_forces(steps, states, self._forces.shape)
            for step, state in zip(steps, states, strict=True):
                if has_exact_derivative(step, state, gives_back=self._released is not None):
                    contacts.append(ContactDerivative(step, state, stepper.scheme.contact))
                else:
                    differences.append(ContactDifference(step, state, stepper.x, self._released))

        with observed(stepper, observe):
            for report in stepper.run(until):
                check_resisted(self._relief)
                end = self._state()
                known = tuple(contacts), tuple(differences)
                start = start._replace(rates=rates_n)
                forces = self._forces.of(report.reactions, contact_force)
                yield StepRecord(t_n, report.dt, report.t, start, end, *known, forces)
                start, t_n = end, stepper.t
                contacts.clear()
                differences.clear()

    def _state(self) -> MotionState:
        rates = [function.x.array.copy() for function in self._carried]
        return MotionState(self._stepper.u.x.array.copy(), rates, {})
