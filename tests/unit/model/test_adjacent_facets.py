"""Facets that are equally near to a point, against distances by the NumPy twin."""

import numpy as np
import pytest

from dolfinx_nts.model.obstacles.adjacent_facets import AdjacentFacets
from reference import nts

pytestmark = pytest.mark.serial

DIAMETER = np.sqrt(2)  # of the facets below [m]


def grid(cell, height):
    """Vertices ``(16, 3)``, facets and orientation of 3 x 3 squares of 1 m, z by ``height``."""
    y, x = np.indices((4, 4)).reshape(2, 16).astype(float)
    points = np.stack([x, y, height(x, y)], axis=1)
    number = np.arange(16).reshape(4, 4)
    squares = [number[j : j + 2, i : i + 2].ravel() for j in range(3) for i in range(3)]
    if cell == 4:
        return points, np.array(squares, dtype=np.int32), np.ones(9)
    halves = [square[half] for square in squares for half in ([0, 1, 2], [3, 1, 2])]
    return points, np.array(halves, dtype=np.int32), np.tile([1.0, -1.0], 9)


def found(adjacent, points, x, facet):
    """Facets at the same distance as the given facet, by points."""
    size = np.full(len(facet), DIAMETER)
    row, other = adjacent.as_near(points, x, np.array(facet, dtype=np.int32), size)
    return [sorted(other[row == number].tolist()) for number in range(len(facet))]


@pytest.mark.parametrize("cell", [3, 4])
def test_points_above_vertices_and_edges_have_all_facets_at_the_same_distance(cell):
    x, facets, orientation = grid(cell, lambda a, b: 0.05 * np.cos(2 * a) * b)
    adjacent = AdjacentFacets(facets, orientation)
    edge = (x[5] + x[6]) / 2
    points = np.array([x[5], edge, edge + np.array([0.01, 0.02, 0.3]), x[facets[0]].mean(axis=0)])
    points[:2, 2] -= 1e-10  # round-off
    for point in points:
        distances = np.array([nts.distance(np.vstack((point, x[facet]))) for facet in facets])
        nearest = np.flatnonzero(distances <= distances.min() + 1e-8)
        expected = nearest.tolist() if len(nearest) > 1 else []
        assert found(adjacent, point[None], x, nearest[:1]) == [expected]


def test_facets_beyond_a_sharp_edge_and_of_other_groups_are_not_as_near():
    x, facets, orientation = grid(4, lambda a, b: -np.maximum(a - 1, 0.0))
    above = x[[5, 6]]
    # The surface turns by 45 degrees at x = 1, not at x = 2.
    assert found(AdjacentFacets(facets, orientation), above, x, [0, 1]) == [[0, 3], [1, 2, 4, 5]]
    groups = np.array([0, 3, 9], dtype=np.int32)
    assert found(AdjacentFacets(facets, orientation, groups), above, x, [0, 1]) == [[], [1, 2]]
