"""Evaluation of the signed distance of a user-defined obstacle."""

from typing import Any

import numpy as np

from dolfinx_nts.common.arguments import called_with_fixed
from dolfinx_nts.common.arrays import Floats

__all__ = ["signed_distance", "without_nan"]


def signed_distance(obstacle: Any, x: Floats) -> Any:
    """Call the method ``distance`` of an obstacle with positions that it cannot change. Local.

    Args:
        obstacle: The obstacle, an `ExactObstacle`.
        x: Positions in its frame, shape ``(m, 3)`` [m].

    Returns:
        Results of the method; arrays of integers are converted to floats.

    Raises:
        TypeError: The method takes other arguments.
        ValueError: It changes the positions, or returns arrays of another type than float64.
    """
    advice = "x = x - c instead of x -= c"
    found = called_with_fixed(obstacle.distance, "distance(x)", obstacle, advice, x)
    if not isinstance(found, tuple | list):
        return found
    return tuple(_as_floats(obstacle, each) for each in found)


def without_nan(obstacle: Any, gap: Floats, x: Floats) -> Floats:
    """Check that points have a distance. Local.

    Args:
        obstacle: The obstacle.
        gap: Their distances, shape ``(m,)`` [m].
        x: Their positions in the frame of the obstacle, shape ``(m, 3)`` [m]; points that are not
            finite, as in a diverged iteration, need no distance.

    Returns:
        The distances.

    Raises:
        ValueError: A distance is NaN.
    """
    if np.isnan(gap).any():
        lost = np.flatnonzero(np.isnan(gap) & np.isfinite(x).all(axis=1))
        if len(lost):
            at = ", ".join(f"{value:.4g}" for value in x[lost[0]] + 0.0)
            raise ValueError(
                f"expected a distance of each node from distance(x) of {obstacle!r}, given nan at "
                f"x = ({at}) m, in the frame of the obstacle: where the normal is not unique, it "
                "may be NaN, but not the distance"
            )
    return gap


def _as_floats(obstacle: Any, values: Any) -> Any:
    """Integer arrays as float64; arrays of float64 and other objects unchanged."""
    if not isinstance(values, np.ndarray) or values.dtype == np.float64:
        # A part of x would be read-only.
        is_fixed = isinstance(values, np.ndarray) and not values.flags.writeable
        return values.copy() if is_fixed else values
    if values.dtype.kind not in "iu":
        raise ValueError(
            f"expected arrays of type float64 from distance(x) of {obstacle!r}, given "
            f"{values.dtype}: forces need all digits"
        )
    return values.astype(np.float64)
