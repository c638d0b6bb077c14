"""Kernels of closed boundaries: points inside, depths, and crossings of paths."""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from reference.bulk import rotation

pytestmark = pytest.mark.serial

ROUNDING = 1e3 * np.finfo(float).eps
# Direction of the rays of the kernel in a box whose nearest side is where x is greatest.
RAY = np.array([0.8331541, 0.4819027, 0.2713465])
BOX = np.array([[[-9.0, -9.0, -9.0]], [[3.0, 9.0, 9.0]]])
CORNERS = np.array(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], indexing="ij")).reshape(3, -1).T


class Boundary:
    """A boundary of triangles alone, shape (t, 3, 3)."""

    def __init__(self, triangles, box=None):
        """Number the vertices; rays end outside the given box, or the box of the triangles."""
        rows = np.arange(3 * len(triangles), dtype=np.int32)
        self._kernels = _kernels.Boundaries([rows], [rows.reshape(-1, 3)])
        self._kernels.move(np.ascontiguousarray(triangles).reshape(-1, 3))
        self.box = self._kernels.extents() * [[[1]], [[-1]]] if box is None else box

    def crossings(self, points):
        count, at_an_edge = self._kernels.crossings(points, which(points), self.box)
        return count, at_an_edge.astype(bool)

    def winding(self, points):
        return self._kernels.winding(points, which(points))

    def distance(self, points, least=None, crossings=None):
        least = np.zeros(len(points)) if least is None else least
        crossings = np.ones((2, len(points)), np.int32) if crossings is None else crossings
        return self._kernels.distance(points, which(points), least, crossings)

    def cuts(self, paths):
        return self._kernels.cuts(paths, which(paths))


def which(points):
    """All points belong to the first boundary."""
    return np.zeros(len(points), dtype=np.int32)


def box():
    """Triangles of the unit cube in outward sense, shape (12, 3, 3)."""
    triangles = []
    for axis in range(3):
        for side in (0.0, 1.0):
            a, b, c, d = CORNERS[CORNERS[:, axis] == side]
            for triangle in ((a, b, c), (b, d, c)):
                normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
                outward = normal[axis] * (side - 0.5) > 0
                triangles.append(triangle if outward else triangle[::-1])
    return np.array(triangles)


def crumpled(rng, n=6):
    """A sphere of triangles whose vertices are moved at random, not convex, (t, 3, 3)."""
    theta, phi = np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, 2 * n + 1)
    radius = rng.uniform(0.4, 1.0, (n + 1, 2 * n + 1))
    radius[:, -1], radius[0], radius[-1] = radius[:, 0], radius[0, 0], radius[-1, 0]
    t, p = np.meshgrid(theta, phi, indexing="ij")
    directions = [np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)]
    x = radius[..., None] * np.stack(directions, axis=-1)
    x[:, -1] = x[:, 0]
    x[0], x[-1] = x[0, 0], x[-1, 0]
    a, b, c, d = x[:-1, :-1], x[1:, :-1], x[1:, 1:], x[:-1, 1:]
    quads = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)])
    return np.ascontiguousarray(quads.reshape(-1, 3, 3))


def winding(points, triangles):
    """Winding number of triangles around points, by solid angles."""
    a, b, c = np.moveaxis(triangles[None] - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(r, axis=2) for r in (a, b, c))
    dot = np.einsum
    up = dot("pti,pti->pt", a, np.cross(b, c))
    down = la * lb * lc + dot("pti,pti->pt", a, b) * lc
    down += dot("pti,pti->pt", b, c) * la + dot("pti,pti->pt", c, a) * lb
    return np.arctan2(up, down).sum(axis=1) / (2 * np.pi)


def test_rays_and_solid_angles_agree_with_solid_angles_in_numpy(rng):
    triangles = crumpled(rng)
    points = rng.uniform(-1, 1, (2000, 3))
    expected = winding(points, triangles)
    boundary = Boundary(triangles)
    np.testing.assert_allclose(boundary.winding(points), expected, atol=1e-9)
    count, at_an_edge = boundary.crossings(points)
    assert not at_an_edge.any()
    np.testing.assert_array_equal(count, np.round(expected))
    assert 200 < np.count_nonzero(count) < 1800


def test_parts_of_a_boundary_add_up(rng):
    triangles, points = crumpled(rng), rng.uniform(-1, 1, (500, 3))
    whole = Boundary(triangles)
    parts = [Boundary(t, whole.box) for t in (triangles[::3], triangles[1::3], triangles[2::3])]
    count = sum(part.crossings(points)[0] for part in parts)
    np.testing.assert_array_equal(count, whole.crossings(points)[0])
    angle = sum(part.winding(points) for part in parts)
    np.testing.assert_allclose(angle, whole.winding(points), atol=1e-12)
    distance = np.min([part.distance(points) for part in parts], axis=0)
    np.testing.assert_array_equal(distance, whole.distance(points))


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_a_ray_that_hits_an_edge_or_a_vertex_says_so(turn, rng):
    Q = rotation(np.array([1.0, 2.0, 0.5]), turn)
    boundary = Boundary(box() @ Q.T, BOX)
    edge = np.column_stack([rng.uniform(0.1, 0.9, 20), np.ones(20), np.ones(20)]) @ Q.T
    diagonal = np.array([[0.5, 0.5, 1.0]]) @ Q.T
    for hit in (edge, CORNERS[-1:] @ Q.T, diagonal):
        points = hit - rng.uniform(0.05, 0.3, (len(hit), 1)) * RAY
        _, at_an_edge = boundary.crossings(points)
        inside = ((points @ Q > 0) & (points @ Q < 1)).all(axis=1)
        assert at_an_edge[inside].all() and inside.any()
        np.testing.assert_allclose(boundary.winding(points[inside]), 1, atol=ROUNDING)


