"""Stability of central differences: the longest step, and energy that must not grow."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.contact.explicit.penalty import ContactSprings
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.stable_step import Cells, Damping, largest_step

__all__ = ["Stability"]

Floats = npt.NDArray[np.float64]

# Parts of the estimate: the default step, and the longest step where springs
# are to be chosen, which need what is left.
_DEFAULT, _WITH_SPRINGS = 0.7, 0.9
_GROWTH = 0.25  # of the energy that is taken for an instability
_ROUNDING = 1e-20  # energy relative to that of one cell a step


class Stability:
    """What limits the step. Collective.

    Args:
        bodies: The bodies.
        springs: Springs of the contact pairs.
        mass: Of all bodies [kg].

    Attributes:
        smallest: Length of the smallest cell when it was last looked at [m].
    """

    def __init__(
        self, bodies: Sequence[Body], springs: Sequence[ContactSprings], mass: float
    ) -> None:
        """Compute the frequencies of the cells."""
        self._cells, self._damping = Cells(bodies), Damping.of(bodies)
        self._springs, self._mass = springs, mass
        self.smallest = 0.0
        # Since the state was set: energy then, work since, and its turnover [J].
        self._energy = self._worked = self._turnover = 0.0

    def exchange(self, archive: Archive) -> None:
        """Exchange the energies and the smallest cell."""
        totals = np.array([self._energy, self._worked, self._turnover, self.smallest])
        totals = archive.same("watch", totals)
        self._energy, self._worked, self._turnover, self.smallest = (float(t) for t in totals)

    def longest_step(self, x: Floats) -> float:
        """Estimate of the largest stable step [s].

        Args:
            x: Positions of the local nodes, shape ``(l, 3)`` [m].
        """
        return largest_step(self._squared_frequency(x), self._damping)

    def room(self, x: Floats) -> tuple[float, float]:
        """Longest step and default [s], with room for springs that are open."""
        estimate = self.longest_step(x)
        part = _WITH_SPRINGS if any(springs.is_open for springs in self._springs) else 1.0
        return part * estimate, _DEFAULT * estimate

    def settle(self, x: Floats, dt: float) -> float:
        """Choose springs that are open, as stiff as a step allows.

        Args:
            x: As of `longest_step`.
            dt: The step [s].

        Returns:
            The longest step with them [s].
        """
        squared = (self._damping.highest(dt) - self._squared_frequency(x)) / 2
        for springs in self._springs:
            springs.settle(squared)
        return self.longest_step(x)

    def start(self, energy: float) -> None:
        """Count energy from now on. Local.

        Args:
            energy: Of the state that was set [J].
        """
        self._energy, self._worked, self._turnover = energy, 0.0, 0.0

    def count(self, driven: Sequence[float], lost: float) -> None:
        """Count the work of a step. Local.

        Args:
            driven: Work of loads and of supports [J].
            lost: Of damping and friction [J].
        """
        self._worked += sum(driven) + lost
        self._turnover += sum(map(abs, driven))

    def growth(self, energy: float, dt: float) -> str:
        """What is wrong with an energy; empty if nothing is. Local.

        Args:
            energy: Present energy [J].
            dt: The step [s].
        """
        grown = energy - self._energy - self._worked
        # Round-off of a body at rest is no growth.
        whole = self._mass * (self.smallest / dt) ** 2
        if grown <= _GROWTH * (self._energy + self._turnover) + _ROUNDING * whole:
            return ""
        return f"the energy has grown by {grown:.3g} J"

    def _squared_frequency(self, x: Floats) -> float:
        """Highest squared frequency at positions [1/s^2]."""
        contact = max((springs.squared_frequency for springs in self._springs), default=0.0)
        bulk, self.smallest = self._cells.limits(x)
        return bulk + contact
