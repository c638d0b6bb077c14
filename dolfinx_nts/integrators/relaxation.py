"""The way from a state without an equilibrium near it to another one, against a resistance.

The last resort of statics, where Newton's method finds no equilibrium: bodies roll to the next
facet, or snap. See `Drag` for the method. The equilibrium at the end is one without resistance.
"""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from dolfinx_nts.integrators.resistance import Resistance
from dolfinx_nts.solvers.newton import NewtonReport

__all__ = ["PseudoStep", "Relaxation"]

_logger = logging.getLogger("dolfinx_nts")

# Force of the resistance relative to those at work [-], from which on Newton's method is tried
# without it; and by how much it has to fall before it is tried again.
_NEAR, _NEARER = 1e-3, 0.1
# Linear systems [-] after which it is given up: far more than those of a snap.
_MOST_ITERATIONS = 800


class PseudoStep(NamedTuple):
    """What an attempt at a pseudo-step gave.

    Attributes:
        report: What Newton's method did.
        force: Force of the resistance relative to those at work [-]; 0 without resistance.
        way: Largest way of a node since the begin of the step [m].
    """

    report: NewtonReport
    force: float
    way: float


class Relaxation:
    """Pseudo-steps with less and less resistance, until none is needed. Collective.

    Args:
        attempt: Solves from the present state with a resistance, relative to the stiffness of
            the nodes, which is measured from there; 0 for none. Where it fails the state is as
            before.
        farthest: Way of a node from which on bodies are taken to go on for ever [m].
    """

    def __init__(self, attempt: Callable[[float], PseudoStep], farthest: float) -> None:
        """Begin at the present state."""
        self._attempt, self._farthest = attempt, farthest
        self.num_steps = self._iterations = 0

    def find(self) -> NewtonReport:
        """Go to an equilibrium; its ``reason`` says why there is none otherwise."""
        resistance, near = Resistance(), _NEAR
        while True:
            step = self._solve(resistance.part)
            if step.report.converged:
                resistance.accept()
                is_near = step.force <= near or resistance.is_gone
                if step.way > self._farthest:
                    reason = (
                        f"bodies go on by more than their size of {self._farthest:.3g} m: "
                        "what follows is a motion"
                    )
                    return self._told(step.report, reason)
                if is_near:
                    near = _NEARER * step.force
                    last = self._solve(0.0)
                    if last.report.converged:
                        return self._told(last.report, "")
                if resistance.is_gone:
                    return self._told(step.report, "there is no equilibrium where they end")
            else:
                resistance.fail()
                if resistance.is_too_large:
                    return self._told(step.report, step.report.reason)
            if self._iterations > _MOST_ITERATIONS:
                return self._told(step.report, f"no end in {self._iterations} iterations")

    def _solve(self, part: float) -> PseudoStep:
        step = self._attempt(part)
        self.num_steps += 1
        self._iterations += step.report.iterations
        _logger.debug(
            "pseudo-step %d: resistance %.1e of the stiffness, %d iterations, %s, %.1e of the "
            "forces at work left, nodes have gone up to %.3g m",
            *(self.num_steps, part, step.report.iterations),
            *(step.report.reason or "solved", step.force, step.way),
        )
        return step

    def _told(self, report: NewtonReport, reason: str) -> NewtonReport:
        """Report of the last attempt with the iterations of all."""
        return replace(report, iterations=self._iterations, reason=reason)
