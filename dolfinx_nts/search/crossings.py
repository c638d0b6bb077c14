"""How two edges cross, and the point and the triangle that stand for them.

Two edges are as far apart as the lines on which they lie. That distance is the one of a point
from the plane of a triangle: with ends a_1, a_2 and b_1, b_2

    g = (a_1 - b_1) . n,  n along (a_2 - a_1) x (b_2 - b_1)

is that of a_1 from the triangle of b_1, b_1 + a_2 - a_1 and b_2. All of these are linear in the
nodes, with weights of sum one, so that whatever the kernels of triangles conserve they conserve
here: work, forces and moments carry over with the transposed weights.
"""

from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.common.vectors import cross

__all__ = ["WEIGHTS", "Crossing"]

# The point and the corners of the triangle (rows), by the nodes a_1, a_2, b_1, b_2 of a pair.
WEIGHTS = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [-1.0, 1.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


class Crossing(NamedTuple):
    """How edges cross: gap for the normal along their product, places, and angles.

    Attributes:
        gap: Shape ``(m,)`` [m].
        normal: Unit vectors, shape ``(m, 3)``.
        places: Where the nearest points are on both edges, from 0 to 1, ``(m, 2)``.
        sine: Of the angle between the edges, shape ``(m,)``.
    """

    gap: Floats
    normal: Floats
    places: Floats
    sine: Floats

    @classmethod
    def of(cls, a: Floats, b: Floats) -> "Crossing":
        """Cross edges by their ends, both ``(m, 2, 3)`` [m]."""
        first, second, between = a[:, 1] - a[:, 0], b[:, 1] - b[:, 0], b[:, 0] - a[:, 0]
        product = cross(first, second)
        area = np.linalg.norm(product, axis=1)
        lengths = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
        tiny = np.finfo(float).tiny
        square = np.maximum(area**2, tiny)
        places = [
            np.einsum("mi,mi->m", cross(between, along), product) / square
            for along in (second, first)
        ]
        normal = product / np.maximum(area, tiny)[:, None]
        gap = -np.einsum("mi,mi->m", between, normal)
        sine = area / np.maximum(lengths, tiny)
        return cls(gap, normal, np.column_stack(places), sine)

    def take(self, some: Ints | Flags) -> "Crossing":
        """Select some of the pairs."""
        return Crossing(*(values[some] for values in self))
