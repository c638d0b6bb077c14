"""Detection of runs whose steps shrink without progress: limit points, jumps and stagnation."""

from collections.abc import Sequence

from dolfinx_nts.solvers.newton_report import NewtonReport

__all__ = ["IneffectiveCuts", "LimitPoint", "ShortSteps"]

# Growth of the displacement rate per cut [-] above which a cut indicates a limit point. Near a
# limit point displacements vary as sqrt(s) with the remaining time s, and a cut at least halves s.
# Rates therefore grow by about sqrt(2), or less if other loads contribute to them.
_GROWTH = 1.2
# Numbers of such cuts [-], and of steps with such cuts [-], at which a limit point is diagnosed.
# Steps are then shorter than 1/32 of the usual length. One step is not enough: rates may grow
# because surfaces meet.
_LIMIT_CUTS, _STEPS = 5, 2

# Consecutive cuts without effect [-] after which a step is infeasible: 1/32 of the usual length.
_INEFFECTIVE_CUTS = 5
# Ratio of the first residuals after and before a cut [-] above which the cut has no effect. In
# statics continuous loads halve the residual.
_LEFT = 0.9
# Relative difference of the least residuals [-] below which two failures have the same reason; and
# fraction of the first residual [-] below which an equilibrium was found, but rejected.
_SAME, _BALANCED = 0.1, 1e-6
# Number of last iterations [-] over which the least residual is taken, as states may alternate.
_LAST = 6

# Number of halvings [-] of a short step, and number of consecutive short steps [-] that is
# reported: together they cover less than two usual steps. An impact needs fewer.
_SHORT, _MANY = 4, 30


class LimitPoint:
    """Detects in statics that steps approach a limit load. Local.

    Near a limit point displacement rates grow, and no step across it succeeds, however short. A
    step that is only too long succeeds after cuts, without growth of the rates.
    """

    def __init__(self) -> None:
        self._rate, self._cuts, self._steps = 0.0, 0, 0

    def accept(self, rate: float, rejected: int) -> None:
        """Register an accepted step.

        Args:
            rate: Largest displacement increment of a node over the length of the step [m/s].
            rejected: Number of longer steps that failed before.
        """
        closer = rejected > 0 and rate > _GROWTH**rejected * self._rate > 0
        self._rate = rate
        self._cuts = self._cuts + rejected if closer else 0
        self._steps = self._steps + 1 if closer else 0

    @property
    def is_near(self) -> bool:
        """Whether a limit point explains a failure of the next step."""
        return self._cuts >= _LIMIT_CUTS and self._steps >= _STEPS

    @staticmethod
    def message(start: float, end: float, has_loads: bool) -> str:
        """Explanation and remedy for the user.

        Args:
            start: Time of the last equilibrium [s].
            end: Time at the end of the failed step [s].
            has_loads: Whether loads act; if not, prescribed displacements alone drive the bodies.
        """
        found = (
            f"statics found no equilibrium beyond a time between t = {start:.6g} and {end:.6g}, "
        )
        if has_loads:
            found += (
                "a limit load as in buckling, snapping or bursting: the closer to it, the faster "
                "bodies deform, and no step across it succeeds; EnergyMomentum follows what "
                "happens then, given displacements instead of loads may pass it, and "
            )
        else:
            found += (
                "though no loads act: prescribed displacements let bodies snap, or surfaces in "
                "contact slip over edges of facets to another state, faster and faster, and no "
                "step across it succeeds; EnergyMomentum follows what happens then, finer facets "
                "or friction may avoid it, and "
            )
        return found + "StepControl(smallest=) allows shorter steps"


class IneffectiveCuts:
    """Detects that a step fails for the same reason at any length. Local.

    If loads and prescribed displacements vary continuously, the residual at the start of a step
    decreases with its length. After a jump it does not, and Newton's method stops at the same
    residual. With inertia the residual of a jump grows as the inverse square of the length, faster
    than any impact. If prescribed displacements alone move nodes into a surface, a step also fails
    at any length.

    Args:
        inertia: Whether the bodies have inertia.
    """

    def __init__(self, *, inertia: bool) -> None:
        self._power = 2 if inertia else 0
        self.accept()

    def accept(self) -> None:
        """Register an accepted step."""
        self._last: list[tuple[float, float]] = []
        self._number, self._is_prescribed = 0, False

    def fail(self, reports: Sequence[NewtonReport], dt: float, cuts: int) -> None:
        """Register a failed step.

        Args:
            reports: Report of Newton's method from each starting guess.
            dt: Length of the step [s].
            cuts: Number of halvings of the usual length.
        """
        norms = [each.residual_norms for each in reports]
        found = [(each[0] * dt**self._power, self._least_norm(each)) for each in norms]
        is_same = len(found) == len(self._last) > 0 and all(map(self._is_same, self._last, found))
        self._last, self._number = found, self._number + 1 if is_same else 0
        self._is_prescribed = cuts >= _INEFFECTIVE_CUTS and any(e.is_hopeless for e in reports)

    @property
    def are_certain(self) -> bool:
        """Whether shorter steps would fail as the last one did."""
        return self._is_prescribed or self._number >= _INEFFECTIVE_CUTS

    def message(self) -> str:
        """Explanation and remedy for the user."""
        if self._is_prescribed:
            why = "prescribed displacements move nodes into a surface at any length"
        else:
            why = (
                f"the residual at its start has not decreased in {self._number} halvings, as where "
                "loads or prescribed displacements jump; let them grow with time instead"
            )
        remedy = "StepControl(smallest=) allows shorter steps"
        return f"the step fails however short it is: {why}; {remedy}"

    def _is_same(self, last: tuple[float, float], now: tuple[float, float]) -> bool:
        """Whether an attempt failed in the same way as before the cut.

        Each argument has the first and the least residual norm of an attempt [N].
        """
        is_left = now[0] >= _LEFT * last[0] > 0
        return is_left and (self._power > 0 or abs(now[1] - last[1]) <= _SAME * last[1])

    @staticmethod
    def _least_norm(norms: Sequence[float]) -> float:
        """Least of the last residual norms [N]; 0 if an equilibrium was found."""
        least = min(norms[-_LAST:])
        return least if least > _BALANCED * norms[0] else 0.0


class ShortSteps:
    """Detects stagnation of the step size, and stores the reason why longer steps fail. Local."""

    def __init__(self) -> None:
        self._reason, self._number = "", 0

    def fail(self, reason: str) -> None:
        """Store the reason of a failed step."""
        self._reason = reason

    def accept(self, cuts: int) -> str:
        """Register an accepted step with the number of its halvings.

        Returns:
            Warning for the user, or "".
        """
        self._number = self._number + 1 if cuts >= _SHORT else 0
        if self._number != _MANY:
            return ""
        return (
            f"the last {_MANY} steps had to be at least {2**_SHORT} times shorter than dt; the "
            f"last longer one failed: {self._reason}"
        )
