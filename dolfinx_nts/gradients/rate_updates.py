"""Rates at the end of a step as linear functions of the states of the step."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.integrators.implicit.generalized_alpha import NewmarkRates
from dolfinx_nts.integrators.rates import MidpointRates, NoRates, Rates

__all__ = ["RateUpdate", "rate_update"]


class RateUpdate(NamedTuple):
    """Rates that a scheme carries from step to step, and their update.

    Attributes:
        carried: Functions of the rates at the start of a step, ``r`` in number: velocity, with
            `NewmarkRates` acceleration, and last the mean velocity of the step before, where
            points of mortar contact are chosen; none without inertia.
        of_end: Derivatives of the new rates with respect to the displacement at the end, ``(r,)``.
        of_start: Derivatives with respect to the displacement at the start, shape ``(r,)``.
        of_rates: Derivatives with respect to the old rates, shape ``(r, r)``.
    """

    carried: Sequence[fem.Function]
    of_end: Floats
    of_start: Floats
    of_rates: Floats


def rate_update(rates: Rates) -> RateUpdate:
    """Update of the rates for the current length of the step. Local.

    Raises:
        TypeError: The rates are of a kind that is not supported.
    """
    if isinstance(rates, MidpointRates):
        speed = np.array([2.0, 1.0]) / float(rates.dt.value)
        of_rates = np.array([[-1.0, 0.0], [0.0, 0.0]])
        return RateUpdate([rates.v, rates.mean_velocity], speed, -speed, of_rates)
    if isinstance(rates, NewmarkRates):
        p, dt = rates.parameters, float(rates.dt.value)
        # Derivatives of velocity and acceleration at the end: by displacement, and by both at the
        # start.
        rest = 1 / (2 * p.beta) - 1
        of_a = np.array([1.0, -dt, -rest * p.beta * dt**2]) / (p.beta * dt**2)
        of_v = dt * p.gamma * of_a + np.array([0.0, 1.0, dt * (1 - p.gamma)])
        of_mean = np.array([1 / dt, 0.0, 0.0])
        rows = np.array([of_v, of_a, of_mean])
        of_rates = np.column_stack([rows[:, 1:], np.zeros(3)])
        carried = [rates.v, rates.a, rates.mean_velocity]
        return RateUpdate(carried, rows[:, 0], -rows[:, 0], of_rates)
    if isinstance(rates, NoRates):
        return RateUpdate([], np.zeros(0), np.zeros(0), np.zeros((0, 0)))
    raise TypeError(
        "expected a stepper whose derivatives are known, EnergyMomentum, Midpoint, "
        f"GeneralizedAlpha or QuasiStatic, given one with {type(rates).__name__}"
    )
