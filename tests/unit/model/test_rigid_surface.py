"""Rigid obstacle of facets: contact, orientation, and refused arguments."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.model.obstacles.facing import Facing

pytestmark = pytest.mark.at_most_two_ranks

ROUNDING = 1e3 * np.finfo(float).eps

schemes = pytest.mark.parametrize("scheme", ["conserving", "midpoint", "static"])


@pytest.mark.parametrize("k", [3, 4])
@schemes
def test_rigid_facets_are_segments_that_do_not_move(k, scheme, rng):
    corners = np.array([[0.0, 0, 0], [1, 0, 0.1], [0, 1, 0], [1, 1, 0.2]])[:k]
    surface = nts.RigidSurface(corners, [range(k)], [0.3, 0.3, 5.0])
    x_n = rng.uniform(0.1, 0.4, (9, 3))
    x = x_n + 0.1 * rng.normal(size=x_n.shape)
    values = surface.contact(scheme, x_n, x, np.zeros(9, dtype=np.int32))
    pairs = [np.concatenate([y[:, None], np.tile(corners, (9, 1, 1))], axis=1) for y in (x_n, x)]
    whole = getattr(_kernels, f"contact_{scheme}")(*pairs, np.ones(9))
    for part, full in zip(values, whole, strict=True):
        np.testing.assert_array_equal(part, full[tuple(slice(n) for n in part.shape)])
    if scheme == "conserving":
        work = np.einsum("mi,mi->m", values[2], x - x_n)
        np.testing.assert_allclose(work, values[1] - values[0], atol=ROUNDING)


def test_facets_turn_to_the_outside_whatever_their_sense(rng):
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    for facet in ([0, 1, 2], [0, 2, 1]):
        for side in (1.0, -1.0):
            surface = nts.RigidSurface(points, [facet], [0, 0, side])
            x = np.array([[0.2, 0.2, 0.1]])
            facet_found, gap = surface.find(
                x, np.array([-1], dtype=np.int32), 0.01, np.inf, Facing.everywhere(len(x))
            )
            gradient = surface.contact("static", x, x, facet_found)[3]
            np.testing.assert_allclose(gradient[0], [0, 0, side])
            np.testing.assert_allclose(gap[0], 0.1 * side)


def test_invalid_facets_are_refused():
    with pytest.raises(ValueError, match=r"shape \(s, 3\) or \(s, 4\)"):
        nts.RigidSurface([[0, 0, 0]], [[0, 0]], (0, 0, 1))
    with pytest.raises(ValueError, match="indices of points, from 0 to 0, given 0 to 2"):
        nts.RigidSurface([[0, 0, 0]], [[0, 1, 2]], (0, 0, 1))
    with pytest.raises(ValueError, match="expected facets with an area, in planes"):
        nts.RigidSurface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], (5, 5, 0))


SQUARE = np.array([[-1.0, -1, 0], [2, -1, 0], [2, 2, 0], [-1, 2, 0]])
BASIX, AROUND = [0, 1, 3, 2], [0, 1, 2, 3]


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("order", [BASIX, AROUND])
def test_corners_of_quadrilaterals_may_be_in_basix_order_or_around(order, sense, first):
    # A warped square that begins at any corner and turns in either sense.
    points = np.roll(SQUARE + np.outer([0.1, 0, 0.2, 0], [0, 0, 1]), first, axis=0)
    points = points[::sense]
    expected = nts.RigidSurface(points, [BASIX], (0.5, 0.5, 9.0))
    surface = nts.RigidSurface(points, [order], (0.5, 0.5, 9.0))
    np.testing.assert_array_equal(surface.corners, expected.corners)
    np.testing.assert_array_equal(surface.facets[1], [BASIX])
    x = np.array([[0.0, 0.1, 0.3], [1.7, 1.8, 0.3], [1.5, -0.5, 0.3]])
    none = np.full(3, -1, dtype=np.int32)
    found, gap = surface.find(x, none, 0.01, np.inf, Facing.everywhere(3))
    np.testing.assert_array_equal(found, 0)
    assert (0.1 <= gap).all() and (gap <= 0.3).all()


def test_a_corner_between_two_others_leaves_the_order_certain():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0.5, 0]])
    for order, loop in (([0, 1, 3, 2], AROUND), (AROUND, BASIX)):
        kept = nts.RigidSurface(points[order], [loop], (0.2, 0.2, 9.0))
        around = kept.corners[0][BASIX]
        areas = np.cross(np.roll(around, -1, axis=0) - around, np.roll(around, 1, axis=0) - around)
        assert (areas[:, 2] * areas[0, 2] >= 0).all()


def test_quadrilaterals_in_different_orders_or_not_convex_are_refused():
    points = np.concatenate([SQUARE, SQUARE + np.array([3, 0, 0])])
    with pytest.raises(ValueError, match="1 are convex in Basix order and 1 around; facet 1"):
        nts.RigidSurface(points, [BASIX, [4, 5, 6, 7]], (0, 0, 9))
    with pytest.raises(ValueError, match=r"gmsh, VTK, meshio.*0 are convex in Basix.*triangles"):
        nts.RigidSurface([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0.5, 0.5, 0]], [BASIX], (0, 0, 9))
    with pytest.raises(ValueError, match="0 are convex in Basix order and 0 around"):
        nts.RigidSurface(SQUARE, [[0, 2, 1, 3]], (0, 0, 9))


@pytest.mark.parametrize(("thickness", "expected"), [(2.0, 0.4), (0.5, 0.25)])
def test_nodes_touch_small_facets_down_to_a_given_depth_or_half_of_the_wall(thickness, expected):
    at = np.linspace(0.0, 1.0, 11)
    grid = np.array([[x, y, 0.0] for y in at for x in at])
    points = np.concatenate([grid, grid - [0.0, 0.0, thickness]])
    upper = [[i, i + 1, i + 12, i + 11] for i in range(109) if i % 11 < 10]
    facets = np.array([*upper, *(np.array(upper) + 121)])
    outside = np.repeat([[0.5, 0.5, 9.0], [0.5, 0.5, -9.0]], 100, axis=0)
    surface = nts.RigidSurface(points, facets, outside)
    below = np.array([[0.45, 0.45, -d] for d in (0.06, 0.2, 0.3)])
    np.testing.assert_allclose(surface.depth(below), [0.06, 0.0, 0.0], atol=ROUNDING)
    surface.deepen(0.4)
    assert surface.deepest == pytest.approx(expected, rel=1e-9)
    # The last point of a thin wall is nearer to its other side.
    nearest = [0.06, 0.2, min(0.3, thickness - 0.3)]
    np.testing.assert_allclose(surface.depth(below), nearest, rtol=1e-12)
