"""Checks of arguments, and the text of a call with them."""

import math
import reprlib
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from inspect import signature
from numbers import Integral, Real
from typing import Any

import numpy as np

from dolfinx_nts.common.arrays import Floats

__all__ = [
    "as_call",
    "called",
    "called_with_fixed",
    "check_call",
    "check_methods",
    "check_spelling",
    "chosen_times",
    "did_you_mean",
    "finite",
    "functions_by_name",
    "instances",
    "is_of_package",
    "kind_of",
    "label",
    "nonnegative",
    "positive",
    "real",
    "real_array",
    "whole",
    "with_article",
]

# Digits of printed numbers [-]: enough for numbers given by users, without their round-off.
_DIGITS = 12
# Similarity of two names [-] above which one is the other, misspelt. Smaller: names of other
# attributes are refused.
_SAME_WORD = 0.85


def as_call(item: object, **values: Any) -> str:
    """Constructor call of an object in one line, for its ``repr``. Local.

    Args:
        item: The object.
        **values: Its arguments by name. Numbers are printed with up to 12 digits, functions and
            UFL expressions by name.

    Returns:
        ``Class(name=value, ...)``.
    """
    return f"{type(item).__name__}({', '.join(f'{k}={_text(v)}' for k, v in values.items())})"


def _text(value: Any) -> str:
    if isinstance(value, Real) and not isinstance(value, bool | int):
        return f"{float(value) + 0.0:.{_DIGITS}g}"  # not -0
    if isinstance(value, np.ndarray):
        return f"({', '.join(map(_text, value))})"
    if callable(value):
        return getattr(value, "__name__", type(value).__name__)
    return repr(value)


def with_article(name: str) -> str:
    """Name with the indefinite article, as in ``"an Obstacle"``. Local."""
    return f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"


def label(value: Any) -> str:
    """Check that a name is a text, empty for an automatic one. Local.

    Raises:
        TypeError: The name is not a string.
    """
    if not isinstance(value, str):
        raise TypeError(f"expected a text as name, such as 'floor', given {value!r}")
    return value


def did_you_mean(name: Any, known: Iterable[str]) -> str:
    """Suggest the known names closest to an unknown one, as the end of a message. Local.

    Args:
        name: The unknown name.
        known: The names that exist.

    Returns:
        ``": did you mean 'ball'?"``, or "" if no name is close.
    """
    close = get_close_matches(str(name), list(known), n=3)
    return f": did you mean {' or '.join(map(repr, close))}?" if close else ""


def kind_of(item: object) -> str:
    """Description of an object of a wrong class in messages. Local."""
    return f"the class {item.__name__}" if isinstance(item, type) else type(item).__name__


def check_call(
    kind: type[Any], arguments: Iterable[Any], options: Mapping[str, Any], hint: str = ""
) -> None:
    """Check that a class takes the arguments of a call. Local.

    Args:
        kind: The class.
        arguments: Arguments by place.
        options: Arguments by name.
        hint: Additional text of the message on the arguments of the class.

    Raises:
        TypeError: An argument is missing or unknown.
    """
    call = signature(kind.__init__)
    try:
        call.bind(None, *arguments, **options)
    except TypeError as error:
        _, *taken = call.parameters.values()
        names = [f"**{p.name}" if p.kind == p.VAR_KEYWORD else p.name for p in taken]
        named = [p.kind == p.KEYWORD_ONLY for p in taken]
        if any(named):
            names.insert(named.index(True), "*")
        required = [p for p in taken if p.default is p.empty and p.kind != p.VAR_KEYWORD]
        needed = " and ".join(p.name for p in required)
        must = f", of which {needed} must be given{hint}" if needed else ""
        given = ", ".join([*map(kind_of, arguments), *(f"{name}=" for name in options)])
        raise TypeError(
            f"expected {kind.__name__}({', '.join(names)}){must}, "
            f"given {kind.__name__}({given}): {error}"
        ) from None


def check_methods(kind: type[Any]) -> None:
    """Check that a class implements all methods that its base class requires. Local.

    Raises:
        TypeError: A method is missing.
    """
    missing = sorted(getattr(kind, "__abstractmethods__", ()))
    if missing:
        calls = " and ".join(
            f"{name}({', '.join(signature(getattr(kind, name)).parameters)})" for name in missing
        )
        raise TypeError(
            f"expected a method {calls} in the class {kind.__name__}, as in help of "
            f"{kind.__mro__[1].__name__}, given none"
        )


def is_of_package(function: Any) -> bool:
    """Whether a function is defined in the package, and not by a user. Local."""
    return (getattr(function, "__module__", None) or "").startswith("dolfinx_nts.")


def check_spelling(given: Any, optional: Iterable[str]) -> None:
    """Check that no attribute of a user-defined object is a misspelt optional one. Local.

    Args:
        given: An object whose class is derived from one of the package.
        optional: Names of attributes that have a default in the package.

    Raises:
        AttributeError: A name differs from an optional one by a few letters.
    """
    names = {name.lower(): name for name in optional}
    for name in sorted(set(dir(given)) - set(names.values())):
        for close in get_close_matches(name.lower(), names, n=1, cutoff=_SAME_WORD):
            raise AttributeError(
                f"expected {names[close]} as an attribute of {type(given).__name__}, given "
                f"{name}: correct the spelling, or choose a name that differs more"
            )


