"""Forms: how FFCx compiles them, and their values."""

import platform
from functools import partial
from typing import Any

from dolfinx import fem, la
from ufl.algorithms import expand_derivatives
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction

from dolfinx_nts.common.arrays import Floats

__all__ = ["assembled", "compile_expression", "compile_form"]


# GCC takes half of the width of AVX-512 unless it is told, and kernels a fifth to a
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
        "-freciprocal-math",
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
