"""Pseudo-transient continuation to another equilibrium: a model with one unknown."""

import numpy as np
import pytest

from dolfinx_nts.integrators.statics.relaxation import PseudoStep, Relaxation, Resistance
from dolfinx_nts.solvers.newton_report import NewtonReport

# Limit load of x^3 - x = f in the well x < 0, which is at x = -1/sqrt(3) then.
LIMIT = 2 / 3 / np.sqrt(3)


class Model:
    """An unknown x with the residual R(x) = V'(x), from a start."""

    def __init__(self, residual, slope, start):
        """Begin at the start, without anything found."""
        self.residual, self.slope, self.start = residual, slope, start
        self.last = self.found = start

    def attempt(self, ratio):
        """Solve R(x) + ratio (x - last) = 0 by Newton's method, in few iterations."""
        x, norms = self.last, []
        while len(norms) < 15:
            R = self.residual(x) + ratio * (x - self.last)
            norms.append(abs(R))
            if abs(R) < 1e-13:
                reason = ""
                break
            x -= np.clip(R / (self.slope(x) + ratio), -1e3, 1e3)
        else:
            reason = "no convergence"
        self.found = x
        report = NewtonReport(len(norms), 0, tuple(norms), 0, reason)
        return PseudoStep(report, abs(x - self.last), abs(x - self.start))

    def accept(self):
        """Continue from the last state."""
        self.last = self.found

    def find(self):
        """Report of the relaxation."""
        return Relaxation(self.attempt, self.accept, farthest=10.0, size=0.1).find()


@pytest.mark.parametrize("beyond", [1e-6, 1e-3, 0.3])
def test_the_equilibrium_beyond_a_limit_point_agrees_with_the_closed_form(beyond):
    """The other well is the only root of the cubic, x = 2 cosh(arcosh(f / limit) / 3) / sqrt(3)."""
    f = LIMIT * (1 + beyond)
    model = Model(lambda x: x**3 - x - f, lambda x: 3 * x**2 - 1, -1 / np.sqrt(3))
    report = model.find()
    assert report.converged and report.iterations > 10
    exact = 2 / np.sqrt(3) * np.cosh(np.arccosh(f / LIMIT) / 3)
    assert model.last == pytest.approx(exact, rel=1e-12)


def test_bodies_that_move_for_ever_are_reported():
    model = Model(lambda x: -1.0, lambda x: 0.0, 0.0)
    report = model.find()
    assert "move by more than their size of 10 m" in report.reason
    assert model.last > 10.0


def test_resistance_falls_fast_until_a_pseudo_step_fails():
    resistance = Resistance()
    ratios = [resistance.ratio]
    for _ in range(3):
        resistance.accept(1.0)
        ratios.append(resistance.ratio)
    assert np.divide(ratios[1:], ratios[:-1]) == pytest.approx(0.1)
    resistance.fail()
    assert resistance.ratio == pytest.approx(4 * ratios[-1])


def test_resistance_falls_slowly_along_a_motion_that_is_not_stable_and_fast_at_rest():
    resistance = Resistance()
    resistance.fail()
    ratio = resistance.ratio
    for travel in (1.0, 2.0):
        assert resistance.ratio == ratio
        resistance.accept(travel)
    assert resistance.ratio == pytest.approx(ratio / 2)
    resistance.accept(1.0)
    assert resistance.ratio == pytest.approx(ratio / 20)


@pytest.mark.parametrize(("change", "end"), [("fail", "is_too_large"), ("accept", "is_negligible")])
def test_resistance_has_ends(change, end):
    resistance = Resistance()
    args = () if change == "fail" else (1.0,)
    for _ in range(20):
        getattr(resistance, change)(*args)
    assert getattr(resistance, end)
