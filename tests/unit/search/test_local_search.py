"""Local search: the segment of a node, compared with brute force over all segments."""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from dolfinx_nts.model.obstacles.facing import Facing
from reference import nts
from reference.bulk import rotation

pytestmark = pytest.mark.serial

EPS = np.finfo(float).eps
# Round-off of lengths of about one.
ROUNDING = 1e3 * EPS
# Sampling on a grid of 1/64 overestimates distances by its square over the distance; segments have
# size 0.3.
SAMPLING = 1e-3
# Tolerance of equal distances, relative to the longest segment.
TIE = 1e-9

# Parameters of the local search, in reference coordinates or segment diameters.
HYSTERESIS, OVERHANG, DEPTH = 0.01, 0.15, 0.5

# Nodes that are clearly over the sheet, and on both sides of it.
LOWER, UPPER = (0.15, 0.15, -0.1), (0.85, 0.85, 0.15)

segments_ = pytest.mark.parametrize("k", [3, 4], ids=["triangle", "quadrilateral"])


def bumpy_surface(k, n=6, height=0.08):
    """Curved sheet over [0, 1]^2: vertices (s, k, 3), orientation."""
    t = np.linspace(0, 1, n + 1)
    a, b = np.meshgrid(t, t, indexing="ij")
    c = height * np.sin(2 * np.pi * a) * np.cos(np.pi * b + 0.3)
    grid = np.stack([a, b, c], axis=-1)
    corners = [grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:]]
    quads = np.stack(corners, axis=2).reshape(-1, 4, 3)
    if k == 4:
        return quads, np.ones(len(quads))
    # The second triangle runs clockwise.
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [3, 1, 2]]]), np.repeat([1.0, -1.0], n * n)


def find(
    nodes,
    segments,
    orientation,
    *,
    current=None,
    reach=np.inf,
    key=None,
    slack=HYSTERESIS,
    dents=False,
):
    nodes = np.atleast_2d(np.asarray(nodes, dtype=np.float64))
    current = np.full(len(nodes), -1) if current is None else np.atleast_1d(current)
    key = np.arange(len(segments)) if key is None else np.asarray(key)
    vertices = np.arange(segments[..., 0].size, dtype=np.int32).reshape(segments.shape[:2])
    orientation = np.asarray(orientation, dtype=np.float64)
    kernel = _kernels.Segments(vertices, orientation, key.astype(np.int64))
    kernel.hold_in_dents(dents)
    where = current.astype(np.int32), slack, reach, segments.reshape(-1, 3)
    return kernel.pair(nodes, *where, *anything(nodes, segments))


def anything(nodes, segments):
    """Arguments with which nodes may touch any segment."""
    return *Facing.everywhere(len(nodes)).arguments, np.full(len(segments), np.inf)


def distances(node, segments):
    """Distance of a node to each segment, from many points of each."""
    t = np.linspace(0, 1, 65)
    r, s = (v.ravel() for v in np.meshgrid(t, t))
    if segments.shape[1] == 3:
        inside = r + s <= 1 + EPS
        r, s = r[inside], s[inside]
    if segments.shape[1] == 3:
        phi = np.array([1 - r - s, r, s])
    else:
        phi = np.array([(1 - r) * (1 - s), r * (1 - s), (1 - r) * s, r * s])
    points = np.einsum("kp,skc->spc", phi, segments)
    return np.linalg.norm(node - points, axis=2).min(axis=1)


@segments_
def test_node_gets_the_nearest_of_all_segments(k, rng):
    segments, orientation = bumpy_surface(k)
    turn = rotation([1, 2, 3], 0.8)
    nodes = rng.uniform(LOWER, UPPER, (60, 3)) @ turn.T
    segments = segments @ turn.T
    found = find(nodes, segments, orientation)
    assert np.all(found[0] >= 0)
    for node, segment in zip(nodes, found[0], strict=True):
        all_distances = distances(node, segments)
        assert all_distances[segment] <= all_distances.min() + SAMPLING


