"""Report of Newton's method on one attempt at a step, and the error if all attempts fail."""

from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["ConvergenceError", "NewtonReport"]


@dataclass(frozen=True)
class NewtonReport:
    """Iterations and outcome of one attempt at a step.

    Attributes:
        iterations: Linear solves.
        active_set_changes: Number of pairs that changed their state, summed over iterations.
        residual_norms: Euclidean norm of the residual before each linear solve, and the last one
            [N].
        num_active: Active pairs at the end.
        reason: Reason why the iteration stopped, empty if it converged.
        start: Starting guess in words, empty if unknown.
        is_hopeless: Whether the iteration would fail from any starting guess.
        is_undecided: Whether states of contact or friction still changed when the iteration failed.
    """

    iterations: int
    active_set_changes: int
    residual_norms: tuple[float, ...]
    num_active: int
    reason: str
    start: str = ""
    is_hopeless: bool = False
    is_undecided: bool = False

    @property
    def converged(self) -> bool:
        """Whether the iteration found a solution."""
        return not self.reason

    def __str__(self) -> str:
        norms = ", ".join(f"{norm:.2e}" for norm in self.residual_norms[-6:])
        return f"{self.reason} (iteration {self.iterations}, |R| ... {norms} N)"


class ConvergenceError(RuntimeError):
    """Error of a step that could not be solved. The last accepted state is unchanged.

    The text states the cause and a remedy, and then lists the attempts, one a line.

    Attributes:
        cause: Reason why the step failed.
        reports: One report for each attempt.

    Example:
        >>> stepper.set_velocity(other, (0.0, 0.0, -100.0))  # too fast for steps of 0.01 s
        >>> try:
        ...     step = stepper.advance()
        ... except nts.ConvergenceError as error:
        ...     print(len(error.reports), stepper.t)
        3 0.0
    """

    def __init__(self, message: str, reports: Sequence[NewtonReport] = (), cause: str = "") -> None:
        super().__init__(message)
        self.reports, self.cause = tuple(reports), cause or message

    def __str__(self) -> str:
        attempts = (f"\n  from {each.start}: {each}" for each in self.reports if each.start)
        return "".join([*self.args, *attempts])
