"""Strains of a step, for materials with internal variables."""

from typing import Any

import ufl
from dolfinx import fem

from dolfinx_nts.fem.components import deformation_gradient
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.materials.hyperelastic import right_cauchy_green

__all__ = ["StepStrains", "symmetric_entries", "symmetric_tensor"]

# Entries of a symmetric tensor, in the order in which they are stored.
_ENTRIES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


class StepStrains:
    """Deformation at both ends of a step. Local.

    Args:
        u_n: Displacement at the start of a step [m].
        u: Displacement at its end [m].
        dt: Length of the step, a constant [s].
        scheme: Scheme, which defines the stress of a step.

    Attributes:
        dt, scheme: The arguments.
        theta: Weight of the end of the step in the stress of the scheme [-].
        F_n, F: Deformation gradients at both ends, UFL (3, 3).
        C_n, C: Right Cauchy-Green tensors, UFL (3, 3).
    """

    def __init__(
        self, u_n: fem.Function, u: fem.Function, dt: fem.Constant, scheme: Scheme
    ) -> None:
        self.dt, self.scheme, self.theta = dt, scheme, scheme.stress_share
        self.F_n, self.F = map(deformation_gradient, (u_n, u))
        self.C_n, self.C = map(right_cauchy_green, (self.F_n, self.F))

    def mean(self, start: Any, end: Any) -> Any:
        """Interpolate values at both ends of the step to the time of the stress."""
        return (1 - self.theta) * start + self.theta * end


def symmetric_entries(tensor: Any) -> list[Any]:
    """Six entries of a symmetric tensor in storage order, UFL. Local."""
    return [tensor[entry] for entry in _ENTRIES]


def symmetric_tensor(entries: Any, first: int = 0) -> Any:
    """Symmetric tensor, UFL (3, 3), from six entries starting at index ``first``. Local."""
    number = {entry: first + i for i, entry in enumerate(_ENTRIES)}
    rows = [[entries[number[min(i, j), max(i, j)]] for j in range(3)] for i in range(3)]
    return ufl.as_matrix(rows)