@segments_
@pytest.mark.parametrize("angle", [30, 3, 1, 0.1])
def test_nearest_of_slivers_is_found(k, angle, rng):
    segments, orientation = bumpy_surface(k, n=4)
    segments[..., 0] += segments[..., 1] / np.tan(np.deg2rad(angle))
    # Near edges a node need not project onto any segment.
    starts, ends = segments[rng.integers(len(segments), size=90), :2].swapaxes(0, 1)
    nodes = starts + rng.uniform(0, 1, (90, 1)) * (ends - starts)
    nodes += rng.uniform(-0.1, 0.1, nodes.shape)
    found = find(nodes, segments, orientation)[0]
    assert np.count_nonzero(found >= 0) > 20
    for node, segment in zip(nodes[found >= 0], found[found >= 0], strict=True):
        exact = [nts.distance(np.vstack((node, x))) for x in segments]
        assert exact[segment] <= min(exact) + TIE * np.ptp(segments)


@segments_
def test_xi_gap_and_normal_agree_with_the_projection(k, rng):
    segments, orientation = bumpy_surface(k)
    nodes = rng.uniform(LOWER, UPPER, (60, 3))
    for node, segment, xi, gap, normal in zip(
        nodes, *find(nodes, segments, orientation), strict=True
    ):
        pair = np.vstack((node, segments[segment]))
        expected = nts.project(pair, orientation[segment])
        np.testing.assert_allclose(xi, expected[0], atol=ROUNDING)
        np.testing.assert_allclose(gap, expected[1], atol=ROUNDING)
        np.testing.assert_allclose(normal, expected[2], atol=ROUNDING)


@segments_
@pytest.mark.parametrize("reach", [0.02, 0.05, 0.1])
def test_only_segments_within_reach_are_found(k, reach, rng):
    segments, orientation = bumpy_surface(k)
    nodes = rng.uniform(LOWER, UPPER, (60, 3))
    found = find(nodes, segments, orientation, reach=reach)[0]
    nearest = np.array([distances(node, segments).min() for node in nodes])
    assert np.all(found[nearest > reach + SAMPLING] == -1)
    assert np.all(found[nearest < reach - SAMPLING] >= 0)
    assert 0 < np.count_nonzero(found >= 0) < 60


@segments_
def test_order_and_vertex_order_of_the_segments_do_not_matter(k, rng):
    segments, orientation = bumpy_surface(k)
    nodes = rng.uniform(LOWER, UPPER, (60, 3))
    order = rng.permutation(len(segments))
    swap = [0, 2, 1, 3][:k]
    plain = find(nodes, segments, orientation)
    mixed = find(nodes, segments[order][:, swap], -orientation[order], key=order)
    np.testing.assert_array_equal(order[mixed[0]], plain[0])
    np.testing.assert_allclose(mixed[1][:, ::-1], plain[1], atol=ROUNDING)
    for i in (2, 3):
        np.testing.assert_allclose(mixed[i], plain[i], atol=ROUNDING)


def two_squares():
    """Unit squares side by side along x, normals up."""
    square = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    return np.stack([square, square + np.array([1.0, 0, 0])]), np.ones(2)


@pytest.mark.parametrize("current", [0, 1])
def test_node_keeps_its_segment_until_it_is_clearly_off_it(current):
    segments, orientation = two_squares()
    outwards = 1 - 2 * current
    for part, stays in ((0.9, True), (1.1, False)):
        node = [1 + outwards * part * HYSTERESIS, 0.4, 0.1]
        (segment,) = find(node, segments, orientation, current=current)[0]
        assert segment == (current if stays else 1 - current)
        (segment,) = find(node, segments, orientation)[0]
        assert segment == 1 - current


@pytest.mark.parametrize("key", [[0, 1], [1, 0], [7, 3]])
@pytest.mark.parametrize("height", [0.2, -0.2])
def test_lowest_key_wins_a_tie(key, height):
    # Above the common edge both squares are equally near.
    segments, orientation = two_squares()
    (segment,) = find([1.0, 0.4, height], segments, orientation, key=key)[0]
    assert segment == int(np.argmin(key))


@pytest.mark.parametrize("key", [[0, 1], [1, 0]])
@pytest.mark.parametrize("side", [0, 1])
def test_node_next_to_a_sharp_edge_is_in_front_of_it(key, side):
    """Behind the plane of one facet of a wedge, a node may be in front of the other."""
    facet = np.array([[0.0, 0, 0], [0, 1, 0], [0.4, 0, 1], [0.4, 1, 1]])
    segments = np.stack([facet * [-1, 1, 1], facet])  # The normals are outward and down.
    orientation = np.array([-1.0, 1.0])
    node = [0.03 * (2 * side - 1), 0.4, -0.02]
    (segment,), _, (gap,), _ = find(node, segments, orientation, key=key)
    assert segment == side
    assert abs(gap - (0.03 + 0.4 * 0.02) / np.hypot(1, 0.4)) < ROUNDING
    # The same surface seen from inside: the node is behind the bottom of a groove.
    (segment,), _, (inside,), _ = find(node, segments, -orientation, key=key)
    assert segment == side and inside == -gap