def test_the_distance_agrees_with_the_nearest_of_many_points_of_the_triangles(rng):
    triangles, points = crumpled(rng, n=3), rng.uniform(-1, 1, (200, 3))
    s, t = (a.ravel() for a in np.meshgrid(*2 * [np.linspace(0, 1, 41)]))
    s, t = s[s + t <= 1], t[s + t <= 1]
    phi = np.array([1 - s - t, s, t])
    samples = np.einsum("kp,tki->tpi", phi, triangles).reshape(-1, 3)
    nearest = np.min([np.linalg.norm(points - y, axis=1) for y in samples], axis=0)
    spacing = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max() / 40
    distance = Boundary(triangles).distance(points)
    assert np.all(distance <= nearest + ROUNDING)
    assert np.all(np.hypot(distance, spacing) >= nearest)


def test_the_distance_from_a_cube_is_exact(rng):
    points = rng.uniform(-1, 2, (300, 3))
    beside = np.linalg.norm(points - points.clip(0, 1), axis=1)
    within = np.minimum(points, 1 - points).min(axis=1)
    expected = np.where(within > 0, within, beside)
    np.testing.assert_allclose(Boundary(box()).distance(points), expected, atol=ROUNDING)


def test_paths_are_cut_where_they_enter_and_leave_a_cube():
    begin = np.array([[0.3, 0.4, -1.0], [0.3, 0.4, 0.5], [0.3, 0.4, 2.0], [3.0, 3.0, 3.0]])
    end = np.array([[0.3, 0.4, 3.0], [0.3, 0.4, 1.5], [0.3, 0.4, 5.0], [4.0, 3.0, 3.0]])
    paths = np.hstack([begin, end])
    path, place = Boundary(box()).cuts(paths)
    order = np.lexsort((place, path[:, 0]))
    np.testing.assert_array_equal(path[order], [[0, -1], [0, 1], [1, 1]])
    np.testing.assert_allclose(place[order], [0.25, 0.5, 0.5], atol=ROUNDING)
    number = np.arange(10, 14, dtype=np.int32)
    order = order[::-1]
    points, number = _kernels.points_on_paths(paths, number, path[order], place[order])
    np.testing.assert_array_equal(number, [10, 11])
    np.testing.assert_allclose(points, [[0.3, 0.4, 0.5], [0.3, 0.4, 0.75]], atol=ROUNDING)


def test_parts_of_paths_that_may_be_inside_are_known_by_their_ends():
    """Between x = 0 and 1, with cuts through triangles and edges of them; and a point."""
    paths = np.array([[0.0, 0, 0, 1, 0, 0]] * 4 + [[0.3] * 6])
    cuts = [(0, 1, 0.5), (1, -1, 0.5), (2, 0, 0.5), (3, 1, 0.2), (3, -1, 0.4), (3, 0, 0.8)]
    path, side, place = zip(*cuts, strict=True)
    path = np.column_stack([path, side]).astype(np.int32)
    number = np.arange(5, dtype=np.int32)
    points, number = _kernels.points_on_paths(paths, number, path, np.array(place))
    np.testing.assert_array_equal(number, [4, 0, 1, 2, 2, 3, 3, 3])
    expected = [0.3, 0.25, 0.75, 0.25, 0.75, 0.1, 0.6, 0.9]
    np.testing.assert_allclose(points[:, 0], expected, atol=ROUNDING)


def test_boundaries_come_nearer_by_the_difference_of_their_displacements(rng):
    x, moved = rng.uniform(size=(2, 9, 3))
    rows = np.arange(9, dtype=np.int32).reshape(3, 3)
    boundaries = _kernels.Boundaries([r.ravel() for r in rows], [r[None] for r in rows])
    nearer = _kernels.approach(boundaries.displacements(moved, x))
    moves = (moved - x)[rows]
    for i, j in np.ndindex(3, 3):
        apart = np.abs(moves[i][:, None] - moves[j]).max(axis=(0, 1))
        assert nearer[i, j] == pytest.approx(np.linalg.norm(apart) if i != j else 0.0, rel=1e-14)


