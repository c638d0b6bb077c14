"""Passage of points through moving segments: positions at many times, and closed forms."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.model.obstacles.facing import Facing
from dolfinx_nts.model.obstacles.trajectories import Trajectories

pytestmark = pytest.mark.serial

NUM_TIMES = 2001
TRIANGLES = {3: [[0, 1, 2]], 4: [[0, 1, 2], [1, 3, 2]]}
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])


def follow(nodes_n, nodes, segments_n, segments, inside=None):
    """Follow each node through the same segments, ``(s, k, 3)`` in both states."""
    numbers = np.arange(segments[..., 0].size, dtype=np.int32).reshape(segments.shape[:2])
    count = len(segments)
    kernel = _kernels.Segments(numbers, np.ones(count), np.arange(count))
    none = np.full(len(nodes), -1, dtype=np.int32)
    return Trajectories(
        *kernel.follow(
            nodes_n,
            nodes,
            none,
            none if inside is None else inside,
            segments_n.reshape(-1, 3),
            segments.reshape(-1, 3),
            *Facing.everywhere(len(nodes)).arguments,
        )
    )


def crossings(node_n, node, segment_n, segment):
    """Times when a node crosses a segment, and whether inwards, by sampling many times."""
    s = np.linspace(0, 1, NUM_TIMES)[:, None]
    found = []
    for triangle in TRIANGLES[len(segment)]:
        a, b, c = (segment_n[i] + s * (segment[i] - segment_n[i]) for i in triangle)
        r, e, f = node_n + s * (node - node_n) - a, b - a, c - a
        normal = np.cross(e, f)
        front = np.einsum("ti,ti->t", r, normal) > 0
        square = np.einsum("ti,ti->t", normal, normal)
        u = np.einsum("ti,ti->t", np.cross(r, f), normal) / square
        v = np.einsum("ti,ti->t", np.cross(e, r), normal) / square
        over = (u > 0) & (v > 0) & (u + v < 1)
        (changes,) = (front[1:] != front[:-1]).nonzero()
        found += [(s[i + 1, 0], bool(front[i])) for i in changes if over[i] or over[i + 1]]
    return sorted(found)


@pytest.mark.parametrize("k", [3, 4])
def test_times_of_entry_and_exit_match_sampled_paths(k, rng):
    num_entered = num_left = 0
    for _ in range(500):
        segment_n, segment = CORNERS[:k] + 0.6 * rng.normal(size=(2, k, 3))
        node_n, node = rng.uniform(-0.3, 1.3, (2, 3))
        node_n[2], node[2] = 0.8, rng.uniform(-0.8, 0.8)
        expected = crossings(node_n, node, segment_n, segment)
        inwards = [i for i, (_, inward) in enumerate(expected) if inward]
        result = follow(node_n[None], node[None], segment_n[None], segment[None])
        if not inwards or (expected and not expected[0][1]):
            continue
        assert result.entered[0] == 0
        pairs = []  # time of entry and of exit of each path below the segment
        for i in inwards:
            end = next((time for time, inward in expected[i:] if not inward), 1.0)
            pairs.append((expected[i][0], end))
        longest = max(pairs, key=lambda pair: pair[1] - pair[0])
        assert abs(result.begin[0] - longest[0]) < 2 / NUM_TIMES
        assert result.leaves[0] == (longest[1] < 1)
        relative = np.linalg.norm((node - node_n) - (segment - segment_n).mean(axis=0))
        length = (longest[1] - longest[0]) * relative
        assert abs(result.length[0] - length) < 4 * relative / NUM_TIMES
        num_entered, num_left = num_entered + 1, num_left + bool(result.leaves[0])
    assert num_entered > 50
    assert num_left > 0


def test_nodes_through_a_wall_leave_on_its_other_side():
    front = CORNERS[:, :] * 4 - [2, 2, 0]
    back = front[[0, 2, 1, 3]] - [0, 0, 0.1]  # it faces down
    wall = np.array([front, back])
    nodes_n = np.array([[0.0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, -0.05]])
    nodes = np.array([[0.0, 0, -1], [0, 0, -0.05], [0, 0, 0.5], [0, 0, -1]])
    inside = np.array([-1, -1, -1, 0], dtype=np.int32)
    paths = follow(nodes_n, nodes, wall, wall, inside)
    np.testing.assert_array_equal(paths.entered, [0, 0, -1, 0])
    np.testing.assert_array_equal(paths.leaves, [True, False, False, True])
    np.testing.assert_allclose(paths.begin[:2], [1 / 2, 1 / 1.05], rtol=1e-6)
    np.testing.assert_allclose(paths.length[[0, 1, 3]], [0.1, 0.05, 0.05], rtol=1e-5)
    np.testing.assert_allclose(paths.gap[[0, 1, 3]], [-1, -0.05, -1], rtol=1e-12)
    np.testing.assert_array_equal(paths.passes(np.array([4.0, 4.0])), [True, False, False, True])
    # The wall moves to meet a node that rests.
    paths = follow(nodes_n[:1], nodes_n[:1], wall, wall + np.array([0, 0, 2]))
    assert paths.leaves[0]
    np.testing.assert_allclose(paths.length[0], 0.1, rtol=1e-5)


def test_corners_that_are_cut_off_are_not_passed():
    # Two sides of a block that meet in the y axis: x < 0 and z < 0.
    top = np.array([[-1.0, -1, 0], [0, -1, 0], [-1, 1, 0], [0, 1, 0]])
    side = np.array([[0.0, -1, -1], [0, 1, -1], [0, -1, 0], [0, 1, 0]])
    block = np.array([top, side])
    for depth, passes in ((0.02, False), (0.5, True)):
        begin, end = np.array([[-2.0, 0, 2]]), np.array([[2.0, 0, -2]])
        shift = np.array([-depth, 0, -depth])
        paths = follow(begin + shift, end + shift, block, block)
        assert paths.leaves[0]
        assert paths.passes(np.array([1.0, 1.0]))[0] == passes


@pytest.mark.parametrize(
    "obstacle",
    [nts.RigidSphere((0.1, 0.2, 0.3), 0.5), nts.RigidCylinder((0.1, 0.2, 0.3), (1, 2, 3), 0.5)],
    ids=["sphere", "cylinder"],
)
def test_paths_inside_an_obstacle_match_samples(obstacle, rng):
    x_n, x = rng.uniform(-1, 1, (2, 300, 3))
    start = obstacle.distance(x_n)[0]
    outside = start > 0
    x_n, x = x_n[outside], x[outside]
    none = np.full(len(x), -1, dtype=np.int32)
    paths = obstacle.follow(x_n, x, none, Facing.everywhere(len(x)))
    s = np.linspace(0, 1, NUM_TIMES)
    gap = np.array([obstacle.distance(x_n + part * (x - x_n))[0] for part in s])
    part_inside = (gap < 0).mean(axis=0)
    length = part_inside * np.linalg.norm(x - x_n, axis=1)
    np.testing.assert_allclose(paths.length, length, atol=4 / NUM_TIMES)
    clear = (part_inside == 0) | (part_inside > 4 / NUM_TIMES)
    np.testing.assert_array_equal((paths.entered >= 0)[clear], (part_inside > 0)[clear])
    entered = part_inside > 4 / NUM_TIMES
    np.testing.assert_array_equal(paths.leaves[entered], (gap[-1] >= 0)[entered])
    assert 0 < np.count_nonzero(paths.leaves) < np.count_nonzero(entered) < len(x)


def test_planes_and_hollow_obstacles_are_never_passed(rng):
    x_n, x = rng.uniform(-2, 2, (2, 50, 3))
    none, everywhere = np.full(50, -1, dtype=np.int32), Facing.everywhere(50)
    floor = nts.RigidPlane((0, 0, 0), (0, 0, 1))
    paths = floor.follow(x_n, x, none, everywhere)
    through = (x_n[:, 2] > 0) & (x[:, 2] < 0)
    assert not paths.passes(np.ones(1))[x_n[:, 2] > 0].any()
    np.testing.assert_allclose(paths.gap[through], x[through, 2], atol=1e-14)
    tube = nts.RigidCylinder((0, 0, 0), (0, 0, 1), 3.0, hollow=True)
    assert (tube.follow(x_n, 0.9 * x, none, everywhere).entered < 0).all()
    assert floor.shortest_passage == tube.shortest_passage == np.inf


def test_shortest_passage_of_a_shell_is_half_of_its_thickness():
    low, high = np.array([-1.0, -1, 0]), np.array([1.0, 1, 0.1])
    points = np.array([[x, y, z] for z in (0, 0.1) for y in (-1, 1) for x in (-1, 1)], dtype=float)
    facets = np.array([[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 4, 5], [2, 3, 6, 7], [0, 2, 4, 6]])
    facets = np.vstack([facets, [[1, 3, 5, 7]]])
    centre = points[facets].mean(axis=1)
    outside = 2 * centre - (low + high) / 2
    assert nts.RigidSurface(points, facets, outside).shortest_passage == pytest.approx(0.05)
