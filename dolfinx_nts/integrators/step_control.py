"""Step lengths: equal steps, and steps that are halved after failures."""

import bisect
import math
from collections.abc import Sequence

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arguments import as_call, chosen_times, positive
from dolfinx_nts.common.declaration import Declaration

__all__ = ["ROUND_OFF", "EvenSteps", "StepControl", "StepLength"]

# Time relative to the length of a step [-] that counts as round-off: far above the round-off of any
# run, and far below any relevant fraction of a step.
ROUND_OFF = 1e-6
# Default smallest step relative to the usual one [-]: 20 halvings, so that a run that cannot
# proceed ends after about 20 attempts.
_SMALLEST = 2.0**-20
# Number of steps [-] of one length after which a longer one is tried. Larger values cost time in
# short steps, smaller ones in longer steps that fail.
_PATIENCE = 3


class StepControl(Declaration):
    """Step control: halves steps that fail, and doubles the length again after success. Local.

    A step is repeated with half its length when Newton's method fails, a cell is inverted or an
    explicit step is unstable. It is also repeated when a normal turns by more than 90 degrees, or
    contact holds a node at a gap above ``gap_tol``. A failed attempt does not change the state. The
    length doubles after three steps, up to the ``dt`` of the stepper. Steps end exactly at the
    given times. If five consecutive cuts have no effect, as after a jump of prescribed
    displacements, the run ends with an error.

    In statics, five cuts with growing displacement rates indicate a limit load, beyond which there
    is no equilibrium near the last one. Then, or at the smallest length, the step is repeated with
    its first length by pseudo-transient continuation, see `QuasiStatic`. If that fails too, the
    run ends with an error.

    Args:
        smallest: Smallest length of a step [s], also near a limit load. None for 2**-20 of the
            ``dt`` of the stepper; cuts then stop earlier at limit loads, or if they have no effect.
        gap_tol: Largest distance from the surface, on either side, at which a node may become or
            stay active in elastic impact [m]; None for no limit. Nodes that were farther away
            before are allowed.
        times: Times at which a step must end [s], for instance for output.

    Attributes:
        smallest, gap_tol: The arguments.
        times: The times, sorted.

    Raises:
        TypeError: ``smallest`` or ``gap_tol`` is not a number.
        ValueError: ``smallest`` or ``gap_tol`` is not positive, or a number is not finite.

    Example:
        >>> control = nts.StepControl(times=[0.005, 0.015])
        >>> [f"{step.t:g}" for step in stepper.run(0.02, control)]
        ['0.005', '0.015', '0.02']
    """

    def __init__(
        self,
        *,
        smallest: float | None = None,
        gap_tol: float | None = None,
        times: Sequence[float] = (),
    ) -> None:
        for name, value in (("smallest", smallest), ("gap_tol", gap_tol)):
            if value is not None:
                positive(name, value)
        self.times = chosen_times(times)
        self.smallest, self.gap_tol = smallest, gap_tol

    def __repr__(self) -> str:
        """Constructor call of an equal control. Local."""
        return as_call(self, smallest=self.smallest, gap_tol=self.gap_tol, times=self.times)

    def shortest(self, dt: float) -> float:
        """Smallest length of a step [s] for a usual length dt [s]."""
        return _SMALLEST * dt if self.smallest is None else self.smallest

    def next_step(self, t: float, dt: float, until: float) -> tuple[float, float]:
        """Length and end of the next step, both [s].

        The last two steps before a given time have equal lengths, so that no step is much shorter
        than the others.

        Args:
            t: Time at the start of the step [s].
            dt: Largest length of the step [s].
            until: Time at the end of the run [s].

        Returns:
            Length of the step, and time at its end [s].
        """
        next_time = bisect.bisect_right(self.times, t + ROUND_OFF * dt)
        target = min([until, *self.times[next_time : next_time + 1]])
        remaining = (target - t) / dt
        if remaining <= 1 + ROUND_OFF:
            return target - t, target
        dt *= remaining / 2 if remaining < 2 - ROUND_OFF else 1.0
        return dt, t + dt


class EvenSteps:
    """End times of equal steps, counted from the start of a run to avoid accumulated round-off.

    Local, except where a method says otherwise.

    Attributes:
        target: End of the current full step [s], also while it is taken in halves.
    """

    def __init__(self) -> None:
        self._t, self._step = 0.0, 0
        self.target = -math.inf

    def goes_on(self, t: float, dt: float) -> bool:
        """Whether the next step is the remainder of a halved step to the target.

        Args:
            t: Current time [s].
            dt: Length of all steps [s].
        """
        return ROUND_OFF * dt < self.target - t < (1 - ROUND_OFF) * dt

    def next(self, t: float, step: int, dt: float) -> float:
        """Continue the count of the last run, or start a new one if time or length differ.

        Args:
            t: Current time [s].
            step: Number of the last step.
            dt: Length of all steps [s].

        Returns:
            Time at the end of the next step [s], the target.
        """
        if t != self._t + (step - self._step) * dt:
            self._t, self._step = t, step
        self.target = self._t + (step + 1 - self._step) * dt
        return self.target

    def serialize(self, archive: Archive) -> None:
        """Serialize the time and step from which steps are counted, and the target. Collective."""
        self._t = archive.same("start_time", self._t)
        self._step = archive.same("start_step", self._step)
        self.target = archive.same("target", self.target)


class StepLength:
    """Length of controlled steps relative to the usual one: 1, 1/2, 1/4, and so on.

    Local, except where a method says otherwise.

    Attributes:
        cuts: Number of halvings.
    """

    def __init__(self) -> None:
        self.cuts = self._accepted = 0

    def cut(self) -> None:
        """Halve the length after a step that failed."""
        self.cuts, self._accepted = self.cuts + 1, 0

    def uncut(self, cuts: int) -> None:
        """Undo a number of cuts."""
        self.cuts, self._accepted = max(self.cuts - cuts, 0), 0

    def accept(self) -> None:
        """Register an accepted step, and double the length after three steps of the same length."""
        self._accepted += 1
        if self._accepted >= _PATIENCE and self.cuts:
            self.cuts, self._accepted = self.cuts - 1, 0

    def serialize(self, archive: Archive) -> None:
        """Serialize the numbers of halvings and of accepted steps. Collective."""
        self.cuts = archive.same("cuts", self.cuts)
        self._accepted = archive.same("accepted", self._accepted)
