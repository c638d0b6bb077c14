"""Forms: how FFCx compiles them, their values, and forms on a part of the cells."""

import platform
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from ufl.algorithms import expand_derivatives, extract_coefficients
from ufl.algorithms.analysis import extract_constants
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction

from dolfinx_nts.packed_form import PackedForm

__all__ = ["CellForm", "assembled", "compile_expression", "compile_form", "packed"]

Floats = npt.NDArray[np.float64]
Regions = list[tuple[int, npt.NDArray[np.int32]]]

# Compilers take vectors of half the width where they may, and kernels a fifth to a
# third longer.
_WIDEST = ["-mprefer-vector-width=512"] if platform.machine() in ("x86_64", "AMD64") else []
# As fast as -ffast-math but for the assumption that there are no NaNs.
_OPTIONS = {
    "cffi_extra_compile_args": [
        "-O3",
        "-march=native",
        "-ffp-contract=fast",
        "-fno-math-errno",
        "-fno-trapping-math",
        "-fno-signed-zeros",
        "-fassociative-math",
        *_WIDEST,
    ]
}

compile_form = partial(fem.form, jit_options=_OPTIONS)


def compile_expression(expression: Any, points: Floats) -> fem.Expression:
    """Compile an expression at points of the reference cell. Collective.

    Args:
        expression: UFL, with derivatives by variables or without. As these
            are numbered on and on, it would be compiled again for each.
        points: Shape ``(p, 3)``.
    """
    plain = map_expr_dag(_WithoutVariables(), expand_derivatives(expression))
    return fem.Expression(plain, points, jit_options=_OPTIONS)


class _WithoutVariables(MultiFunction):  # type: ignore[misc]
    """Puts what they stand for in the place of variables."""

    expr = MultiFunction.reuse_if_untouched

    def variable(self, o: Any, operand: Any, label: Any) -> Any:
        """The operand."""
        return operand


def assembled(form: fem.Form) -> Floats:
    """A linear form on the owned dofs, summed over the ranks. Collective.

    Args:
        form: The form, compiled.
    """
    vector = fem.assemble_vector(form)
    vector.scatter_reverse(la.InsertMode.add)
    values: Floats = vector.array[: vector.block_size * vector.index_map.size_local]
    return values


def packed(form: ufl.Form) -> PackedForm:
    """Compile a linear form over whatever; collective.

    Args:
        form: The form, not empty.
    """
    return PackedForm(compile_form(form), form.coefficients())


class CellForm:
    """A form of `bulk_form` with one argument, compiled once.

    Args:
        form: Linear form.

    Attributes:
        everywhere: On the cells of its measures, packed.
    """

    def __init__(self, form: ufl.Form) -> None:
        """Compile."""
        self._ufl, self._functions = form, form.coefficients()
        self._V: fem.FunctionSpace = form.arguments()[0].ufl_function_space()
        # Of a region in which a derivative is zero there is no integral.
        numbers = {integral.subdomain_id() for integral in form.integrals()}
        regions = form.integrals()[0].subdomain_data()
        self._regions = [(i, cells) for i, cells in regions if i in numbers]
        self.everywhere = self._packed(compile_form(form), self._regions)
        self._compiled: Any = None

    def without(self, cells: npt.NDArray[np.int32]) -> PackedForm:
        """On all cells but these; collective for the first time.

        Args:
            cells: Owned cells.
        """
        form, V = self._ufl, self._V
        if self._compiled is None:
            self._compiled = fem.compile_form(V.mesh.comm, form, jit_options=_OPTIONS)
        regions = [(i, np.setdiff1d(all_, cells)) for i, all_ in self._regions]
        form = fem.create_form(
            self._compiled,
            [V],
            V.mesh,
            {fem.IntegralType.cell: regions},
            {item: item for item in extract_coefficients(form)},
            {item: item for item in extract_constants(form)},
        )
        return self._packed(form, regions)

    def _packed(self, form: fem.Form, regions: Regions) -> PackedForm:
        nodes = [self._V.dofmap.list[cells] for _, cells in regions]
        return PackedForm(form, self._functions, self._V, nodes)
