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

# By default GCC uses half of the width of AVX-512, which makes kernels 20 to 33 % slower.
_WIDEST = ["-mprefer-vector-width=512"] if platform.machine() in ("x86_64", "AMD64") else []
# With this macro glibc declares vector versions of log, exp and pow, and has no other effect.
# Without it GCC does not vectorise kernels that call them. With it kernels of NeoHookean take a
# third of the time.
_VECTOR_FUNCTIONS = "-D__FAST_MATH__"
# The loop over points is vectorised if its inner loops are unrolled. Recent GCC does so only with a
# limit above its default of 200 instructions.
_UNROLLED = ["--param", "max-completely-peeled-insns=2000"]
# With vectorisation at -O1, FFCx's kernels of bilinear forms compile five times faster, and are at
# most 11 % slower. With the last flag GCC also clears wide registers after a kernel at this level,
# which avoids a transition penalty in the code that follows.
SOON = ["-O1", "-ftree-vectorize", "-fexpensive-optimizations"]
# The macro is not used; it makes the name of the compiled module specific to package and processor.
_KEY = f"-DDOLFINX_NTS_PROCESSOR={processor()}"
# Flags of -ffast-math except -ffinite-math-only, as checks depend on NaNs. Kernels are as fast.
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
# Time limit for another process that compiles the same form [s]. The default of FFCx, 10 s, is too
# short on a busy machine.
_TIMEOUT = 40


def _options(*flags: str) -> dict[str, Any]:
    # Python's default flags include debug symbols, which take up to half of the compile time.
    return {"cffi_extra_compile_args": [*flags, _KEY, "-g0"], "timeout": _TIMEOUT}


def _compiled(options: dict[str, Any], form: ufl.Form) -> fem.Form:
    """Compile a form. Collective."""
    with interrupted_forms_compiled(), compat.quicker_ffcx():
        return fem.form(form, jit_options=options)


_FAST = _options(*OPTIMISED, *_UNROLLED)
compile_form = partial(_compiled, _FAST)
compile_bilinear_form = partial(_compiled, _options(*OPTIMISED, *SOON))
# Without optimisation, for forms that are assembled once or of which only metadata are used.
compile_quickly = partial(_compiled, _options("-O0"))


def compile_expression(expression: Any, points: Floats) -> fem.Expression:
    """Compile an expression at points of the reference cell. Collective.

    UFL variables are replaced by their operands. Each variable has a new label, so FFCx would
    compile the same expression repeatedly.

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
    """Replaces variables by their operands."""

    expr = MultiFunction.reuse_if_untouched

    def variable(self, o: Any, operand: Any, label: Any) -> Any:
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
