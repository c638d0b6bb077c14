"""Arguments: checks that several classes share, and the text of a call with them."""

import math
from collections.abc import Iterable
from numbers import Real
from typing import Any

import numpy as np

__all__ = ["as_call", "finite", "instances", "nonnegative", "positive", "real"]


def as_call(item: object, **values: Any) -> str:
    """One line with the class of an object and values by name, for its ``repr``.

    Numbers have up to 12 digits; of a function there is its name.
    """
    return f"{type(item).__name__}({', '.join(f'{k}={_text(v)}' for k, v in values.items())})"


def _text(value: Any) -> str:
    if isinstance(value, Real) and not isinstance(value, bool | int):
        return f"{float(value) + 0.0:.12g}"  # not -0
    if isinstance(value, np.ndarray):
        return f"({', '.join(map(_text, value))})"
    if callable(value):
        return getattr(value, "__name__", type(value).__name__)
    return repr(value)


def instances(kind: type[Any], items: Iterable[Any]) -> tuple[Any, ...]:
    """Items of a kind.

    Raises:
        TypeError: They are no list, or one of them is of another kind.
    """
    if isinstance(items, kind) or not isinstance(items, Iterable):
        raise TypeError(f"expected a list of {kind.__name__}, given {type(items).__name__}")
    items = tuple(items)
    for item in items:
        if not isinstance(item, kind):
            raise TypeError(f"expected a {kind.__name__}, given {type(item).__name__}")
    return items


def real(name: str, value: Any) -> float:
    """A number, perhaps not finite.

    Raises:
        TypeError: The value is no real number.
    """
    if not isinstance(value, Real):
        raise TypeError(f"expected a number for {name}, given {value!r}")
    return float(value)


def finite(name: str, value: Any) -> float:
    """A finite number.

    Raises:
        TypeError: The value is no real number.
        ValueError: It is not finite.
    """
    number = real(name, value)
    if not math.isfinite(number):
        raise ValueError(f"expected a finite number for {name}, given {value}")
    return number


def nonnegative(name: str, value: Any) -> float:
    """A finite number from 0 on.

    Raises:
        TypeError: The value is no real number.
        ValueError: It is not finite, or below 0.
    """
    number = real(name, value)
    if not (math.isfinite(number) and number >= 0):
        raise ValueError(f"expected {name} >= 0, given {value}")
    return number


def positive(name: str, value: Any) -> float:
    """A finite number above 0.

    Raises:
        TypeError: The value is no real number.
        ValueError: It is not finite, or not above 0.
    """
    number = real(name, value)
    if not (math.isfinite(number) and number > 0):
        raise ValueError(f"expected {name} > 0, given {value}")
    return number