def test_only_distances_of_interest_are_exact(rng):
    boundary, points = Boundary(box()), rng.uniform(-1, 2, (300, 3))
    exact = boundary.distance(points)
    found = boundary.distance(points, np.full(300, 0.2))
    np.testing.assert_array_equal(found[exact > 0.2], exact[exact > 0.2])
    assert np.all(found[exact <= 0.2] <= 0.2)
    crossings = boundary._kernels.crossings(points, which(points), boundary.box)
    inside = (points.clip(0, 1) == points).all(axis=1)
    found = boundary.distance(points, crossings=crossings)
    np.testing.assert_array_equal(found[inside], exact[inside])
    assert inside.any() and not found[(crossings <= 0).all(axis=0)].any()


def test_nodes_and_edges_whose_boxes_meet_a_box_are_found(rng):
    x, edges = rng.uniform(size=(40, 3)), rng.integers(0, 40, (30, 2), dtype=np.int32)
    nodes = np.arange(0, 40, 3, dtype=np.int32)
    region = np.array([[0.2, 0.4, 0.3], [0.6, 0.7, 0.9]])
    ends = x[np.concatenate([np.column_stack([nodes, nodes]), edges])]
    meets = (ends.min(axis=1) <= region[1]) & (ends.max(axis=1) >= region[0])
    expected = ends[meets.all(axis=1)].reshape(-1, 6)
    which, regions = np.array([0, 1], np.int32), np.array([region + 9, region])
    lists = [nodes[:1], nodes], [edges[:1], edges]
    found, number = _kernels.paths_in(x, *lists, which, regions)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(number, np.ones(len(expected)))


def test_without_triangles_nothing_is_inside():
    boundary, points = Boundary(np.empty((0, 3, 3))), np.zeros((2, 3))
    count, at_an_edge = boundary.crossings(points)
    assert not count.any() and not at_an_edge.any() and not boundary.winding(points).any()
    assert np.isinf(boundary.distance(points)).all()
    assert not len(boundary.cuts(np.hstack([points, points + 1]))[0])


def test_triangles_without_area_change_nothing(rng):
    triangles, points = box(), rng.uniform(-0.2, 1.2, (300, 3))
    needle = np.array([[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.5, 0.5, 0.5]]])
    plain = Boundary(triangles)
    with_needle = Boundary(np.concatenate([triangles, needle]))
    for name in ("crossings", "winding"):
        np.testing.assert_allclose(
            getattr(with_needle, name)(points), getattr(plain, name)(points), atol=ROUNDING
        )


def test_rays_go_to_the_nearest_side_whatever_it_is(rng):
    triangles = crumpled(rng)
    points = rng.uniform(-1, 1, (50, 3))
    expected = np.round(winding(points, triangles))
    for axis in range(3):
        for side in (0, 1):
            far = np.array([[[-9.0, -9.0, -9.0]], [[9.0, 9.0, 9.0]]])
            far[side, 0, axis] /= 8
            np.testing.assert_array_equal(Boundary(triangles, far).crossings(points)[0], expected)


def test_boundaries_are_where_they_have_moved():
    """Two cubes; the first moves by two."""
    x = np.concatenate([box().reshape(-1, 3), box().reshape(-1, 3) + 5])
    rows = np.arange(len(x), dtype=np.int32).reshape(2, -1, 3)
    boundaries = _kernels.Boundaries([r.ravel() for r in rows], list(rows))
    points, where = np.array([[0.5, 0.4, 0.3], [5.5, 5.4, 5.3]]), np.array([0, 1], np.int32)
    boundaries.move(x)
    np.testing.assert_allclose(boundaries.winding(points, where), [1, 1])
    moved = x.copy()
    moved[: len(x) // 2] += [2.0, 0.0, 0.0]
    boundaries.move(moved)
    np.testing.assert_allclose(boundaries.winding(points, where), [0, 1], atol=ROUNDING)
    np.testing.assert_array_equal(boundaries.extents()[0], [[2, 0, 0], [5, 5, 5]])
    np.testing.assert_array_equal(-boundaries.extents()[1], [[3, 1, 1], [6, 6, 6]])
    moved[-1] -= 1.0
    least, negative_greatest = boundaries.displacements(moved, x)
    np.testing.assert_array_equal(least, [[2, 0, 0], [-1, -1, -1]])
    np.testing.assert_array_equal(-negative_greatest, [[2, 0, 0], [0, 0, 0]])


def test_wrong_arguments_are_refused():
    rows = np.arange(36, dtype=np.int32)
    boundaries = _kernels.Boundaries([rows], [rows.reshape(-1, 3)])
    with pytest.raises(ValueError, match="expected an earlier call of move"):
        boundaries.extents()
    with pytest.raises(ValueError, match="x: expected a row for each node of the boundaries"):
        boundaries.move(np.zeros((35, 3)))
    boundary = Boundary(box())
    with pytest.raises(ValueError, match=r"points: expected shape \(any, 3\)"):
        boundary.distance(np.zeros((2, 2)))
    with pytest.raises(ValueError, match=r"paths: expected shape \(any, 6\)"):
        boundary.cuts(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="where: expected numbers of boundaries"):
        boundaries.winding(np.zeros((1, 3)), np.array([1], np.int32))
