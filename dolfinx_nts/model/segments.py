"""Geometry of segments: area, normal, diameter, corners."""

import itertools

import numpy as np

from dolfinx_nts.common.arrays import Floats

__all__ = ["NEIGHBOURS", "area_vectors", "diameters"]

# Neighbours of each corner of a segment in Basix order, by its number of vertices.
NEIGHBOURS = {3: [(1, 2), (2, 0), (0, 1)], 4: [(1, 2), (0, 3), (0, 3), (1, 2)]}


def area_vectors(vertices: Floats, orientation: Floats) -> Floats:
    """Area vectors of segments: area times mean unit normal. Local.

    Args:
        vertices: Positions in Basix order, shape ``(s, k, 3)`` [m].
        orientation: Orientations of the segments as in `Surface`, ``(s,)``.

    Returns:
        Vectors that point out of the body, shape ``(s, 3)`` [m^2], for edges in the plane [m].
    """
    first = vertices[:, -1] - vertices[:, 0]
    if vertices.shape[1] == 2:
        along: Floats = orientation[:, None] * np.cross(first, [0.0, 0.0, 1.0])
        return along
    second = vertices[:, 2] - vertices[:, 1]
    # Half the cross product of the diagonals of a quadrilateral or of two edges of a triangle.
    if vertices.shape[1] == 3:
        first, second = vertices[:, 1] - vertices[:, 0], first
    # Written out, as `np.cross` takes twice as long.
    (a, b, c), (d, e, f) = first.T, second.T
    cross = np.column_stack([b * f - c * e, c * d - a * f, a * e - b * d])
    vectors: Floats = orientation[:, None] * cross / 2
    return vectors


def diameters(x: Floats) -> Floats:
    """Longest distance between two vertices of each segment. Local.

    Args:
        x: Positions of the vertices, shape ``(s, k, 3)`` [m].

    Returns:
        Distances, shape ``(s,)`` [m].
    """
    squared: Floats = np.zeros(len(x))
    for one, other in itertools.combinations(range(x.shape[1]), 2):
        edge = x[:, one] - x[:, other]
        np.maximum(squared, np.einsum("si,si->s", edge, edge), out=squared)
    lengths: Floats = np.sqrt(squared)
    return lengths