@pytest.mark.parametrize("key", [(0, 1), (1, 0)])
@pytest.mark.parametrize("x, depth", [(-0.02, 0.5), (-0.2, 0.6)])
def test_node_below_a_dent_gets_the_segment_that_it_is_least_outside_of(key, x, depth):
    # The nearest point of both segments is their common edge. The first one rises by 40 degrees
    # there: the projection on it is farther outside than nodes beyond a rim may be, and from the
    # second node on the other one as well.
    angle = np.deg2rad(40)
    flat = two_squares()[0][0]
    risen = flat * [-np.cos(angle), 1, 1] + flat[:, :1] * [0, 0, np.sin(angle)]
    both, sense = np.array([risen, flat]), [-1, 1]
    segment, xi, gap, _ = find((x, 0.4, -depth), both, sense, key=key, dents=True)
    assert segment == 1
    assert xi[0] == pytest.approx([x, 0.4])
    assert gap == pytest.approx(-depth)
    # With one segment alone, the second place is beyond a rim.
    segment, *_ = find((x, 0.4, -depth), flat[None], [1], dents=True)
    assert (segment >= 0) == (-x < OVERHANG)
    # Without this option it is for both.
    segment, *_ = find((x, 0.4, -depth), both, sense, key=(1, 0))
    assert (segment >= 0) == (-x < OVERHANG)


@pytest.mark.parametrize("dents", [False, True])
def test_node_below_a_sharp_fold_keeps_its_segment(dents):
    # The second segment leans over the first one. The node is in front of its plane, but the body
    # is there: only a segment behind the plane of the first one is beyond a convex edge.
    angle = np.deg2rad(120)
    flat = two_squares()[0][0]
    risen = flat * [-np.cos(angle), 1, 1] + flat[:, :1] * [0, 0, np.sin(angle)]
    both, sense = np.array([flat, risen]), [1, -1]
    segment, _, gap, _ = find((-0.05, 0.4, -0.3), both, sense, dents=dents)
    assert segment == 0 and gap == pytest.approx(-0.3)


def test_node_beyond_the_rim_has_no_segment():
    segments, orientation = two_squares()
    for part, has in ((0.9, True), (1.1, False)):
        for node in ([-part * OVERHANG, 0.5, 0.1], [1.5, 1 + part * OVERHANG, -0.1]):
            for current in (-1, 0):
                (segment,), xi, gap, normal = find(node, segments, orientation, current=current)
                assert (segment >= 0) == has
                assert np.isfinite(gap[0]) == has
                assert np.all(np.isfinite(xi)) == np.all(np.isfinite(normal)) == has


def test_node_far_below_the_surface_belongs_to_another_side():
    segments, orientation = two_squares()
    diameter = np.sqrt(2)
    for part, has in ((0.9, True), (1.1, False)):
        for current in (-1, 0):
            node = [0.5, 0.5, -part * DEPTH * diameter]
            (segment,), _, gap, _ = find(node, segments, orientation, current=current)
            assert (segment >= 0) == has
            assert not has or abs(gap[0] - node[2]) <= ROUNDING
    # The same depth on the open side is not exceptional.
    assert find([0.5, 0.5, 1.1 * DEPTH * diameter], segments, orientation)[0][0] == 0


def test_segment_out_of_reach_is_not_kept():
    segments, orientation = two_squares()
    assert find([0.5, 0.5, 0.3], segments, orientation, current=0, reach=0.4)[0][0] == 0
    assert find([0.5, 0.5, 0.5], segments, orientation, current=0, reach=0.4)[0][0] == -1


