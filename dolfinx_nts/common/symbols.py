"""Check that users' functions do not convert UFL constants to Python numbers."""

from collections.abc import Callable
from typing import Any

__all__ = ["Symbol", "call_with_symbols"]


class Symbol:
    """Mixin of UFL constants that records their conversion to a Python number.

    ``math.sin`` of a constant would give the sine of its present value once and for all. UFL would
    search endlessly for the value of a constant that has none. The mixin is the last base, since
    FFCx looks for the kind of a constant among the first bases.

    Attributes:
        was_taken: Whether Python has converted the constant to a number.
    """

    was_taken = False

    def __float__(self) -> float:
        self.was_taken = True
        return 0.0


def call_with_symbols(
    what: str, function: Callable[..., Any], *arguments: Any, symbol: Symbol
) -> Any:
    """Call a user's function of UFL expressions. Local.

    Args:
        what: Name of the result of the function, for messages.
        function: The function.
        *arguments: Its arguments, of which some contain the symbol.
        symbol: The symbol.

    Returns:
        Its result.

    Raises:
        TypeError, ValueError: The function has failed with such an error, or converts the symbol to
        a number.
    """
    hint = (
        f"{what} is a UFL expression of its arguments: instead of functions of math and NumPy, "
        "min, max and if, use ufl.sin, ufl.exp, ufl.ln, ufl.max_value, ufl.conditional"
    )
    symbol.was_taken, failure = False, None
    try:
        result = function(*arguments)
    except (TypeError, ValueError) as error:
        failure = error
    if symbol.was_taken:
        raise TypeError(f"expected no conversion of an argument to a number; {hint}") from failure
    if failure is not None:
        raise type(failure)(f"{failure} ({hint})") from failure
    return result
