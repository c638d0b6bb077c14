"""Facets that are equally near to a point, and points behind facets of convex bodies."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

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


@pytest.mark.parametrize("height", [0.1, -0.1])
def test_facets_across_the_apex_of_a_blunt_pyramid_count_from_any_of_them(height):
    # Normals of opposite facets differ by 31 degrees, of adjacent ones by 22 degrees.
    slope = np.tan(np.radians(15.5))
    x = np.array([[0, 0, slope], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], dtype=float)
    x[1:] @= np.array([[1, 1, 0], [-1, 1, 0], [0, 0, 1]], dtype=float)
    facets = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]], dtype=np.int32)
    adjacent = AdjacentFacets(facets, np.ones(4))
    point = np.array([[0.0, 0.0, slope + height]])
    for own in range(4):
        assert found(adjacent, point, x, [own]) == [[0, 1, 2, 3]]


def test_facets_beyond_a_sharp_edge_and_of_other_groups_are_not_as_near():
    x, facets, orientation = grid(4, lambda a, b: -np.maximum(a - 1, 0.0))
    above = x[[5, 6]]
    # The surface turns by 45 degrees at x = 1, not at x = 2.
    assert found(AdjacentFacets(facets, orientation), above, x, [0, 1]) == [[0, 3], [1, 2, 4, 5]]
    groups = np.array([0, 3, 9], dtype=np.int32)
    assert found(AdjacentFacets(facets, orientation, groups), above, x, [0, 1]) == [[], [1, 2]]


def outward(points, facets):
    """Orientation of facets of a convex body about the mean of its points."""
    corners = points[facets]
    if facets.shape[1] == 2:
        edge = corners[:, 1] - corners[:, 0]
        normal = np.stack([edge[:, 1], -edge[:, 0], 0 * edge[:, 0]], axis=1)
    else:
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    away = corners.mean(axis=1) - points.mean(axis=0)
    return np.sign(np.einsum("si,si->s", normal, away)), normal


def bodies(rng, kind):
    """Vertices and facets of a convex body with edges far above 30 degrees."""
    if kind == "triangle":
        points = np.array([[0.0, 0, 0], [1, 0, 0], [0.3, 1, 0]]) + rng.uniform(0, 0.2, (3, 3))
        points[:, 2] = 0
        return points, np.array([[0, 1], [1, 2], [2, 0]], dtype=np.int32)
    if kind == "tetrahedron":
        points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        points += rng.uniform(0, 0.2, (4, 3))
        return points, ConvexHull(points).simplices.astype(np.int32)
    points = np.array(list(np.ndindex(2, 2, 2)), dtype=float) * rng.uniform(0.5, 2, 3)
    sides = [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 4, 5], [2, 3, 6, 7], [0, 2, 4, 6], [1, 3, 5, 7]]
    return points, np.array(sides, dtype=np.int32)


@pytest.mark.parametrize("kind", ["triangle", "tetrahedron", "box"])
def test_points_belong_to_the_adjacent_facet_below_which_they_are_less_deep(kind, rng):
    num_flagged = 0
    for _ in range(20):
        x, facets = bodies(rng, kind)
        orientation, normal = outward(x, facets)
        normal *= (orientation / np.linalg.norm(normal, axis=1))[:, None]
        points = rng.uniform(x.min(axis=0) - 0.5, x.max(axis=0) + 0.5, (200, 3))
        if kind == "triangle":
            points[:, 2] = 0
        facet = rng.integers(len(facets), size=len(points)).astype(np.int32)
        # Heights above all planes: a point of a convex body is below all of them.
        heights = np.einsum("psi,si->ps", points[:, None] - x[facets[:, 0]], normal)
        shared = (facets[:, None, :, None] == facets[None, :, None]).sum(axis=(2, 3))
        meet = shared[facet] == (1 if kind == "triangle" else 2)
        own = heights[np.arange(len(points)), facet]
        right = (own < 0) & (meet & (heights > own[:, None])).any(axis=1)
        flags = AdjacentFacets(facets, orientation).are_nearer_to_adjacent(points, x, facet)
        np.testing.assert_array_equal(flags, right)
        num_flagged += np.count_nonzero(flags)
    assert num_flagged > 200


def test_edges_of_less_than_30_degrees_and_concave_ones_separate_nothing():
    for height, flagged in ((0.1, False), (-0.1, False), (1.0, False), (-1.0, True)):
        # Two facets that meet at x = 1, the second one falling to -height or rising.
        x = np.array([[0.0, 0, 0], [1, 0, 0], [2, height, 0]])
        facets = np.array([[0, 1], [1, 2]], dtype=np.int32)
        _, normal = outward(x, facets)
        up = np.sign(normal[:, 1])  # outward is up
        beyond = np.array([[1.5, -0.01, 0.0]])
        adjacent = AdjacentFacets(facets, up)
        flags = adjacent.are_nearer_to_adjacent(beyond, x, np.zeros(1, dtype=np.int32))
        assert flags[0] == flagged