@pytest.mark.parametrize("depth", [1e-6, 0.05, 0.2])
def test_node_in_front_of_its_segment_sees_that_it_is_inside_of_another_body(depth):
    floor, (lid, _) = two_squares()[0][0], two_squares()[0]
    # The underside of a block hangs above the node.
    above, orientation = np.array([0, 0, 0.3]), np.array([1.0, -1.0])
    segments = np.stack([floor, lid + above])
    node = [0.4, 0.4, 0.3 + depth]
    (segment,), _, (gap,), _ = find(node, segments, orientation, current=0)
    assert segment == 1 and abs(gap + depth) < ROUNDING
    # In front of both, or inside the first, it keeps its segment.
    for height in (0.3 - 1e-6, 0.2, -1e-6):
        assert find([0.4, 0.4, height], segments, orientation, current=0)[0][0] == 0
    # The same holds next to the block, below the plane of its underside.
    outside = segments + np.array([[0.0], [0.5]])[..., None] * [1, 0, 0]
    assert find(node, outside, orientation, current=0)[0][0] == 0
    # Iterates of a step do not search.
    assert find(node, segments, orientation, current=0, slack=np.inf)[0][0] == 0


@pytest.mark.parametrize(("angle", "sees"), [(150, False), (95, False), (60, True), (30, True)])
def test_node_in_a_groove_sees_a_wall_that_hangs_over_its_floor(angle, sees):
    """Without such a wall, the node keeps the floor until it is off it."""
    angle = np.deg2rad(angle)
    up = np.array([-np.cos(angle), 0, np.sin(angle)])
    x = np.array(
        [[1.0, 0, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0], *(up * [-1, 0, 1] + [[0, 0, 0], [0, 1, 0]])]
    )
    vertices = np.array([[0, 1, 2, 3], [1, 4, 3, 5]], dtype=np.int32)
    kernel = _kernels.Segments(vertices, -np.ones(2), np.arange(2))
    along, normal = x[4], np.array([np.sin(angle), 0, -np.cos(angle)])
    node = 0.5 * HYSTERESIS * along + [0, 0.5, 0] - 1e-3 * HYSTERESIS * normal
    current = np.zeros(1, dtype=np.int32)
    where = current, HYSTERESIS, np.inf, x
    (segment,), *_ = kernel.pair(node[None], *where, *anything(node[None], vertices))
    assert segment == sees


@segments_
def test_no_segments_or_no_nodes_give_empty_results(k):
    none = np.empty((0, k, 3))
    segment, xi, gap, normal = find([[0.0, 0, 0]], none, [])
    assert segment.tolist() == [-1]
    assert np.isnan(gap).all() and np.isnan(xi).all() and np.isnan(normal).all()
    segments, orientation = bumpy_surface(k)
    found = find(np.empty((0, 3)), segments, orientation)
    assert [len(array) for array in found] == [0, 0, 0, 0]


@pytest.mark.untrapped
@segments_
def test_node_at_a_nan_position_has_no_segment(k):
    segments, orientation = bumpy_surface(k)
    assert find([np.nan, 0.5, 0.1], segments, orientation)[0][0] == -1
    assert find([np.nan, 0.5, 0.1], segments, orientation, current=3)[0][0] == -1


def test_wrong_shapes_are_refused():
    segments, orientation = two_squares()
    with pytest.raises(ValueError, match="orientation"):
        find([0.5, 0.5, 0.1], segments, orientation[:1])
    with pytest.raises(ValueError, match="key"):
        find([0.5, 0.5, 0.1], segments, orientation, key=[0])
    with pytest.raises(ValueError, match="current: expected -1 or a segment index"):
        find([0.5, 0.5, 0.1], segments, orientation, current=2)
    with pytest.raises(ValueError, match="x_node"):
        find([0.5, 0.5], segments, orientation)


@segments_
def test_tree_is_kept_while_no_vertex_moves_far(k, rng):
    segments, orientation = bumpy_surface(k)
    shape, x = segments.shape[:2], segments.reshape(-1, 3).copy()
    arrays = np.arange(len(x), dtype=np.int32).reshape(shape), orientation, np.arange(shape[0])
    cached = _kernels.Segments(*arrays)
    nodes = rng.uniform(LOWER, UPPER, (60, 3))
    nowhere = np.full(len(nodes), -1, dtype=np.int32)

    free, trees = anything(nodes, segments), []
    for motion in (0.0, 0.01, 0.01, 0.1, 0.0, np.nan, 0.0):
        moved = x + rng.uniform(-1, 1, 3) * motion
        result = cached.pair(nodes, nowhere, 0.01, 0.2, moved, *free)
        fresh = _kernels.Segments(*arrays).pair(nodes, nowhere, 0.01, 0.2, moved, *free)
        for value, expected in zip(result, fresh, strict=True):
            np.testing.assert_array_equal(value, expected)
        trees.append(cached.num_trees)
        if motion == 0.1:
            x = moved
    assert trees == [1, 1, 1, 2, 2, 3, 4]


