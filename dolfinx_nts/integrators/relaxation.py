"""The way from a state without an equilibrium near it to another one, against a resistance.

The last resort of statics, where Newton's method finds no equilibrium: bodies roll to the next
facet, or snap. See `Drag` for the method. The equilibrium at the end is one without resistance.
"""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from dolfinx_nts.integrators.resistance import Resistance
from dolfinx_nts.solvers.newton_report import NewtonReport

__all__ = ["IF_IT_MOVES", "PseudoStep", "Relaxation"]

_logger = logging.getLogger("dolfinx_nts")

# What helps where bodies come to no rest.
IF_IT_MOVES = (
    "where bodies snap to no equilibrium at all they move: EnergyMomentum follows that, to rest "
    "with damping or plastic impact, and given displacements instead of loads may lead past it"
)

# Way of a pseudo-step relative to that of the last one, with no less resistance [-], from which on
# Newton's method is tried without: away from an equilibrium ways become longer while it falls.
_SETTLED = 0.1
# How far an equilibrium without resistance may be, relative to the way of the last pseudo-step and
# to a cell [-], to be the one to which these lead: Newton's method alone may go anywhere.
_FARTHER, _SAME = 10.0, 1e-3
# Pseudo-steps that do not count for that [-]: in the first supports go their way.
_FIRST = 1
# Linear systems [-] after which it is given up: far more than those of a snap.
_MOST_ITERATIONS = 800


class PseudoStep(NamedTuple):
    """What an attempt at a pseudo-step gave.

    Attributes:
        report: What Newton's method did.
        way: Largest way of a node in it [m].
        gone: Largest way of a node since the begin of the step [m].
    """

    report: NewtonReport
    way: float
    gone: float


class Relaxation:
    """Pseudo-steps with less and less resistance, until none is needed. Collective.

    Args:
        attempt: Solves from the last state with a resistance, relative to the stiffness of the
            nodes, which is measured from there; 0 for none.
        accept: Makes the solution of the last attempt the last state.
        farthest: Way of a node from which on bodies are taken to go on for ever [m].
        size: That of the smallest cell [m].

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
        """Go to an equilibrium; its ``reason`` says why there is none otherwise."""
        resistance, before, count = Resistance(), (0.0, 0.0), 0
        while self._iterations <= _MOST_ITERATIONS:
            part = resistance.part
            step = self._solve(part)
            report = step.report
            if not report.converged:
                resistance.fail()
                if resistance.is_too_large:
                    return self._told(report, report.reason)
                continue
            self._accept()
            if step.gone > self._farthest:
                reason = f"bodies go on by more than their size of {self._farthest:.3g} m"
                return self._told(report, reason)
            resistance.accept(step.way)
            count += 1
            rests = count > _FIRST + 1 and part <= before[0] and step.way <= _SETTLED * before[1]
            before = part, step.way
            if rests or resistance.is_gone:
                last = self._solve(0.0)
                if last.report.converged and last.way <= self._same(step.way):
                    self._accept()
                    return self._told(last.report, "")
                if resistance.is_gone:
                    nothing = "there is no equilibrium where they end"
                    return self._told(report, last.report.reason or nothing)
        return self._told(report, f"no end in {self._iterations} iterations")

    def _same(self, way: float) -> float:
        """Largest way to the equilibrium to which the last pseudo-step led [m]."""
        return max(_FARTHER * way, _SAME * self._size)

    def _solve(self, part: float) -> PseudoStep:
        step = self._attempt(part)
        self.num_steps += 1
        self._iterations += step.report.iterations
        _logger.debug(
            "pseudo-step %d: resistance of %.1e of the stiffness, %d iterations, %s, nodes go up "
            "to %.3g m, %.3g m since the begin of the step",
            *(self.num_steps, part, step.report.iterations),
            *(step.report.reason or "solved", step.way, step.gone),
        )
        return step

    def _told(self, report: NewtonReport, reason: str) -> NewtonReport:
        """Report of the last attempt with the iterations of all."""
        return replace(report, iterations=self._iterations, reason=reason)
