"""Counts of the work of a linear solver."""

from dataclasses import dataclass
from math import isfinite

__all__ = ["SolverStatistics"]


@dataclass(frozen=True)
class SolverStatistics:
    """Counts since the start of a run, and the kind of preconditioner. Local.

    Attributes:
        preconditioner: Kind of the factors of the bulk, empty before the first factorisation.
        is_strong: Whether they are complete factors or multigrid.
        wave_crossings: Courant number [-], infinite in statics; 0 if a resumed run has computed no
            factors yet.
        num_iterations: Krylov iterations.
        num_local_iterations: Additional iterations of the nonlinear elimination around contacts.
        num_builds: Factorisations of the bulk.
        num_schwarz_builds: Factorisations of the contact subdomain.
        num_direct: Factorisations of complete systems.
        num_residuals: Residuals of the bulk, without contact.
        num_actions: Products with the tangent of the bulk.
        num_tangents: Assembled matrices of this tangent.
        num_cells: Owned cells of residual and products in the last step.

    ``str`` returns a few lines for a summary.
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
        if self.num_builds == 0:
            if self.num_direct == 0:
                return "not used so far"
            return f"factorisations: complete systems {self.num_direct}"
        number = f"Courant number {self.wave_crossings:.3g}; " if self.wave_crossings else ""
        if not isfinite(self.wave_crossings):
            number = "statics; "
        kinds = {
            "bulk": self.num_builds,
            "contact subdomain": self.num_schwarz_builds,
            "complete systems": self.num_direct,
        }
        counts = ", ".join(f"{kind} {count}" for kind, count in kinds.items() if count)
        return (
            f"GMRES with {self.preconditioner} of the bulk and a contact correction\n"
            f"  {number}{self.num_iterations} iterations; factorisations: {counts}"
        )
