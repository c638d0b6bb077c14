"""Counts of the work of a stepper."""

from dataclasses import dataclass

from dolfinx_nts.solvers.linear.statistics import SolverStatistics

__all__ = ["StepperStatistics"]


@dataclass(frozen=True)
class StepperStatistics:
    """Counts of the work of a stepper so far. Local.

    ``str(statistics)`` has a line for each pair and one for the linear solver.

    Attributes:
        pairs: Laws of each pair, and the stiffness of its springs.
        num_searches: Number of global searches of each pair.
        num_forces: Number of evaluations of the internal forces of the bodies.
        solver: Work of the linear solver; None for a stepper without one.

    Example:
        >>> step = stepper.advance()
        >>> stepper.statistics.num_searches, stepper.statistics.num_forces
        ((1,), 2)
    """

    pairs: tuple[str, ...]
    num_searches: tuple[int, ...]
    num_forces: int
    solver: SolverStatistics | None = None

    def __str__(self) -> str:
        """Laws of the pairs and work of the linear solver, line by line."""
        lines = [f"pair {number}: {pair}" for number, pair in enumerate(self.pairs, start=1)]
        if self.solver is not None:
            lines.append(f"linear solver: {self.solver}")
        return "\n".join(lines)
