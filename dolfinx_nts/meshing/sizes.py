"""Checks of the dimensions of round bodies. Local."""

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
        ValueError: A number is less than ``least``.
    """
    if min(numbers) < least:
        raise ValueError(f"expected at least {least} cells, given {numbers}")
