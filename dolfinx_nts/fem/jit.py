"""Compilation of forms and expressions by FFCx, with the package's compiler flags."""

import platform
from functools import partial
from typing import Any

import ufl
from dolfinx import fem, la
from ufl.algorithms import expand_derivatives
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.form_cache import interrupted_forms_compiled, processor

__all__ = [
    "OPTIMISED",
    "SOON",
    "assembled",
    "compile_bilinear_form",
    "compile_expression",
    "compile_form",
    "compile_quickly",
]

# GCC uses half of the width of AVX-512 unless it is told otherwise, which makes kernels a fifth
# to a third slower.
_WIDEST = ["-mprefer-vector-width=512"] if platform.machine() in ("x86_64", "AMD64") else []
# With this macro, which nothing else reads, glibc declares vector versions of log, exp and
# pow. GCC vectorises no kernel that calls them without: those of NeoHookean take a third.
_VECTOR_FUNCTIONS = "-D__FAST_MATH__"
# The loop over points is vectorised if those in it are unrolled, which recent GCC does only with
# a greater limit than its own, of 200 instructions.
_UNROLLED = ["--param", "max-completely-peeled-insns=2000"]
# With vectors at the first level of optimisation, FFCx's kernels of bilinear forms are five times
# as soon compiled, and at most a ninth slower. With the last flag GCC clears wide registers after
# a kernel at this level, too, as instructions of other code that are not wide may need.
SOON = ["-O1", "-ftree-vectorize", "-fexpensive-optimizations"]
# Nothing reads it, but it makes the name of what is compiled one of this package and processor.
_KEY = f"-DDOLFINX_NTS_PROCESSOR={processor()}"
# Flags of -ffast-math without the one that assumes that there are no NaNs, on which checks
# depend; kernels are as fast.
OPTIMISED = [
    "-O3",
    "-march=native",
    _KEY,
    "-ffp-contract=fast",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-signed-zeros",
    "-fassociative-math",
    "-freciprocal-math",
    _VECTOR_FUNCTIONS,
    *_WIDEST,
]
# How long to wait for another process that compiles the same form [s]: 10, as FFCx has it, is
# too short on a busy machine.
_TIMEOUT = 40


def _options(*flags: str) -> dict[str, Any]:
    # Python's own flags ask for symbols of debuggers, which take up to a half of the time.
    return {"cffi_extra_compile_args": [*flags, _KEY, "-g0"], "timeout": _TIMEOUT}


def _compiled(options: dict[str, Any], form: ufl.Form) -> fem.Form:
    """Compile a form. Collective."""
    with interrupted_forms_compiled(), compat.quicker_ffcx():
        return fem.form(form, jit_options=options)


_FAST = _options(*OPTIMISED, *_UNROLLED)
compile_form = partial(_compiled, _FAST)
compile_bilinear_form = partial(_compiled, _options(*OPTIMISED, *SOON))
# With slow kernels: for forms that are assembled once, and for what else a compiled form knows.
compile_quickly = partial(_compiled, _options("-O0"))


def compile_expression(expression: Any, points: Floats) -> fem.Expression:
    """Compile an expression at points of the reference cell. Collective.

    Variables of UFL are replaced by what they stand for: each has a new number, so that FFCx
    would compile the same expression again and again.

    Args:
        expression: UFL expression.
        points: Points on the reference cell, shape ``(p, 3)``.

    Returns:
        The compiled expression.
    """
    plain = map_expr_dag(_WithoutVariables(), expand_derivatives(expression))
    with interrupted_forms_compiled(), compat.quicker_ffcx():
        return fem.Expression(plain, points, jit_options=_FAST)


class _WithoutVariables(MultiFunction):  # type: ignore[misc]
    """Replaces variables by what they stand for."""

    expr = MultiFunction.reuse_if_untouched

    def variable(self, o: Any, operand: Any, label: Any) -> Any:
        """What the variable stands for."""
        return operand


def assembled(form: fem.Form) -> Floats:
    """Assemble a linear form, summed over the ranks. Collective.

    Args:
        form: The compiled form.

    Returns:
        Values of the owned scalar dofs.
    """
    vector = fem.assemble_vector(form)
    vector.scatter_reverse(la.InsertMode.add)
    values: Floats = vector.array[: vector.block_size * vector.index_map.size_local]
    return values
