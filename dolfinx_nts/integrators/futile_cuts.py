"""Steps that fail in the same way however short they are, found from what their cuts change."""

from collections.abc import Sequence

from dolfinx_nts.solvers.newton_report import NewtonReport

__all__ = ["FutileCuts"]

# Cuts after each other from which on it is certain that they change nothing: steps have 1/32 of
# their length then.
_CERTAIN = 5
# Part of what was out of balance at the start of a step [-] that is left after a cut which changes
# nothing: without inertia what a step adds halves with it.
_LEFT = 0.9
# Difference of the least residuals at which Newton's method is stuck [-] that is none; and part of
# the first residual [-] below which there is balance, but of a state that is not accepted.
_SAME, _BALANCED = 0.1, 1e-6
# Last iterations among which the least residual counts [-], as states may alternate.
_LAST = 6


class FutileCuts:
    """Watches whether cuts of a step change what makes it fail. Local.

    Loads and displacements that grow with time leave less and less out of balance at the start of
    a step, the shorter it is. What jumps does not: Newton's method then has the same task, and gets
    stuck at the same residual. With inertia the forces of a jump are those of an acceleration and
    grow as the inverse square of the length, faster than those of any impact. Nor does the length
    matter to nodes that given displacements alone move into a surface: shorter steps only end
    closer to it.

    Args:
        inertia: Whether there is any.
    """

    def __init__(self, *, inertia: bool) -> None:
        self._power = 2 if inertia else 0
        self.accept()

    def accept(self) -> None:
        """Take a step that succeeded."""
        self._last: list[tuple[float, float]] = []
        self._number, self._is_given = 0, False

    def fail(self, reports: Sequence[NewtonReport], dt: float, cuts: int) -> None:
        """Take a step that failed.

        Args:
            reports: What Newton's method did from each start.
            dt: Length of the step [s].
            cuts: Number of halvings of the usual length in it.
        """
        norms = [each.residual_norms for each in reports]
        found = [(each[0] * dt**self._power, self._stuck(each)) for each in norms]
        is_same = len(found) == len(self._last) > 0 and all(map(self._is_same, self._last, found))
        self._last, self._number = found, self._number + 1 if is_same else 0
        self._is_given = cuts >= _CERTAIN and any(each.is_hopeless for each in reports)

    @property
    def are_certain(self) -> bool:
        """Whether shorter steps would fail as the last one did."""
        return self._is_given or self._number >= _CERTAIN

    def told(self) -> str:
        """Say that it is so, and what would help."""
        if self._is_given:
            why = "shorter ones only end closer to what given displacements move nodes into"
        else:
            why = (
                f"{self._number} halvings have not made what is out of balance at its start any "
                "less, as where loads or given displacements jump, which may grow with time instead"
            )
        return f"the step fails however short it is: {why}; StepControl(smallest=) goes on to them"

    def _is_same(self, last: tuple[float, float], now: tuple[float, float]) -> bool:
        """Whether a cut has left an attempt as it was."""
        is_left = now[0] >= _LEFT * last[0] > 0
        return is_left and (self._power > 0 or abs(now[1] - last[1]) <= _SAME * last[1])

    @staticmethod
    def _stuck(norms: Sequence[float]) -> float:
        """Least of the last residuals [N], 0 if they are those of an equilibrium."""
        least = min(norms[-_LAST:])
        return least if least > _BALANCED * norms[0] else 0.0
