"""Lengths of steps: equal ones, and ones that are cut where they fail."""

import bisect
import math
from collections.abc import Sequence

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arguments import positive

__all__ = ["EvenSteps", "Pace", "StepControl", "StepLength"]

# Part of a step that is round-off of its times.
_SLIVER = 1e-6
# Number of steps of one length after which a longer one is tried.
_PATIENCE = 3


class StepControl:
    """Cuts steps that fail and lets them grow again.

    A step is tried again with half its length when Newton's method fails, a cell is inverted, a
    normal turns by more than 90 degrees, an explicit step is not stable, or a gap is held that
    exceeds ``gap_tol``; a cut step leaves no trace. After some steps the length doubles again,
    up to the ``dt`` of the stepper. Steps end exactly at the given times.

    Args:
        smallest: Length below which a step fails for good [s]; None: 2**-20 of the ``dt`` of
            the stepper.
        gap_tol: Largest distance from the surface at which a node may be caught, or be inside,
            of contact by elastic impact [m]; None: any. A node that was further inside before
            stays what it is.
        times: Times at which a step must end, for output for instance [s].

    Raises:
        ValueError: A number is not positive or not finite.
    """

    def __init__(
        self,
        *,
        smallest: float | None = None,
        gap_tol: float | None = None,
        times: Sequence[float] = (),
    ) -> None:
        """Check the numbers."""
        for name, value in (("smallest", smallest), ("gap_tol", gap_tol)):
            if value is not None:
                positive(name, value)
        self.times = tuple(sorted(float(t) for t in times))
        if not all(map(math.isfinite, self.times)):
            raise ValueError(f"expected finite times, given {self.times}")
        self.smallest, self.gap_tol = smallest, gap_tol

    def next_step(self, t: float, dt: float, until: float) -> tuple[float, float]:
        """Length [s] of the next step, and its end [s]. Local.

        The last two steps before a given time are of equal length, so that none is much shorter
        than the others.

        Args:
            t: Time at its start [s].
            dt: Length that it may have [s].
            until: Time at the end of the run [s].
        """
        next_time = bisect.bisect_right(self.times, t + _SLIVER * dt)
        target = min([until, *self.times[next_time : next_time + 1]])
        remaining = (target - t) / dt
        if remaining <= 1 + _SLIVER:
            return target - t, target
        dt *= remaining / 2 if remaining < 2 - _SLIVER else 1.0
        return dt, t + dt


class EvenSteps:
    """Times at the ends of equal steps, counted from the start of a run. Local.

    So that they do not gather round-off.
    """

    def __init__(self) -> None:
        """Count from step 0 at the time 0."""
        self._t, self._step = 0.0, 0

    def end(self, step: int, dt: float) -> float:
        """Time at the end of a step [s].

        Args:
            step: Number of the step.
            dt: Length of all steps [s].
        """
        return self._t + (step - self._step) * dt

    def go_on(self, t: float, step: int, dt: float) -> None:
        """Count on, with the same round-off, or from now on if this is a new run.

        Args:
            t: Time now [s].
            step: Number of the last step.
            dt: Length of all steps [s].
        """
        if t != self.end(step, dt):
            self._t, self._step = t, step

    def serialize(self, archive: Archive) -> None:
        """Serialize where steps are counted from. Collective.

        Args:
            archive: Takes it or gives it.
        """
        self._t = archive.same("start_time", self._t)
        self._step = archive.same("start_step", self._step)


class StepLength:
    """Length of the steps, as a part of the usual one: 1, 1/2, 1/4, ...

    Attributes:
        cuts: Number of halvings.
        accepted: Steps of this length or of what was left before a time.
    """

    def __init__(self) -> None:
        """Begin with the usual length."""
        self.cuts = self.accepted = 0

    def cut(self) -> None:
        """Halve it."""
        self.cuts, self.accepted = self.cuts + 1, 0

    def accept(self) -> None:
        """Count a step; double the length after some."""
        self.accepted += 1
        if self.accepted >= _PATIENCE and self.cuts:
            self.cuts, self.accepted = self.cuts - 1, 0

    def serialize(self, archive: Archive) -> None:
        """Serialize both numbers. Collective.

        Args:
            archive: Takes them or gives them.
        """
        self.cuts = archive.same("cuts", self.cuts)
        self.accepted = archive.same("accepted", self.accepted)


class Pace:
    """How steps follow each other in a run, in equal steps or controlled ones.

    Attributes:
        even: Times at the ends of equal steps.
        length: Length of a step as a part of the usual one.
    """

    def __init__(self) -> None:
        """Begin at the time 0 with steps of the usual length."""
        self.even, self.length = EvenSteps(), StepLength()

    def serialize(self, archive: Archive) -> None:
        """Serialize both. Collective.

        Args:
            archive: Takes them or gives them.
        """
        self.even.serialize(archive)
        self.length.serialize(archive)
