"""Sums over tables of trilinear functions in FFCx's kernels, taken one direction after another.

FFCx sums over the eight nodes of a hexahedron for the value and for each derivative of a
function at each of the eight Gauss points. `factorised` puts `trilinear.h` in the place of these
sums, after it has compared the tables with those that it stands for.
"""

import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from dolfinx_nts.common.arrays import Floats

__all__ = ["factorised"]

_TABLE = re.compile(r"static const double (\w+)\[1\]\[1\]\[8\]\[8\] = \{([^;]*)\};")
_NUMBER = re.compile(r"[-+.\w]+")
_LOOP = r"for \(int {index} = 0; {index} < 8; \+\+{index}\)\s*\{{([^{{}}]*)\}}"
_SUMS, _OUTPUTS = (re.compile(_LOOP.format(index=index)) for index in ("ic", "i"))
_AT = r"(?:(?P<first>\d+) \+ )?\(?(?:\(ic?\) \* 3|3 \* \(ic?\))(?: \+ (?P<component>\d+))?\)?"
_TIMES = r" \* (?P<table>\w+)\[0\]\[0\]\[iq\]"
_SUM = re.compile(rf"(?P<number>\w+) \+= (?P<source>w|coordinate_dofs)\[{_AT}\]{_TIMES}\[ic\]")
_OUTPUT = re.compile(rf"A\[{_AT}\] \+= (?P<number>\w+){_TIMES}\[i\]")
# Tables are as good as the round-off of those that wrote them [-].
_TOLERANCE = 1e-12


@cache
def _tables() -> dict[str, Floats]:
    """Values and derivatives of the shape functions at the points, shapes ``(8, 8)``."""
    gauss = (1 + np.array([-1, 1]) / np.sqrt(3)) / 2
    value, slope = np.stack([1 - gauss, gauss], axis=1), np.array([[-1.0, 1.0]] * 2)
    by_direction = {
        "value": (value, value, value),
        "dx": (slope, value, value),
        "dy": (value, slope, value),
        "dz": (value, value, slope),
    }
    # Points z + 2 y + 4 x, nodes x + 2 y + 4 z.
    return {
        name: np.einsum("ai,bj,ck->abckji", *factors).reshape(8, 8)
        for name, factors in by_direction.items()
    }


def factorised(body: str) -> str:
    """Replace sums over tables of trilinear functions. Local.

    Args:
        body: The body of a kernel in FFCx's C.

    Returns:
        The body with the sums that were found replaced, as it was if there are none.
    """
    kinds = _kinds(body)
    functions: dict[tuple[str, int], str] = {}
    outputs: set[int] = set()

    def place(found: re.Match[str]) -> int:
        return int(found["first"] or 0) + int(found["component"] or 0)

    def at_point(found: re.Match[str]) -> str:
        key = found["source"], place(found)
        function = functions.setdefault(key, "{}_{}_at_points".format(*key))
        return f"{found['number']} = {function}.{kinds[found['table']]}_at(iq);"

    def from_point(found: re.Match[str]) -> str:
        outputs.add(place(found))
        return f"A_{place(found)}.{kinds[found['table']]}_at(iq) += {found['number']};"

    def replaced(pattern: re.Pattern[str], line: Callable[[re.Match[str]], str]) -> Any:
        """Replace loops all of whose statements match and have known tables."""

        def replace(loop: re.Match[str]) -> str:
            found = [pattern.fullmatch(statement) for statement in _statements(loop[1])]
            known = [match for match in found if match is not None and match["table"] in kinds]
            return "{" + "\n".join(map(line, known)) + "}" if len(known) == len(found) else loop[0]

        return replace

    body = _OUTPUTS.sub(replaced(_OUTPUT, from_point), _SUMS.sub(replaced(_SUM, at_point), body))
    before = [
        f"Trilinear {name} = at_points({source} + {place});"
        for (source, place), name in functions.items()
    ]
    before += [f"Trilinear A_{place} = {{}};" for place in sorted(outputs)]
    after = [f"add_to_nodes(A_{place}, A + {place});" for place in sorted(outputs)]
    return "\n".join(["", *before, body, *after, ""])


def _kinds(body: str) -> dict[str, str]:
    """What the tables of a kernel hold that are known: a value or a derivative."""
    kinds = {}
    for name, text in _TABLE.findall(body):
        numbers = np.array([float(number) for number in _NUMBER.findall(text)])
        for kind, table in _tables().items():
            if numbers.shape == (64,) and abs(numbers - table.ravel()).max() < _TOLERANCE:
                kinds[name] = kind
    return kinds


def _statements(text: str) -> list[str]:
    return [statement.strip() for statement in text.split(";") if statement.strip()]