def test_no_tree_where_all_nodes_stay_over_their_segments(rng):
    segments, orientation = bumpy_surface(4)
    vertices = np.arange(4 * len(segments), dtype=np.int32).reshape(-1, 4)
    kernel = _kernels.Segments(vertices, orientation, np.arange(len(segments)))
    x, nodes = segments.reshape(-1, 3), segments.mean(axis=1)
    current = np.arange(len(nodes), dtype=np.int32)
    found, _, gap, _ = kernel.pair(nodes, current, 0.01, 0.1, x, *anything(nodes, segments))
    np.testing.assert_array_equal(found, current)
    np.testing.assert_allclose(gap, 0, atol=1e-14)
    assert kernel.num_trees == 0


@segments_
def test_near_nodes_are_those_within_reach_of_a_box(k, rng):
    segments, orientation = bumpy_surface(k)
    vertices = np.arange(segments[..., 0].size, dtype=np.int32).reshape(segments.shape[:2])
    kernel = _kernels.Segments(vertices, orientation, np.arange(len(segments)))
    nodes = rng.uniform(-0.5, 1.5, (300, 3))
    for reach in (0.1, 0.3):
        segments = segments + 0.01  # by less than the margin of the tree
        lower, upper = segments.min(axis=1), segments.max(axis=1)
        outside = np.maximum(lower - nodes[:, None], nodes[:, None] - upper).clip(0)
        expected = np.flatnonzero(np.linalg.norm(outside, axis=2).min(axis=1) <= reach)
        assert 0 < len(expected) < len(nodes)
        near = kernel.near(nodes, reach, segments.reshape(-1, 3))
        np.testing.assert_array_equal(near, expected)
    assert kernel.num_trees == 1


def test_nodes_are_near_segments_of_their_group_only(rng):
    segments, orientation = bumpy_surface(4)
    vertices = np.arange(segments[..., 0].size, dtype=np.int32).reshape(segments.shape[:2])
    first = np.array([0, len(segments) // 3, len(segments)], dtype=np.int32)
    kernel = _kernels.Segments(vertices, orientation, np.arange(len(segments)), first)
    nodes, x = rng.uniform(-0.5, 1.5, (300, 3)), segments.reshape(-1, 3)
    group = np.repeat([1, 0], 150).astype(np.int32)
    lower, upper = segments.min(axis=1), segments.max(axis=1)
    outside = np.maximum(lower - nodes[:, None], nodes[:, None] - upper).clip(0)
    is_near = np.linalg.norm(outside, axis=2) <= 0.2
    expected = [is_near[i, first[g] : first[g + 1]].any() for i, g in enumerate(group)]
    assert 0 < np.count_nonzero(expected) < np.count_nonzero(is_near.any(axis=1))
    np.testing.assert_array_equal(kernel.near(nodes, 0.2, x, group), np.flatnonzero(expected))


@pytest.mark.untrapped
def test_farthest_point(rng):
    x, before = rng.normal(size=(2, 9, 3))
    travels = np.linalg.norm(x - before, axis=1)
    assert _kernels.farthest(x, before) == pytest.approx(travels.max(), rel=1e-14)
    assert _kernels.farthest(x[:0], before[:0]) == 0
    x[5, 1] = np.nan
    assert np.isnan(_kernels.farthest(x, before))
    with pytest.raises(ValueError, match="before"):
        _kernels.farthest(x, before[:7])


def test_segments_by_their_keys(rng):
    key = np.sort(rng.choice(10**12, 20, replace=False))
    segments = np.arange(80, dtype=np.int32).reshape(20, 4)
    kernel = _kernels.Segments(segments, np.ones(20), key)
    some = rng.permutation(20)[:7]
    np.testing.assert_array_equal(kernel.find(key[some]), some)
    others = np.array([-1, key[0] - 1, key[3] + 1, key[-1] + 1])
    np.testing.assert_array_equal(kernel.find(np.setdiff1d(others, key)), -1)
    none = _kernels.Segments(segments[:0], np.ones(0), key[:0])
    np.testing.assert_array_equal(none.find(key), -1)