def called(function: Callable[..., Any], name: str, *arguments: Any) -> Any:
    """Call a user-defined function, after a check that it takes these arguments. Local.

    Args:
        function: The function.
        name: Name and arguments of the function in a message, such as ``limit(p, slip)``.
        *arguments: Arguments by place.

    Raises:
        TypeError: The function takes other arguments.
    """
    try:
        call = signature(function)
    except (TypeError, ValueError):
        return function(*arguments)
    try:
        call.bind(*arguments)
    except TypeError as error:
        raise TypeError(f"expected {name}, given ({', '.join(call.parameters)}): {error}") from None
    return function(*arguments)


def called_with_fixed(
    function: Callable[..., Any], name: str, given: Any, advice: str, *arguments: Any
) -> Any:
    """Call a user-defined function, as `called`, with arrays that it cannot change. Local.

    Args:
        function: The function.
        name: Name and arguments of the function in a message, such as ``limit(p, slip)``.
        given: The object in a message whose method it is.
        advice: How to write a change, such as ``x = x - c instead of x -= c``.
        *arguments: Arguments by place.

    Raises:
        TypeError: The function takes other arguments.
        ValueError: It changes an array.
    """
    fixed = [each.view() if isinstance(each, np.ndarray) else each for each in arguments]
    for each in fixed:
        if isinstance(each, np.ndarray):
            each.flags.writeable = False
    try:
        return called(function, f"{name} of {type(given).__name__}", *fixed)
    except ValueError as error:
        if "read-only" not in str(error):
            raise
        raise ValueError(
            f"expected {name} of {given!r} to leave its arguments unchanged, given one that "
            f"changes them: write {advice}"
        ) from error


def functions_by_name(name: str, given: Any) -> dict[str, Any]:
    """Check that an argument is a mapping from names to functions. Local.

    Args:
        name: Name of the argument.
        given: Its value.

    Returns:
        The functions by name.

    Raises:
        TypeError: The value is not a mapping, or a value not a function.
    """
    if not isinstance(given, Mapping):
        raise TypeError(f"expected {name} as a dict of functions by name, given {kind_of(given)}")
    for key, function in given.items():
        if not callable(function):
            raise TypeError(f"expected a function as {name}[{key!r}], given {function!r}")
    return dict(given)


def instances(kind: type[Any], items: Iterable[Any]) -> tuple[Any, ...]:
    """Check that all items of a list are of one class. Local.

    Args:
        kind: The class.
        items: The list, or anything else to iterate over.

    Returns:
        The items.

    Raises:
        TypeError: The items are not a list, or one of them is of another class.
    """
    if isinstance(items, kind) or not isinstance(items, Iterable):
        raise TypeError(f"expected a list of {kind.__name__}, given {kind_of(items)}")
    items = tuple(items)
    for item in items:
        if not isinstance(item, kind):
            raise TypeError(f"expected {with_article(kind.__name__)}, given {kind_of(item)}")
    return items


def real(name: str, value: Any) -> float:
    """Check that a value is a number, finite or not. Local.

    Args:
        name: Name of the number in error messages.
        value: The value to check.

    Returns:
        The number.

    Raises:
        TypeError: The value is not a real number.
    """
    if not isinstance(value, Real):
        raise TypeError(f"expected a number for {name}, given {value!r}")
    return float(value)


def finite(name: str, value: Any) -> float:
    """Check that a value is a finite number. Local.

    Arguments and result as for `real`.

    Raises:
        TypeError: The value is not a real number.
        ValueError: It is not finite.
    """
    number = real(name, value)
    if not math.isfinite(number):
        raise ValueError(f"expected a finite number for {name}, given {value}")
    return number


def nonnegative(name: str, value: Any) -> float:
    """Check that a value is a finite number >= 0. Local.

    Arguments and result as for `real`.

    Raises:
        TypeError: The value is not a real number.
        ValueError: It is not finite, or below 0.
    """
    number = real(name, value)
    if not (math.isfinite(number) and number >= 0):
        raise ValueError(f"expected {name} >= 0, given {value}")
    return number


def positive(name: str, value: Any) -> float:
    """Check that a value is a finite number > 0. Local.

    Arguments and result as for `real`.

    Raises:
        TypeError: The value is not a real number.
        ValueError: It is not finite, or not above 0.
    """
    number = real(name, value)
    if not (math.isfinite(number) and number > 0):
        raise ValueError(f"expected {name} > 0, given {value}")
    return number


def chosen_times(values: Any) -> tuple[float, ...]:
    """Check that a value is a list of finite times [s], and sort them. Local.

    Raises:
        TypeError: The value is not a list of numbers.
        ValueError: A time is not finite.
    """
    times = real_array("times", values)
    if times.ndim != 1:
        raise TypeError(f"expected a list of times, such as [0.1, 0.2], given {values!r}")
    if not np.all(np.isfinite(times)):
        raise ValueError(f"expected finite times, given {values!r}")
    return tuple(map(float, np.sort(times)))


def whole(name: str, value: Any) -> int:
    """Check that a value is an integer of at least 1. Local.

    Arguments as for `real`.

    Returns:
        The integer.

    Raises:
        TypeError: The value is not an integer.
        ValueError: It is below 1.
    """
    if not isinstance(value, Integral):
        raise TypeError(f"expected an integer for {name}, given {value!r}")
    if value < 1:
        raise ValueError(f"expected {name} >= 1, given {value}")
    return int(value)


def real_array(name: str, value: Any) -> Floats:
    """Check that a value consists of real numbers, finite or not. Local.

    Args:
        name: Name of the numbers in error messages.
        value: A number, a list or an array.

    Returns:
        The numbers.

    Raises:
        TypeError: The value contains something else, such as complex numbers or text.
    """
    array = np.asarray(value)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"expected real numbers for {name}, given {reprlib.repr(value)}")
    return array.astype(np.float64)
