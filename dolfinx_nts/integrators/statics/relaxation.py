"""Pseudo-transient continuation from a state without a nearby equilibrium to another one.

It is used in statics if Newton's method finds no equilibrium, for instance when bodies snap
through, or roll to the next facet. See `Drag` for the method. The final equilibrium has no
resistance.
"""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from dolfinx_nts.solvers.newton_report import NewtonReport

__all__ = ["IF_IT_MOVES", "PseudoStep", "Relaxation", "Resistance"]

_logger = logging.getLogger("dolfinx_nts")

# Advice if no equilibrium is found.
IF_IT_MOVES = (
    "if there is no equilibrium to snap to, bodies keep moving: use EnergyMomentum, with damping "
    "or plastic impact to come to rest, or prescribe displacements instead of loads"
)

# Ratio of increments of successive pseudo-steps, without an increase of the resistance [-], below
# which Newton's method is tried without resistance. Far from an equilibrium increments grow.
_SETTLED = 0.1
# Largest distance of an equilibrium without resistance, relative to the increment of the last
# pseudo-step and to a cell [-], at which it is accepted: Newton's method may converge to a distant
# equilibrium.
_FARTHER, _SAME = 10.0, 1e-3
# Number of initial pseudo-steps whose increments are not compared [-], as supports move in them.
_UNCOUNTED = 1
# Limit on the number of linear systems [-], far above the number for a snap-through.
_MOST_ITERATIONS = 800

# Resistance relative to the stiffness of nodes [-]: initial value; largest value, at which bodies
# hardly move; and least value, below which it has no effect.
_FIRST, _LARGEST, _LEAST = 1e-2, 10.0, 1e-10
# Factor of the resistance [-] after a successful pseudo-step, after `_PATIENCE` of them along an
# unstable motion, and after a failed one.
_FALL, _SLOW_FALL, _RISE = 0.1, 0.5, 4.0
# Driving force (increment times resistance) relative to the last pseudo-step [-], below which the
# motion decays.
_CALMER = 0.5
# Number of pseudo-steps [-] along an unstable motion after which the resistance is reduced. In each
# of them increments grow by a factor.
_PATIENCE = 2


class Resistance:
    """Resistance of the next pseudo-step: decreases after success, increases after failure. Local.

    It must be large enough for unstable motions, but slows down convergence.

    Attributes:
        ratio: Resistance relative to the stiffness of the nodes [-].
    """

    def __init__(self) -> None:
        self.ratio = _FIRST
        self._has_failed, self._drive, self._accepted = False, 0.0, 0

    def accept(self, increment: float) -> None:
        """Register a pseudo-step that succeeded, with its largest nodal increment [m]."""
        drive = self.ratio * increment
        calms, self._drive = drive < _CALMER * self._drive, drive
        self._accepted += 1
        if calms or not self._has_failed:
            self.ratio, self._accepted = _FALL * self.ratio, 0
        elif self._accepted >= _PATIENCE:
            self.ratio, self._accepted = _SLOW_FALL * self.ratio, 0

    def fail(self) -> None:
        """Raise the resistance after a pseudo-step that failed."""
        self.ratio, self._has_failed, self._accepted = _RISE * self.ratio, True, 0

    @property
    def is_too_large(self) -> bool:
        """Whether the resistance has reached its upper limit."""
        return self.ratio > _LARGEST

    @property
    def is_negligible(self) -> bool:
        """Whether the resistance is negligible."""
        return self.ratio < _LEAST


class PseudoStep(NamedTuple):
    """Result of an attempt at a pseudo-step.

    Attributes:
        report: Report of Newton's method.
        increment: Largest displacement increment of a node in the pseudo-step [m].
        total: Largest displacement of a node since the start of the step [m].
    """

    report: NewtonReport
    increment: float
    total: float


class Relaxation:
    """Pseudo-steps with a resistance that decreases to zero. Collective.

    Args:
        attempt: Solves from the last state with a resistance relative to the stiffness of the
            nodes; 0 for none.
        accept: Makes the solution of the last attempt the last state.
        farthest: Largest nodal displacement [m]; if it is exceeded, there is no equilibrium nearby.
        size: Size of the smallest cell [m].

    Attributes:
        num_steps: Number of attempts.
    """

    def __init__(
        self,
        attempt: Callable[[float], PseudoStep],
        accept: Callable[[], None],
        *,
        farthest: float,
        size: float,
    ) -> None:
        self._attempt, self._accept = attempt, accept
        self._farthest, self._size = farthest, size
        self.num_steps = self._iterations = 0

    def find(self) -> NewtonReport:
        """Search for an equilibrium; ``reason`` of the report says why none was found."""
        resistance, before, count = Resistance(), (0.0, 0.0), 0
        while self._iterations <= _MOST_ITERATIONS:
            ratio = resistance.ratio
            step = self._solve(ratio)
            report = step.report
            if not report.converged:
                resistance.fail()
                if resistance.is_too_large:
                    return self._report(report, report.reason)
                continue
            self._accept()
            if step.total > self._farthest:
                reason = f"bodies move by more than their size of {self._farthest:.3g} m"
                return self._report(report, reason)
            resistance.accept(step.increment)
            count += 1
            rests = (
                count > _UNCOUNTED + 1
                and ratio <= before[0]
                and step.increment <= _SETTLED * before[1]
            )
            before = ratio, step.increment
            if rests or resistance.is_negligible:
                last = self._solve(0.0)
                if last.report.converged and last.increment <= self._distance_from_last(
                    step.increment
                ):
                    self._accept()
                    return self._report(last.report, "")
                if resistance.is_negligible:
                    nothing = "there is no equilibrium near their end"
                    return self._report(report, last.report.reason or nothing)
        return self._report(report, f"no equilibrium after {self._iterations} iterations")

    def _distance_from_last(self, increment: float) -> float:
        """Largest distance of the equilibrium from the last pseudo-step [m]."""
        return max(_FARTHER * increment, _SAME * self._size)

    def _solve(self, ratio: float) -> PseudoStep:
        step = self._attempt(ratio)
        self.num_steps += 1
        self._iterations += step.report.iterations
        _logger.debug(
            "pseudo-step %d: resistance of %.1e of the stiffness, %d iterations, %s, increment "
            "up to %.3g m, displacement up to %.3g m since the start of the step",
            *(self.num_steps, ratio, step.report.iterations),
            *(step.report.reason or "solved", step.increment, step.total),
        )
        return step

    def _report(self, report: NewtonReport, reason: str) -> NewtonReport:
        """Report of the last attempt with the iterations of all attempts."""
        return replace(report, iterations=self._iterations, reason=reason)
