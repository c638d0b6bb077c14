"""Kernels for batches of cells, one SIMD lane per cell, from the C code of FFCx for one cell.

Each number that depends on the cell becomes a vector over the cells of the batch. Tables and
constants stay scalars. Two text replacements are enough: accumulators, which start from zero,
become vectors, and all other variables get the type ``auto``. Operators and functions of vectors
are in `lanes.h`. The expressions do not change.
"""

import re
from typing import NamedTuple

from dolfinx_nts.fem.tensor_tables import factorised

__all__ = ["Columns", "batched_source"]

_KERNEL = re.compile(r"^void tabulate_tensor_(\w+)\([^)]*\)\s*\{$", re.M)
_ORDER = re.compile(r"\bform_integrals_\w+\[\d+\] = \{([^}]*)\}")
_ZERO = re.compile(r"^(\s*)double (\w+) = 0(?:\.0)?;", re.M)
_ZEROS = re.compile(r"^(\s*)double (\w+)((?:\[\d+\])+) = \{[0., ]*\};", re.M)
_LOCAL = re.compile(r"^(\s*)(?:double|bool|int) (\w+) = ", re.M)
_INTEGER = re.compile(r"(?<=[?:] )(-?\d+)(?=[ ;])")
_TABLE = re.compile(r"^static const double\b", re.M)
# Keywords of kernels that cannot be batched: branches, and data of single cells.
_OF_ONE_CELL = re.compile(r"\b(?:if|switch|while|entity_local_index|quadrature_permutation)\b")

# Within the namespace, as library functions outside of it have the same names.
_HEAD = """#include "bilinear.h"
#include "trilinear.h"
namespace nts
{
"""
_END = """
} // namespace nts
"""
_FUNCTION = """
extern "C" void batch_{number}(Lanes* __restrict__ A, const Lanes* __restrict__ w,
                        const Real* __restrict__ c,
                        const Lanes* __restrict__ coordinate_dofs)
{{{body}}}
"""
_MATRIX = """
extern "C" void matrix_{number}(double* A, const double* w, const double* c, const double* x)
{{
  add_columns<{sizes}>(batch_{number}, A, w, c, x);
}}
"""


class Columns(NamedTuple):
    """Sizes of a cell's matrix and of its action on a function, in the order of `columns.h`.

    Attributes:
        rows: Scalar dofs of the test function in a cell.
        columns: Scalar dofs of the function.
        first: Offset of its first value among the values of all functions.
        width: Values of all functions in a cell.
        coordinates: Coordinates of all nodes of the geometry of a cell.
    """

    rows: int
    columns: int
    first: int
    width: int
    coordinates: int


def batched_source(source: str, columns: Columns | None = None) -> str:
    """Translate the kernels of a linear form over cells for batches of cells. Local.

    Args:
        source: The C that FFCx wrote for the form.
        columns: Position of the function to which a bilinear form was applied, if the form is such
            an action.

    Returns:
        C++ with a function ``batch_0``, ``batch_1``, ... for each integral, in the order of the
        form, and with columns ``matrix_0``, ... of the bilinear form next to each.

    Raises:
        ValueError: The text does not have the expected form.
    """
    bodies = {match[1]: _until_closed(source[match.end() :]) for match in _KERNEL.finditer(source)}
    order = _ORDER.search(source)
    names = re.findall(r"&(\w+)", order[1]) if order else []
    if not names or not set(names) <= set(bodies):
        raise ValueError("expected kernels of FFCx")
    if any(_OF_ONE_CELL.search(bodies[name]) for name in names):
        raise ValueError("expected kernels without branches")
    functions = [
        _FUNCTION.format(number=i, body=_in_lanes(bodies[name])) for i, name in enumerate(names)
    ]
    if columns is not None:
        sizes = ", ".join(map(str, columns))
        functions += [_MATRIX.format(number=i, sizes=sizes) for i in range(len(names))]
        # Matrices are in double precision only.
        return '#include "columns.h"\n' + _HEAD + "".join(functions) + _END
    return _HEAD + "".join(functions) + _END


def _until_closed(text: str) -> str:
    """Text up to the closing brace of a block that was opened before the text."""
    depth = 1
    for brace in re.finditer(r"[{}]", text):
        depth += 1 if brace[0] == "{" else -1
        if depth == 0:
            return text[: brace.start()]
    return text


def _in_lanes(body: str) -> str:
    body = _ZERO.sub(r"\1Lanes \2 = {};", factorised(body))
    body = _ZEROS.sub(r"\1Lanes \2\3 = {};", body)
    body = _LOCAL.sub(r"\1auto \2 = ", _INTEGER.sub(r"Real(\1)", body))
    return _TABLE.sub("static const Real", body)
