"""Work of a linear solver in numbers."""

from dataclasses import dataclass
from math import isfinite

__all__ = ["SolverStatistics"]


@dataclass(frozen=True)
class SolverStatistics:
    """Counts from the start of a run, and what the preconditioner is. Local.

    Attributes:
        preconditioner: Kind of the factors of the bulk, empty before the first.
        is_strong: Whether these are the stronger ones.
        wave_crossings: Cells that waves cross in a step [-], infinite without inertia.
        num_iterations: Krylov iterations.
        num_local_iterations: Those beside them that moved nodes around contacts alone.
        num_builds: Factorisations of the bulk.
        num_schwarz_builds: Factorisations around the contacts.
        num_direct: Factorisations of whole systems.
        num_residuals: Residuals of the bulk, without contact.
        num_actions: Actions of the tangent of the bulk.
        num_tangents: Matrices of this tangent.
        num_cells: Owned cells that residual and action now go over.

    ``str`` is a few lines for a summary.
    """

    preconditioner: str
    is_strong: bool
    wave_crossings: float
    num_iterations: int
    num_local_iterations: int
    num_builds: int
    num_schwarz_builds: int
    num_direct: int
    num_residuals: int
    num_actions: int
    num_tangents: int
    num_cells: int

    def __str__(self) -> str:
        """Choice of the preconditioner, and counts of work."""
        if self.num_builds == 0:
            if self.num_direct == 0:
                return "not used so far"
            return f"{self.num_direct} factorisations of whole systems"
        crossed = f"waves cross {self.wave_crossings:.3g} cells a step"
        return (
            f"GMRES with {self.preconditioner} of the bulk and a correction around the contacts\n"
            f"  {crossed if isfinite(self.wave_crossings) else 'statics without waves'}; "
            f"{self.num_iterations} iterations; factorisations: {self.num_builds} of the bulk, "
            f"{self.num_schwarz_builds} around the contacts, {self.num_direct} of whole systems"
        )
