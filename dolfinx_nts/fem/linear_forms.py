"""Linear forms that are assembled repeatedly, in every Newton iteration or step.

`PackedForm` supports any form and leaves the assembly to DOLFINx, but packs functions only when
they have changed. `CellForm` supports forms over cells and calls the kernels itself, which avoids
packing most functions.
"""

from collections.abc import Sequence
from functools import cached_property, partial
from itertools import accumulate
from typing import Any, Literal

import numpy as np
import ufl
from dolfinx import cpp, fem

from dolfinx_nts import _kernels, compat
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.batched_kernels import batched_kernels, begin_batched_kernels
from dolfinx_nts.fem.cell_constant import changing
from dolfinx_nts.fem.jit import compile_form, compile_quickly

__all__ = ["CellForm", "Kernels", "PackedForm"]

_NO_PLACES: Ints = np.empty(0, dtype=np.int32)

Kernels = Literal["double", "single", "slow"]


class _Coefficients:
    """Values of a form's functions by cell, packed again when a function has changed. Local.

    Args:
        form: The compiled form.
        functions: Functions of the form that may change.

    Attributes:
        packed: Values of all functions of the form, in the format of DOLFINx.
    """

    packed: dict[Any, Floats]

    def __init__(self, form: fem.Form, functions: Sequence[fem.Function]) -> None:
        self._form = form
        self._values: list[Floats] = [f.x.array for f in functions]
        self._before: list[Floats] | None = None

    def update(self) -> bool:
        """Pack if a function has changed since the last update. Local.

        Returns:
            Whether a function has changed.
        """
        if self._before is not None and all(map(_same, self._values, self._before)):
            return False
        self._before = [values.copy() for values in self._values]
        self.packed = cpp.fem.pack_coefficients(self._form._cpp_object)
        return True


class PackedForm:
    """A linear form over cells and facets, assembled by DOLFINx.

    Collective.

    Args:
        form: The form, which must not be empty.
    """

    def __init__(self, form: ufl.Form) -> None:
        self._form = compile_form(form)
        self._coefficients = _Coefficients(self._form, form.coefficients())

    def assemble(self, b: Floats) -> None:
        """Add the form on the cells and facets of this rank to a vector. Local.

        Args:
            b: Values of the local scalar dofs, shape ``(d l,)``, changed in place.
        """
        self._coefficients.update()
        fem.assemble_vector(b, self._form, coeffs=self._coefficients.packed)


def _same(values: Floats, before: Floats) -> bool:
    """Whether two arrays are identical bit by bit."""
    return np.array_equal(values.view(np.int64), before.view(np.int64))


class CellForm:
    """A linear form over cells, assembled by a loop of the package. Collective.

    `fem.assemble_vector` reads functions that are packed cell by cell, which takes a quarter of its
    time with 380 000 unknowns. This loop gathers the nodal values of a cell when it processes the
    cell. Only functions of other spaces are packed, when one of them has changed. Kernels compute
    several cells together if `batched_kernels` can create them; they are compiled in the background
    until the first assembly. Integrals over the same cells share the gathered values.

    Args:
        form: Linear form, made by `bulk_form`.
        kernels: ``"double"``, ``"single"`` (precision), or ``"slow"`` for double precision with a
            short compilation.
        V: Vector space whose functions are gathered; None: the space of the argument.
        num_sums: Number of extra components of the argument in each cell, in addition to a vector
            of V. Their sums over the cells are stored in ``sums``.

    Attributes:
        form: The form.
        sums: Sums over the cells of this rank at the last assembly, shape ``(num_sums,)``.
    """

    def __init__(
        self,
        form: ufl.Form,
        kernels: Kernels = "double",
        V: fem.FunctionSpace | None = None,
        num_sums: int = 0,
    ) -> None:
        self.form = form
        described = compile_quickly(form)
        if kernels != "slow":
            begin_batched_kernels(described, is_single=kernels == "single")
        self.sums: Floats = np.zeros(num_sums)
        self._loop_of = partial(_CellLoop, form, kernels, described, V, self.sums)
        self._left_out: Ints = _NO_PLACES

    @cached_property
    def _loop(self) -> "_CellLoop":
        """The loop, created on demand. Collective at the first use."""
        loop = self._loop_of()
        loop.leave_out(self._left_out)
        return loop

    def leave_out(self, cells: Ints) -> None:
        """Leave out cells of the form until the next call of this method. Local.

        Args:
            cells: Owned cells, local indices.
        """
        self._left_out = cells
        if "_loop" in self.__dict__:
            self._loop.leave_out(cells)

    def assemble(self, b: Floats, most: int | None = None) -> None:
        """Add the form on the cells of this rank to a vector, and set the sums.

        Collective at the first use.

        Args:
            b: Values of the local scalar dofs, shape ``(d l,)``, changed in place.
            most: Largest number of cells of each integral, for a sample; None: all.
        """
        self._loop.assemble(b, most)


