"""Global search: data sent to each rank, and results sent back."""

import numpy as np
import pytest

from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.points import NodalPoints
from helpers import scenes
from helpers.once import once
from helpers.scene import input_ids

ROUNDING = 1e2 * np.finfo(float).eps

cells_ = pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])


def search_of(scene):
    pair = scene.stepper.pairs[0]
    return GlobalSearch(pair.nodes, pair.segments), pair


def all_segments(pair, x):
    """Vertex positions (s, k, 3) and keys of every segment, on all ranks."""
    comm = pair.nodes.V.mesh.comm
    parts = comm.allgather((x[pair.segments.segments], pair.segments.key))
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


def sampled_distance(x_nodes, segments):
    """Upper bounds of the distances (n, s), from many points of each segment."""
    k, t = segments.shape[1], np.linspace(0, 1, 9)
    r, s = (a.ravel() for a in np.meshgrid(t, t))
    if k == 3:
        inside = r + s <= 1
        r, s = r[inside], s[inside]
        phi = np.array([1 - r - s, r, s])
    else:
        phi = np.array([(1 - r) * (1 - s), r * (1 - s), (1 - r) * s, r * s])
    points = np.einsum("kp,skc->spc", phi, segments)
    return np.linalg.norm(x_nodes[:, None, None] - points, axis=-1).min(axis=2)


def test_nodes_near_the_segments_are_those_near_one_of_their_boxes(comm):
    scene = scenes.blocks(comm)
    search, pair = search_of(scene)
    x = scene.stepper.x
    candidates, _ = search.update(x, 0.1)
    x, nodes = candidates.scatter.forward(x), pair.nodes.nodes
    for reach in (0.0, 0.05, 0.2):
        boxes = [(s.min(axis=0), s.max(axis=0)) for s in x[candidates.segments]]
        near = [
            n
            for n, at in enumerate(x[nodes])
            if any(np.linalg.norm(at - at.clip(*box)) <= reach for box in boxes)
        ]
        np.testing.assert_array_equal(candidates.near(NodalPoints(nodes), x, reach), near)


@cells_
@pytest.mark.parametrize("reach", [0.05, once(0.1), 0.4, once(np.inf)], ids=str)
def test_candidates_contains_every_segment_within_reach(comm, cell, reach):
    scene = scenes.blocks(comm, cell=cell)
    search, pair = search_of(scene)
    x = scene.stepper.x
    candidates, new = search.update(x, reach)
    segments, key = all_segments(pair, x)
    x_nodes = x[pair.nodes.nodes]
    near = key[(sampled_distance(x_nodes, segments) <= reach).any(axis=0)]
    missing = np.setdiff1d(near, candidates.key)
    assert comm.allreduce(len(missing)) == 0
    assert comm.allreduce(len(near)) > 0
    assert comm.allreduce(not new) == 0


@cells_
def test_candidates_describes_the_segments_of_other_ranks_correctly(comm, cell):
    scene = scenes.blocks(comm, cell=cell)
    search, pair = search_of(scene)
    x = scene.stepper.x
    candidates, _ = search.update(x, np.inf)
    segments, key = all_segments(pair, x)
    order = np.argsort(key) if len(pair.nodes.nodes) else slice(0)  # who has no node gets none
    signs = np.concatenate(comm.allgather(pair.segments.orientation))[order]
    wrong = int(not np.array_equal(candidates.key, key[order]))
    found = candidates.scatter.forward(x)[candidates.segments]
    wrong += not np.allclose(found, segments[order], rtol=0, atol=ROUNDING)
    wrong += not np.array_equal(candidates.orientation, signs)
    edges = segments[order][:, :, None] - segments[order][:, None]
    size = np.linalg.norm(edges, axis=-1).max(axis=(1, 2), initial=0.0)
    wrong += not np.allclose(candidates.size, size, rtol=ROUNDING)
    assert comm.allreduce(wrong) == 0


