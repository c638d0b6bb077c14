"""Bilinear forms whose matrices are assembled repeatedly.

FFCx sums over all pairs of derivatives of test and trial functions. The compilation of these
kernels takes most of the compile time of all forms of a step. `CellMatrix` applies the bilinear
form to unit vectors instead, one SIMD lane per column.
"""

from functools import cached_property
from itertools import accumulate

import ufl
from dolfinx import fem

from dolfinx_nts import compat
from dolfinx_nts.fem.batched_kernels import begin_batched_kernels, matrix_kernels
from dolfinx_nts.fem.batched_source import Columns
from dolfinx_nts.fem.jit import compile_bilinear_form, compile_quickly

__all__ = ["CellMatrix", "compiled_matrix"]


class CellMatrix:
    """A bilinear form over cells. Collective.

    Its kernels are compiled in the background until the form is first needed.

    Args:
        form: Bilinear form, made by `bulk_form`, with derivatives applied.
    """

    def __init__(self, form: ufl.Form) -> None:
        self._form = form
        self._unit = fem.Function(form.arguments()[1].ufl_function_space())
        self._action = ufl.action(form, self._unit)
        self._described = compile_quickly(self._action)
        begin_batched_kernels(self._described, columns=self._columns())

    @cached_property
    def compiled(self) -> fem.Form:
        """The compiled form for DOLFINx. Collective at the first use."""
        kernels = matrix_kernels(self._described, self._columns())
        if kernels is None:
            return compile_bilinear_form(self._form)
        numbers = self._described.ufcx_form.form_integral_ids[0 : len(kernels)]
        regions = dict(self._form.integrals()[0].subdomain_data())
        return compat.form_of_kernels(
            [argument.ufl_function_space() for argument in self._form.arguments()],
            [(kernel, regions[number]) for kernel, number in zip(kernels, numbers, strict=True)],
            [f for f in self._functions() if f is not self._unit],
            self._action.constants(),
        )

    def _functions(self) -> list[fem.Function]:
        """Functions in the action of the form, in the order of the kernels."""
        compiled, functions = self._described.ufcx_form, self._action.coefficients()
        positions = compiled.original_coefficient_positions
        return [functions[positions[i]] for i in range(compiled.num_coefficients)]

    def _columns(self) -> Columns:
        functions = self._functions()
        widths = [f.function_space.element.space_dimension for f in functions]
        *first, width = accumulate(widths, initial=0)
        place = functions.index(self._unit)
        test = self._form.arguments()[0].ufl_function_space()
        nodes = compat.geometry_nodes(test.mesh).shape[1]
        return Columns(
            rows=test.element.space_dimension,
            columns=widths[place],
            first=first[place],
            width=width,
            coordinates=3 * nodes,
        )


def compiled_matrix(form: ufl.Form) -> fem.Form:
    """Compile a bilinear form for DOLFINx, by `CellMatrix` if it is over cells. Collective.

    Args:
        form: Bilinear form with derivatives applied, which is not empty. The cells of its integrals
            are given by `bulk_form` or by tags of DOLFINx.

    Returns:
        The compiled form.
    """
    is_over_bodies = all(
        integral.integral_type() == "cell" and isinstance(integral.subdomain_data(), list)
        for integral in form.integrals()
    )
    return CellMatrix(form).compiled if is_over_bodies else compile_bilinear_form(form)
