"""Column names, and columns of the components of vectors.

The rule is ``kind_name_quantity``: ``body_ball_mass``, ``pair_ball_outer_plate_top_force_x``,
``support_1_work``, ``load_gravity_work``.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any, TypeVar

import numpy as np

from dolfinx_nts.common.arguments import did_you_mean
from dolfinx_nts.contact.pair import ContactPair

__all__ = ["ByName", "flat", "pair_names", "part_names"]

Value = TypeVar("Value")

# Longest name [characters]; longer ones would hide the quantity.
_LONGEST = 40
# Leading words of automatic names that are omitted in columns, as in "the boundary of ball". Names
# chosen by the user are not changed: a body may be called "a".
_LEFT_OUT = re.compile(
    r"\ban? (?=part of the boundary\b|(moving )?[A-Z])"
    r"|\b(of )?the (?=boundary\b)|(?<=\bboundary )of "
)
# Axes of the components of a vector, by their number. A single component is along the axis y of an
# axisymmetric mesh, or about z for moments in the plane.
_AXES = {0: "", 1: "y", 2: "xy", 3: "xyz"}
_MOMENTS, _TURNING = ("moment", "angular_momentum", "torque"), {0: "", 1: "z", 3: "xyz"}


class ByName(dict[str, Value]):
    """Values by column name, with access also by the name that the user has chosen. Local.

    Args:
        kind: Kind of the objects, see `part_names`.
        names: Column names.
        values: Value of each.
    """

    def __init__(self, kind: str, names: Iterable[str], values: Iterable[Value]) -> None:
        super().__init__(zip(names, values, strict=True))
        self._kind = kind

    def __missing__(self, name: str) -> Value:
        (known,) = part_names(self._kind, [str(name)])
        if known in self:
            return self[known]
        suggestion = did_you_mean(known, self)
        raise KeyError(f"there is no {self._kind} {name!r}{suggestion}; there are {list(self)}")


def part_names(kind: str, names: Iterable[str]) -> list[str]:
    """Unique column names of objects of one kind. Local.

    Args:
        kind: Kind of the objects, such as ``"body"``, which is omitted if a name begins with it.
        names: Names of the objects, in any letters.

    Returns:
        Words in lower case, joined by ``_``. A name that is too long is replaced by the number of
        its object, from 1; this number is appended to names that are not unique.
    """
    words = [_words(name) for name in names]
    plain = ["_".join(w[1:] if w[0] == kind and len(w) > 1 else w) for w in words]
    count = Counter(plain)
    return [
        str(i) if len(name) > _LONGEST else f"{name}_{i}" if count[name] > 1 else name
        for i, name in enumerate(plain, start=1)
    ]


def pair_names(pairs: Iterable[ContactPair]) -> list[str]:
    """Names of contact pairs; the names of both sides for pairs without a name. Local."""
    names = (pair.name or pair.between for pair in pairs)
    return part_names("pair", (name.replace(" and ", ", ") for name in names))


def flat(prefix: str, values: Mapping[str, Any]) -> dict[str, float]:
    """Numbers by name, with ``_x``, ``_y``, ``_z`` for the components of a vector. Local.

    In the plane vectors have the components ``_x`` and ``_y``, moments ``_z``. In axisymmetric
    meshes vectors have the component ``_y``, moments none.

    Args:
        prefix: Prefix of all names.
        values: Numbers, and vectors of up to three components, by name.
    """
    columns: dict[str, float] = {}
    for name, value in values.items():
        if isinstance(value, (float, int)) or np.ndim(value) == 0:  # NumPy would be slower
            columns[prefix + name] = value
        else:
            parts: Any = value.tolist() if isinstance(value, np.ndarray) else map(float, value)
            columns.update(zip(_of_parts(prefix, name, len(value)), parts, strict=True))
    return columns


@cache
def _of_parts(prefix: str, name: str, number: int) -> list[str]:
    """Columns of the components of a vector, each with its value."""
    axes = (_TURNING if name in _MOMENTS else _AXES)[number]
    return [f"{prefix}{name}_{axis}" for axis in axes]


def _words(name: str) -> list[str]:
    """Words of a name in lower case; ``RigidPlane`` has two."""
    apart = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", _LEFT_OUT.sub("", name))
    return re.findall(r"[^\W_]+", apart.lower()) or ["unnamed"]