def test_find_gives_the_place_of_a_key_and_minus_one_without(comm):
    scene = scenes.blocks(comm)
    candidates, _ = search_of(scene)[0].update(scene.stepper.x, 0.1)
    keys = np.concatenate([candidates.key[::-1], [-1, 10**6]]).astype(np.int64)
    expected = [*range(len(candidates.key))[::-1], -1, -1]
    assert comm.allreduce(candidates.find(keys).tolist() != expected) == 0


def test_sending_to_ghosts_and_back_to_owners_are_transposed(comm):
    # (A a, b) = (a, A^T b) for all a on owned and b on all nodes.
    scene = scenes.blocks(comm)
    candidates, _ = search_of(scene)[0].update(scene.stepper.x, np.inf)
    rng = np.random.default_rng(comm.rank)
    num_owned = candidates.scatter.index_map.size_local
    a = rng.normal(size=(num_owned, 3))
    b = rng.normal(size=(num_owned + candidates.scatter.index_map.num_ghosts, 3))
    sums = [np.sum(candidates.scatter.forward(a) * b), np.sum(a * candidates.scatter.reverse(b))]
    sums = comm.allreduce(np.array(sums))
    assert abs(sums[0] - sums[1]) <= ROUNDING * comm.allreduce(b.size)


def test_segments_are_sent_again_only_after_enough_movement(comm):
    scene = scenes.blocks(comm)
    search, _ = search_of(scene)
    x, reach = scene.stepper.x.copy(), 0.1
    first, new = search.update(x, reach)
    assert new
    # The margin is twice the reach; both surfaces move by the same amount.
    x[:, 2] += 0.9 * reach
    again, new = search.update(x, reach)
    assert not new
    assert again is first
    assert search.num_searches == 1
    x[:, 2] += 0.2 * reach
    _, new = search.update(x, reach)
    assert new
    assert search.num_searches == 2
    _, new = search.update(x, 3.1 * reach)
    assert new
    assert search.num_searches == 3


def test_movement_on_one_rank_alone_sends_the_segments_on_all(comm):
    scene = scenes.blocks(comm)
    search, pair = search_of(scene)
    x = scene.stepper.x.copy()
    search.update(x, 0.1)
    ids = input_ids(pair.nodes.V)
    one = pair.nodes.node_ids.min(initial=10**6)
    x[ids == comm.allreduce(one, op=scenes.MPI.MIN)] += 0.3
    _, new = search.update(x, 0.1)
    assert comm.allgather(new) == [True] * comm.size


@cells_
def test_candidates_that_are_used_again_still_contains_every_segment_within_reach(comm, cell):
    scene = scenes.blocks(comm, cell=cell)
    search, pair = search_of(scene)
    x, reach = scene.stepper.x.copy(), 0.05
    upper = input_ids(pair.nodes.V) >= 32
    missing = 0
    for _ in range(16):
        x[upper] -= [0.004, -0.003, 0.008]
        candidates, _ = search.update(x, reach)
        segments, key = all_segments(pair, x)
        distance = sampled_distance(x[pair.nodes.nodes], segments)
        missing += len(np.setdiff1d(key[(distance <= reach).any(axis=0)], candidates.key))
    assert comm.allreduce(missing) == 0
    assert 1 < search.num_searches < 8


def test_rank_without_nodes_or_segments_takes_part(comm):
    # The last rank owns cells at the underside of the lower block only.
    def owner(middle):
        ranks = np.arange(len(middle)) % max(comm.size - 1, 1)
        return np.where(np.arange(len(middle)) == len(middle), comm.size - 1, ranks)

    scene = scenes.blocks(comm, owner=owner)
    search, pair = search_of(scene)
    candidates, _ = search.update(scene.stepper.x, np.inf)
    x = scene.stepper.x
    assert comm.allgather(len(candidates.key))[0] == 9
    assert comm.allreduce(len(pair.nodes.nodes)) == 9
    if comm.size > 1:
        assert comm.allgather(len(pair.nodes.nodes))[-1] == 0
    candidates.scatter.reverse(candidates.scatter.forward(x))
