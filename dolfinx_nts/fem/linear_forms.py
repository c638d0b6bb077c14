"""Linear forms whose functions stay packed while they do not change.

Linear forms over cells, assembled with FFCx's kernels.
"""

from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import numpy as np
import ufl
from dolfinx import cpp, fem

from dolfinx_nts import _kernels, compat
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.jit import compile_form

__all__ = ["CellForm", "Coefficients", "PackedForm"]


class Coefficients:
    """Values of functions cell by cell, as the kernels of a form read them.

    Args:
        form: The form.
        functions: Those of its functions that are watched.

    Attributes:
        packed: All functions of the form, as DOLFINx wants them.
    """

    packed: dict[Any, Floats]

    def __init__(self, form: fem.Form, functions: Sequence[fem.Function]) -> None:
        """Pack at the first update."""
        self._form = form
        self._values: list[Floats] = [f.x.array for f in functions]
        self._before: list[Floats] | None = None

    def update(self) -> bool:
        """Pack if a watched function has changed; whether that was so. Local."""
        if self._before is not None and all(map(_same, self._values, self._before)):
            return False
        self._before = [values.copy() for values in self._values]
        self.packed = cpp.fem.pack_coefficients(self._form._cpp_object)
        return True


class PackedForm:
    """A linear form over whatever, compiled. Collective.

    Args:
        form: The form, not empty.
    """

    def __init__(self, form: ufl.Form) -> None:
        """Compile."""
        self._form = compile_form(form)
        self._coefficients = Coefficients(self._form, form.coefficients())

    def assemble(self, b: Floats) -> None:
        """Add the form on the cells and facets of this rank. Local.

        Args:
            b: Values at the local dofs, shape ``(3 l,)``.
        """
        self._coefficients.update()
        fem.assemble_vector(b, self._form, coeffs=self._coefficients.packed)


def _same(values: Floats, before: Floats) -> bool:
    """Whether all bits are the same."""
    return np.array_equal(values.view(np.int64), before.view(np.int64))


_NOTHING: Floats = np.empty((0, 0))


class CellForm:
    """A form of `bulk_form` with one argument, compiled. Collective.

    For `fem.assemble_vector` functions are packed cell by cell, and with many
    cells it waits for them: a quarter of its time with 380 000 unknowns. Here
    each cell gathers the values of its nodes when its turn comes. Only
    functions of other spaces than the argument's are packed, when one changed.

    Args:
        form: Linear form.
    """

    def __init__(self, form: ufl.Form) -> None:
        """Compile, and hand over what kernels read."""
        V: fem.FunctionSpace = form.arguments()[0].ufl_function_space()
        self._form = compile_form(form)
        self._num_cells = len(V.dofmap.list)
        compiled = self._form.ufcx_form
        positions = compiled.original_coefficient_positions
        functions = [form.coefficients()[positions[i]] for i in range(compiled.num_coefficients)]
        widths = [f.function_space.element.space_dimension for f in functions]
        *first, width = accumulate(widths, initial=0)
        places = dict(zip(functions, first, strict=True))
        ours = [f for f in functions if f.function_space == V]
        others = [f for f in functions if f.function_space != V]
        self._others = Coefficients(self._form, others) if others else None
        regions = dict(form.integrals()[0].subdomain_data())
        begin, end = compiled.form_integral_offsets[0:2]  # those over cells
        self._regions: list[Ints] = [regions[i] for i in compiled.form_integral_ids[begin:end]]
        self._cells = self._regions
        self._integrals = [
            _kernels.CellIntegral(
                *compat.kernel(integral),
                V.mesh.geometry.x,
                compat.geometry_nodes(V.mesh),
                V.dofmap.list,
                [f.x.array for f in ours],
                [places[f] for f in ours],
                width,
            )
            for integral in compiled.form_integrals[begin:end]
        ]
        self._packed: list[Floats] = [_NOTHING] * len(self._integrals)

    def leave_out(self, cells: Ints) -> None:
        """Leave out cells until the next call. Local.

        Args:
            cells: Owned cells.
        """
        self._cells = [np.setdiff1d(region, cells) for region in self._regions]

    def assemble(self, b: Floats) -> None:
        """Add the form on the cells of this rank. Local.

        Args:
            b: Values at the local dofs, shape ``(3 l,)``.
        """
        if self._others is not None and self._others.update():
            by_key = self._others.packed
            # In the order of their numbers, whether these or indices are in the keys.
            rows = [by_key[key] for key in sorted(by_key, key=lambda key: key[1])]
            self._packed = list(map(self._by_cell, self._regions, rows))
        constants = cpp.fem.pack_constants(self._form._cpp_object)
        parts = zip(self._integrals, self._cells, self._packed, strict=True)
        for integral, cells, packed in parts:
            integral.add(cells, packed, constants, b)

    def _by_cell(self, cells: Ints, rows: Floats) -> Floats:
        """Rows of some cells among those of all local cells."""
        packed = np.zeros((self._num_cells, rows.shape[1]))
        packed[cells] = rows
        return packed
