"""Checks of the dimensions of round bodies. Local."""

from numbers import Integral

__all__ = ["check_cells", "check_radii"]


def check_radii(inner: float, outer: float) -> None:
    """Check inner and outer radius [m].

    Raises:
        ValueError: The radii are not positive and ascending.
    """
    if not 0 < inner < outer:
        raise ValueError(f"expected 0 < inner < outer radius, given {inner}, {outer}")


def check_cells(*numbers: int, least: int = 1) -> None:
    """Check numbers of cells.

    Raises:
        TypeError: A number is not an integer.
        ValueError: A number is less than ``least``.
    """
    if not all(isinstance(number, Integral) for number in numbers):
        raise TypeError(f"expected integers as numbers of cells, given {numbers}")
    if min(numbers) < least:
        raise ValueError(f"expected at least {least} cells, given {numbers}")
