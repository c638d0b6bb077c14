"""Assembly of sums of linear forms into nodal vectors."""

from collections.abc import Iterable, Sequence

import numpy as np
import ufl
from dolfinx import fem, la

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.linear_forms import CellForm, Kernels, PackedForm

__all__ = ["NodalSum"]


class NodalSum:
    """Sum of linear forms at the owned nodes: one form of the bodies, and one of each load.

    Args:
        forms: The form of the bodies, then the forms of the loads, with derivatives applied by
            `ufl.algorithms.expand_derivatives`.
        V: Space of the test function.
        kernels: Kernels of the form of the bodies, see `CellForm`.

    Attributes:
        num_assembled: Number of assembled sums so far.
    """

    def __init__(
        self,
        forms: Sequence[ufl.Form],
        V: fem.FunctionSpace,
        kernels: Kernels = "double",
    ) -> None:
        first, *loads = forms
        self._bodies = CellForm(first, kernels)
        # The derivative of a dead load is empty.
        self._loads = [None if load.empty() else PackedForm(load) for load in loads]
        index_map, dim = V.dofmap.index_map, dimension(V)
        self._vector = la.vector(index_map, dim)
        self._values: Floats = self._vector.array
        self._num_owned = dim * index_map.size_local
        self.num_assembled = 0

    def leave_out(self, cells: Ints) -> None:
        """Leave out cells of the bodies until the next call. Local.

        Args:
            cells: Owned cells, local indices.
        """
        self._bodies.leave_out(cells)

    def assembled(self) -> Floats:
        """Sum of all forms, a copy. Collective."""
        self.num_assembled += 1
        return self._sum([self._bodies, *self._loads])

    def assembled_bodies(self) -> Floats:
        """Form of the bodies alone, assembled, a copy. Collective."""
        self.num_assembled += 1
        return self._sum([self._bodies])

    def assembled_loads(self) -> Floats:
        """Sum of the forms of the loads, a copy. Collective."""
        return self._sum(self._loads)

    def assembled_each_load(self) -> list[Floats]:
        """Form of each load, assembled, copies. Collective."""
        return [self._sum([load]) for load in self._loads]

    def sample(self, most: int) -> Floats:
        """Form of the bodies on some cells of this rank, without exchange of ghosts. Local.

        Args:
            most: Largest number of cells of each material.
        """
        values = np.zeros_like(self._values)
        self._bodies.assemble(values, most)
        return values

    def _sum(self, forms: Iterable[CellForm | PackedForm | None]) -> Floats:
        self._values.fill(0.0)
        for form in forms:
            if form is not None:
                form.assemble(self._values)
        self._vector.scatter_reverse(la.InsertMode.add)
        owned: Floats = self._values[: self._num_owned].copy()
        return owned
