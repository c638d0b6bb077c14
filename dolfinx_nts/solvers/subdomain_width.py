"""Width of the contact subdomain, chosen by a trial."""

from dataclasses import astuple, dataclass

import numpy as np

from dolfinx_nts.common.archive import Archive

__all__ = ["SubdomainWidth"]

# Cost of factors of a narrow and of a wide subdomain with all nodes, in Krylov iterations. The wide
# one has fill.
_FACTORS, _WIDE_FACTORS = 14.0, 26.0
# Decades of reduction over which costs are measured: about one step, and two steps in the trial,
# which includes the first factorisation.
_DECADES, _TRIAL_DECADES = 12.0, 24.0
# Iterations per decade above which the wide subdomain is tried, and largest cost ratio for which it
# is kept.
_POOR, _PAYS = 2.0, 0.9
# Lower bound on the decades of a solve, since every solve takes at least one iteration.
_FEWEST_DECADES = 0.3


@dataclass
class SubdomainWidth:
    """Chooses a narrow or a wide subdomain by the cost of iterations and factors. Local.

    The narrow one comes first. If it takes many iterations, as in the bending of thin walls, the
    wide one is tried once, and kept if it is cheaper. It does not help if factors of the bodies are
    inaccurate.

    Attributes:
        is_wide: Whether the subdomain is wide.
        iterations: Krylov iterations since the last choice.
        factors: Cost of factors since then, in such iterations.
        decades: Decades of reduction since then.
        narrow: Cost per decade of the narrow subdomain, NaN before the trial.
        is_final: Whether the trial is over.
    """

    is_wide: bool = False
    iterations: float = 0.0
    factors: float = 0.0
    decades: float = 0.0
    narrow: float = np.nan
    is_final: bool = False

    def count_factors(self, part: float) -> None:
        """Add the cost of factors of a subdomain with a fraction of all nodes [-]."""
        self.factors += part * (_WIDE_FACTORS if self.is_wide else _FACTORS)

    def count(self, iterations: int, decades: float) -> bool:
        """Add the iterations of a solve with contact; return whether the width changes."""
        self.iterations += iterations
        self.decades += max(decades, _FEWEST_DECADES)
        if self.is_final or self.decades < (_TRIAL_DECADES if self.is_wide else _DECADES):
            return False
        was_wide, is_poor = self.is_wide, self.iterations > _POOR * self.decades
        cost = (self.iterations + self.factors) / self.decades
        self.iterations = self.factors = self.decades = 0.0
        if was_wide:
            self.is_wide, self.is_final = cost < _PAYS * self.narrow, True
        elif is_poor:
            self.is_wide, self.narrow = True, cost
        return self.is_wide != was_wide

    def serialize(self, archive: Archive) -> None:
        """Serialize the state that later solves depend on. Collective."""
        state = archive.same("width_of_subdomain", np.array(astuple(self), dtype=float))
        if archive.giving:
            is_wide, *costs, is_final = map(float, state)
            self.is_wide, self.is_final = bool(is_wide), bool(is_final)
            self.iterations, self.factors, self.decades, self.narrow = costs
