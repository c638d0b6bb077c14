"""Order of convergence that the results of three steps show."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

__all__ = ["observed_order"]


def observed_order(steps: Sequence[float], results: Sequence[npt.NDArray[np.float64]]) -> float:
    """Observed order p of an error c h^p, from three step sizes and an unknown limit.

    Args:
        steps: Three steps h, each shorter than the one before.
        results: What comes out with each.

    Returns:
        The order, between 0 and 6.
    """
    *distances, _ = (np.linalg.norm(result - results[-1]) for result in results)
    orders = np.linspace(0.001, 6.0, 6000)
    first, second, third = (step**orders for step in steps)
    ratios = (first - third) / (second - third)
    return float(np.interp(distances[0] / distances[1], ratios, orders))