class _CellLoop:
    """Loop of a `CellForm` over the cells of this rank, with the kernels of its integrals."""

    def __init__(
        self,
        form: ufl.Form,
        kernels: Kernels,
        described: fem.Form,
        V: fem.FunctionSpace | None,
        sums: Floats,
    ) -> None:
        W: fem.FunctionSpace = form.arguments()[0].ufl_function_space()
        V = W if V is None else V
        W, self._sums = V if len(sums) else W, sums
        self._form, made = _compiled(form, kernels, described)
        self._num_cells = len(V.dofmap.list)
        compiled = self._form.ufcx_form
        positions = compiled.original_coefficient_positions
        functions = [form.coefficients()[positions[i]] for i in range(compiled.num_coefficients)]
        widths = [f.function_space.element.space_dimension for f in functions]
        *first, width = accumulate(widths, initial=0)
        ranges = {
            f: np.arange(begin, begin + size, dtype=np.int32)
            for f, begin, size in zip(functions, first, widths, strict=True)
        }
        ours = [f for f in functions if f.function_space == V]
        others = [f for f in functions if f.function_space != V]
        self._others = _Coefficients(self._form, changing(others)) if others else None
        self._places = np.concatenate([_NO_PLACES, *(ranges[f] for f in others)])
        regions = dict(form.integrals()[0].subdomain_data())
        by_integral = [regions[i] for i in compiled.form_integral_ids[0 : len(made)]]
        # Groups of integrals over the same cells.
        self._groups = _grouped(by_integral)
        self._regions: list[Ints] = [by_integral[group[0]] for group in self._groups]
        self._cells = self._regions
        self._integrals = [
            _kernels.CellIntegral(
                [made[i] for i in group],
                V.mesh.geometry.x,
                compat.geometry_nodes(V.mesh),
                V.dofmap.list,
                [f.x.array for f in ours],
                [ranges[f][0] for f in ours],
                [c.value.reshape(-1) for c in form.constants()],  # views, read at assembly
                self._places,
                width,
                V.dofmap.index_map_bs,
                W.dofmap.list,
                W.dofmap.index_map_bs,
            )
            for group in self._groups
        ]
        self._packed: list[Floats] = [np.empty((self._num_cells, 0))] * len(self._integrals)

    def leave_out(self, cells: Ints) -> None:
        stays = np.ones(self._num_cells, dtype=bool)
        stays[cells] = False
        self._cells = [region[stays[region]] for region in self._regions]

    def assemble(self, b: Floats, most: int | None = None) -> None:
        if self._others is not None and self._others.update():
            by_key = self._others.packed
            # The second entry of a key is the integral's number, or its index in some releases;
            # both are in the order of the integrals.
            rows = [by_key[key] for key in sorted(by_key, key=lambda key: key[1])]
            self._packed = [
                self._by_cell(region, [rows[i] for i in group])
                for region, group in zip(self._regions, self._groups, strict=True)
            ]
        self._sums.fill(0.0)
        parts = zip(self._integrals, self._cells, self._packed, strict=True)
        for integral, cells, packed in parts:
            integral.add(cells[:most], packed, b, self._sums)

    def _by_cell(self, cells: Ints, rows: Sequence[Floats]) -> Floats:
        """Array with a row for every local cell, from the rows for the cells of integrals."""
        packed = np.zeros((self._num_cells, len(self._places)))
        for some in rows:
            # In an integral, DOLFINx sets functions that do not occur in it to zero.
            values = some[:, self._places]
            packed[cells] = np.where(values == 0, packed[cells], values)
        return packed


def _grouped(regions: Sequence[Ints]) -> list[list[int]]:
    """Group the indices of identical arrays of cells."""
    groups: dict[bytes, list[int]] = {}
    for number, cells in enumerate(regions):
        groups.setdefault(cells.tobytes(), []).append(number)
    return list(groups.values())


def _compiled(form: ufl.Form, kernels: Kernels, described: fem.Form) -> tuple[fem.Form, list[Any]]:
    """The compiled form, and a kernel for each of its integrals."""
    compiled = described
    if kernels != "slow":
        batched = batched_kernels(compiled, is_single=kernels == "single")
        if batched is not None:
            return compiled, batched
        compiled = compile_form(form)
    number = compiled.ufcx_form.form_integral_offsets[1]
    integrals = compiled.ufcx_form.form_integrals[0:number]
    return compiled, [_kernels.ElementKernel(*compat.kernel(integral)) for integral in integrals]
