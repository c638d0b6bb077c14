"""Derivative of a residual in a direction, in double and in single precision."""

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

# Kernels by which others are judged: those that are soon compiled, until there are quicker ones.
_EXACT: tuple[Kernels, ...] = ("double", "slow")
# Cells of each material on which they are compared.
_SAMPLE = 512


class Derivative:
    """Derivative of linear forms by u in a direction, which is taken when it is first asked for.

    Args:
        forms: Forms, that of the bodies first, then those of loads.
        u: Displacement, a coefficient of the forms.
        jumps: Whether it jumps, as where points begin to flow. Half of the digits do not tell on
            which side of a jump a point is.

    Attributes:
        rounded: Kernels with the fewest digits that are enough in most Krylov iterations.
    """

    def __init__(self, forms: Sequence[ufl.Form], u: fem.Function, *, jumps: bool = False) -> None:
        """Take the forms."""
        self.rounded: Kernels = "double" if jumps else "single"
        self._direction = fem.Function(u.function_space)
        # DOLFINx takes 2 us each time that it is asked for the array.
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
        """Leave out cells from now on, until the next call. Local.

        Args:
            cells: Owned cells, local indices.
        """
        self._left_out = cells
        for form in self._sums.values():
            form.leave_out(cells)

    def set_direction(self, x: Floats, given: Flags | None = None) -> Floats:
        """Set the direction. Collective.

        Args:
            x: Direction at the owned nodes, shape ``(n, d)`` [m].
            given: Owned dofs where it is 0 instead, shape ``(d n,)``; None: nowhere.

        Returns:
            The direction at the owned dofs, shape ``(d n,)`` [m], a view.
        """
        owned = self._values[: self._num_owned]
        owned[:] = x.ravel()
        if given is not None:
            owned[given] = 0
        self._direction.x.scatter_forward()
        return owned

    def with_kernels(self, kernels: Kernels) -> NodalSum:
        """Forms of the derivative with some kernels. Collective."""
        if kernels not in self._sums:
            # Bodies that fly need none, and without contact nobody needs double precision: all of
            # them take time to compile.
            V = self._u.function_space
            self._sums[kernels] = NodalSum(self._derivatives, V, kernels)
            self._sums[kernels].leave_out(self._left_out)
        return self._sums[kernels]

    @cached_property
    def _derivatives(self) -> list[ufl.Form]:
        """The derivative of each form."""
        u, direction = self._u, self._direction
        return [expand_derivatives(ufl.derivative(form, u, direction)) for form in self._forms]

    def rounding(self) -> float:
        """Error of the rounded derivative, relative, on a sample of cells. Collective.

        It depends on the law, and on displacements in sizes of cells.
        """
        judges = next((kernels for kernels in _EXACT if kernels in self._sums), _EXACT[-1])
        rounded, exact = (
            self.with_kernels(kernels).sample(_SAMPLE) for kernels in (self.rounded, judges)
        )
        error = rounded - exact
        squares = [float(error @ error), float(exact @ exact)]
        part, whole = reductions.total(self._comm, squares)
        return math.sqrt(part / whole) if whole > 0 else math.inf
