"""Sum factorisation of bi- and trilinear functions in the kernels of FFCx.

FFCx sums over the nodes of a quadrilateral or a hexahedron for the value and for each derivative
of a function at each Gauss point. `factorised` replaces these sums by `bilinear.h` or
`trilinear.h`, after a comparison of the tables with the expected ones.
"""

import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from dolfinx_nts.common.arrays import Floats

__all__ = ["factorised"]

# Structs that replace tables, by the number of nodes of a cell. There are as many points as nodes.
_NAMES = {4: "Bilinear", 8: "Trilinear"}
_TABLE = re.compile(r"static const double (\w+)\[1\]\[1\]\[([48])\]\[\2\] = \{([^;]*)\};")
_NUMBER = re.compile(r"[-+.\w]+")
_LOOP = r"for \(int {index} = 0; {index} < [48]; \+\+{index}\)\s*\{{([^{{}}]*)\}}"
_SUMS, _OUTPUTS = (re.compile(_LOOP.format(index=index)) for index in ("ic", "i"))
_NODE = r"(?:\(ic?\) \* (?P<stride>[23])|(?P<before>[23]) \* \(ic?\))"
_AT = rf"(?:(?P<first>\d+) \+ )?\(?{_NODE}(?: \+ (?P<component>\d+))?\)?"
_TIMES = r" \* (?P<table>\w+)\[0\]\[0\]\[iq\]"
_SUM = re.compile(rf"(?P<number>\w+) \+= (?P<source>w|coordinate_dofs)\[{_AT}\]{_TIMES}\[ic\]")
_OUTPUT = re.compile(rf"A\[{_AT}\] \+= (?P<number>\w+){_TIMES}\[i\]")
_FOUR_POINTS = re.compile(r"^(?=for \(int iq = 0; iq < 4;)", re.M)
# Tolerance of the comparison of tables [-]: round-off of their printed numbers.
_TOLERANCE = 1e-12


@cache
def _tables(num_nodes: int) -> dict[str, Floats]:
    """Values and derivatives of the shape functions at the points, shapes ``(n, n)``."""
    gauss = (1 + np.array([-1, 1]) / np.sqrt(3)) / 2
    value, slope = np.stack([1 - gauss, gauss], axis=1), np.array([[-1.0, 1.0]] * 2)
    # Numbering: points z + 2 y + 4 x, nodes x + 2 y + 4 z; in quadrilaterals points y + 2 x, nodes
    # x + 2 y.
    axes = "xyz"[: {4: 2, 8: 3}[num_nodes]]
    sums = {"xy": "ai,bj->abji", "xyz": "ai,bj,ck->abckji"}[axes]
    return {
        f"d{along}" if along else "value": np.einsum(
            sums, *(slope if axis == along else value for axis in axes)
        ).reshape(num_nodes, num_nodes)
        for along in ("", *axes)
    }


def factorised(body: str) -> str:
    """Replace sums over tables of bi- and trilinear functions. Local.

    Args:
        body: The body of a kernel in FFCx's C.

    Returns:
        The body, in which all matching sums are replaced.
    """
    kinds = _kinds(body)
    functions: dict[str, str] = {}
    outputs: dict[str, str] = {}

    def place(found: re.Match[str]) -> int:
        return int(found["first"] or 0) + int(found["component"] or 0)

    def at_point(found: re.Match[str]) -> str:
        name, kind = kinds[found["table"]]
        source, first, stride = found["source"], place(found), _stride(found)
        function = f"{source}_{first}_at_points"
        functions[function] = f"{name} {function} = {name}::of<{stride}>({source} + {first});"
        return f"{found['number']} = {function}.{kind}_at(iq);"

    def from_point(found: re.Match[str]) -> str:
        name, kind = kinds[found["table"]]
        first = place(found)
        outputs[f"{name} A_{first} = {{}};"] = f"A_{first}.add_to<{_stride(found)}>(A + {first});"
        return f"A_{first}.{kind}_at(iq) += {found['number']};"

    def replaced(pattern: re.Pattern[str], line: Callable[[re.Match[str]], str]) -> Any:
        """Text of loops in factorised form, if all their statements match and use known tables."""

        def replace(loop: re.Match[str]) -> str:
            found = [pattern.fullmatch(statement) for statement in _statements(loop[1])]
            known = [match for match in found if match is not None and match["table"] in kinds]
            return "{" + "\n".join(map(line, known)) + "}" if len(known) == len(found) else loop[0]

        return replace

    body = _OUTPUTS.sub(replaced(_OUTPUT, from_point), _SUMS.sub(replaced(_SUM, at_point), body))
    # Four points together share derivatives; eight would take too long to compile.
    body = _FOUR_POINTS.sub("#pragma GCC unroll 4\n", body) if functions else body
    return "\n".join(["", *functions.values(), *outputs, body, *outputs.values(), ""])


def _stride(found: re.Match[str]) -> str:
    """Number of values of a node."""
    return found["stride"] or found["before"]


def _kinds(body: str) -> dict[str, tuple[str, str]]:
    """Known tables by name: class of the factorised functions, and value or derivative."""
    kinds = {}
    for table, count, text in _TABLE.findall(body):
        numbers = np.array([float(number) for number in _NUMBER.findall(text)])
        for kind, expected in _tables(int(count)).items():
            if numbers.size == expected.size and (
                abs(numbers - expected.ravel()).max() < _TOLERANCE
            ):
                kinds[table] = _NAMES[int(count)], kind
    return kinds


def _statements(text: str) -> list[str]:
    return [statement.strip() for statement in text.split(";") if statement.strip()]
