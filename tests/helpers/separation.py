"""Distance of two boxes by the separating axis theorem, independent of the contact code."""

import numpy as np

__all__ = ["separation"]

# Square of the sine below which two edges are parallel and span no axis.
_PARALLEL = 1e-12


def separation(first: np.ndarray, second: np.ndarray) -> float:
    """Greatest distance of two boxes along an axis, negative where they overlap. Local.

    A translation by the magnitude of a negative value separates the boxes; a positive value is
    a lower bound of their distance.

    Args:
        first: Corners of a rigid box in the order of the binary numbers, shape ``(8, 3)`` [m].
        second: Corners of another box, in the same order.

    Returns:
        The distance [m].
    """
    sides = [[box[i] - box[0] for i in (1, 2, 4)] for box in (first, second)]
    axes = [np.cross(s[i], s[j]) for s in sides for i, j in ((0, 1), (0, 2), (1, 2))]
    axes += [np.cross(a, b) for a in sides[0] for b in sides[1]]
    lengths = max(np.dot(s, s) for s in sides[0] + sides[1])
    distances = []
    for axis in axes:
        square = np.dot(axis, axis)
        if square < _PARALLEL * lengths**2:
            continue
        a, b = (box @ axis / np.sqrt(square) for box in (first, second))
        distances.append(max(a.min() - b.max(), b.min() - a.max()))
    return float(max(distances))
