"""Work of a stepper in numbers."""

from dataclasses import dataclass

from dolfinx_nts.solvers.statistics import SolverStatistics

__all__ = ["StepperStatistics"]


@dataclass(frozen=True)
class StepperStatistics:
    """What a stepper has done so far. Local.

    ``str`` has a line for each pair and one for the linear solver.

    Attributes:
        pairs: Laws of each pair, and the stiffness of its springs.
        num_searches: Global searches of each pair.
        num_forces: Evaluations of the internal forces of the bodies.
        solver: Work of the linear solver; None without one.
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
