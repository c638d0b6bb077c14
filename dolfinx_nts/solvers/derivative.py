"""Directional derivative of a residual, in double and in single precision."""

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.linear_forms import Kernels
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.nodal_sum import NodalSum

__all__ = ["Derivative"]

# Kernels in double precision: "slow" ones, which compile fast, until "double" ones are available.
_EXACT: tuple[Kernels, ...] = ("double", "slow")
# Number of cells of each material in the measurement of rounding errors.
_SAMPLE = 512


class Derivative:
    """Derivative of linear forms with respect to u in a direction, created at the first use.

    Args:
        forms: Form of the bodies, then the forms of the loads.
        u: Displacement, a coefficient of the forms.
        jumps: Whether the derivative is discontinuous, as at the onset of plastic flow. Single
            precision cannot resolve on which side of a jump a point is.

    Attributes:
        rounded: Name of the kernels for most Krylov iterations: single precision where possible.
    """

    def __init__(self, forms: Sequence[ufl.Form], u: fem.Function, *, jumps: bool = False) -> None:
        self.rounded: Kernels = "double" if jumps else "single"
        self._direction = fem.Function(u.function_space)
        # Each access to the array of a DOLFINx Function takes 2 us.
        self._values: Floats = self._direction.x.array
        self._forms, self._u, V = forms, u, u.function_space
        nodes = V.dofmap.index_map
        self._comm, self._num_owned = nodes.comm, dimension(V) * nodes.size_local
        self._sums: dict[Kernels, NodalSum] = {}
        self._left_out: Ints = np.empty(0, dtype=np.int32)

    @property
    def num_assembled(self) -> int:
        """Derivatives assembled so far. Local."""
        return sum(form.num_assembled for form in self._sums.values())

    def leave_out(self, cells: Ints) -> None:
        """Leave out cells until the next call. Local.

        Args:
            cells: Owned cells, local indices.
        """
        self._left_out = cells
        for form in self._sums.values():
            form.leave_out(cells)

    def set_direction(self, x: Floats, zero: Flags | None = None) -> Floats:
        """Set the direction. Collective.

        Args:
            x: Direction at the owned nodes, shape ``(n, d)`` [m].
            zero: Flags of the owned dofs where the direction is set to zero, shape ``(d n,)``;
                None for no dof.

        Returns:
            View of the direction at the owned dofs, shape ``(d n,)`` [m].
        """
        owned = self._values[: self._num_owned]
        owned[:] = x.ravel()
        if zero is not None:
            owned[zero] = 0
        self._direction.x.scatter_forward()
        return owned

    def with_kernels(self, kernels: Kernels) -> NodalSum:
        """Forms of the derivative with kernels in double or single precision. Collective."""
        if kernels not in self._sums:
            # Compiled on demand: a body in free flight needs no kernels, and without contact double
            # precision is not needed.
            V = self._u.function_space
            self._sums[kernels] = NodalSum(self._derivatives, V, kernels)
            self._sums[kernels].leave_out(self._left_out)
        return self._sums[kernels]

    @cached_property
    def _derivatives(self) -> list[ufl.Form]:
        u, direction = self._u, self._direction
        return [expand_derivatives(ufl.derivative(form, u, direction)) for form in self._forms]

    def rounding(self) -> float:
        """Relative error of the derivative in single precision, on a sample of cells. Collective.

        It depends on the material and on the ratio of displacements to cell sizes.
        """
        judges = next((kernels for kernels in _EXACT if kernels in self._sums), _EXACT[-1])
        rounded, exact = (
            self.with_kernels(kernels).sample(_SAMPLE) for kernels in (self.rounded, judges)
        )
        error = rounded - exact
        squares = [float(error @ error), float(exact @ exact)]
        part, whole = reductions.total(self._comm, squares)
        return math.sqrt(part / whole) if whole > 0 else math.inf
