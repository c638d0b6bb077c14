"""Crossing edges, and the equivalent pair of a point and a triangle.

The gap of two edges is the distance of their lines. It equals the distance of a point from the
plane of a triangle: with ends a_1, a_2 and b_1, b_2

    g = (a_1 - b_1) . n,  n along (a_2 - a_1) x (b_2 - b_1)

is the distance of a_1 from the triangle b_1, b_1 + a_2 - a_1, b_2. These positions are linear in
the nodes, with weights of sum one. The conservation properties of the kernels for triangles
therefore carry over: forces are distributed with the transposed weights.
"""

from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.common.vectors import cross

__all__ = ["WEIGHTS", "Crossing"]

# Weights of the nodes a_1, a_2, b_1, b_2 in the point and the corners of the triangle (rows).
WEIGHTS = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [-1.0, 1.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


class Crossing(NamedTuple):
    """Gap, normal and nearest points of pairs of edges.

    Attributes:
        gap: Gap with the normal along the product of both edges, shape ``(m,)`` [m].
        normal: Unit normals, shape ``(m, 3)``.
        places: Coordinates of the nearest points on both edges, from 0 to 1, ``(m, 2)``.
        sine: Sine of the angle between the edges, shape ``(m,)``.
    """

    gap: Floats
    normal: Floats
    places: Floats
    sine: Floats

    @classmethod
    def of(cls, a: Floats, b: Floats) -> "Crossing":
        """Crossing of each edge a with an edge b, given by their ends, both ``(m, 2, 3)`` [m]."""
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
