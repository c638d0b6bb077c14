"""BlockPivoting: all violated conditions change while their number decreases, then one."""

from itertools import pairwise

import numpy as np
import pytest

from dolfinx_nts.contact.implicit.normal.active_set import BlockPivoting

pytestmark = pytest.mark.at_most_two_ranks


def ids_of(comm, n=4):
    """Global numbers of n items on each rank, the lowest on the last one."""
    return np.arange(n, dtype=np.int64)[::-1] + n * (comm.size - 1 - comm.rank)


def pivoting_of(comm, ids, waits=0):
    """Block pivoting of one pair."""
    return BlockPivoting(comm, ids, np.array([0, len(ids)]), waits)


def test_all_violators_change_while_they_become_fewer(comm):
    ids = ids_of(comm)
    pivoting, node = pivoting_of(comm, ids), np.arange(4, dtype=np.int32)
    for count in (4, 3, 2, 1):
        violates = ids % 4 < count
        changes, violators = pivoting.select(violates, node, 1)
        assert np.array_equal(changes, violates)
        assert violators == count


def test_violators_that_do_not_become_fewer_change_one_at_a_time(comm):
    ids = ids_of(comm)
    pivoting, node = pivoting_of(comm, ids), np.arange(4, dtype=np.int32)
    violates = np.ones(4, dtype=bool)
    totals = []
    for iteration in range(20):
        changes, violators = pivoting.select(violates, node, iteration)
        assert violators == 4  # all are reported, changed or not
        totals.append(comm.allreduce(int(changes.sum())))
    assert totals[0] == 4 * comm.size
    late = totals[10:]
    # Newton's method converges in between.
    assert max(late) == 1
    assert min(late) == 0
    changes, _ = pivoting.select(violates, node, 20)
    assert comm.allreduce(int(ids[changes].sum())) == 0  # the lowest


def test_fewer_violators_than_ever_change_together_again(comm):
    ids = ids_of(comm)
    pivoting, node = pivoting_of(comm, ids), np.arange(4, dtype=np.int32)
    for iteration in range(20):
        pivoting.select(np.ones(4, dtype=bool), node, iteration)
    violates = ids % 4 < 3
    changes, _ = pivoting.select(violates, node, 21)
    assert np.array_equal(changes, violates)


@pytest.mark.parametrize("waits", [0, np.inf])
def test_the_smallest_count_is_reset_with_single_changes(comm, waits):
    """None or few violated at first, as nodes hardly moved; that says nothing of later."""
    ids = ids_of(comm)
    pivoting, node = pivoting_of(comm, ids, waits), np.arange(4, dtype=np.int32)
    pivoting.select(np.zeros(4, dtype=bool), node, 0)
    pivoting.select(ids % 4 == 0, node, 1)
    for iteration in range(2, 20):
        pivoting.select(np.ones(4, dtype=bool), node, iteration)
    violates = ids % 4 < 3
    assert np.array_equal(pivoting.select(violates, node, 20)[0], violates)


def test_waiting_nodes_keep_their_state_unless_violations_decrease(comm):
    ids = ids_of(comm)
    pivoting, node = pivoting_of(comm, ids, waits=np.inf), np.arange(4, dtype=np.int32)
    first, other = ids % 4 < 2, ids % 4 >= 2
    assert np.array_equal(pivoting.select(first, node, 1)[0], first)
    # The number has not decreased: nodes that have just changed wait, others change.
    changes, violators = pivoting.select(first, node, 2)
    assert not changes.any() and violators == 2
    # Nodes that have waited change.
    assert np.array_equal(pivoting.select(first, node, 3)[0], first)
    assert np.array_equal(pivoting.select(other | first, node, 4)[0], other)
    # The number decreases: all change.
    assert np.array_equal(pivoting.select(ids % 4 == 2, node, 5)[0], ids % 4 == 2)


def test_a_single_node_that_has_just_changed_keeps_its_state(comm):
    """Its multiplier belongs to an equilibrium that is not reached yet."""
    ids = ids_of(comm)
    pivoting, node = pivoting_of(comm, ids, waits=1), np.arange(4, dtype=np.int32)
    one = ids == 0
    assert np.array_equal(pivoting.select(one, node, 1)[0], one)
    changes, violators = pivoting.select(one, node, 2)
    assert not changes.any() and violators == one.sum()
    assert np.array_equal(pivoting.select(one, node, 3)[0], one)
    # Another node does not wait.
    assert np.array_equal(pivoting.select(ids == 1, node, 4)[0], ids == 1)


@pytest.mark.parametrize("waits", [0, np.inf])
def test_pairs_updated_together_are_independent(comm, waits):
    rng, n = np.random.default_rng(comm.rank), (5, 0, 3, 4)
    ends, ids = np.cumsum([0, *n]), rng.permutation(20)[: sum(n)] + 20 * comm.rank
    together = BlockPivoting(comm, ids, ends, waits)
    alone = [pivoting_of(comm, ids[a:b], waits) for a, b in pairwise(ends)]
    for iteration in range(40):
        eligible = rng.random(len(ids)) < 0.8
        violates = eligible & (rng.random(len(ids)) < 0.5)
        node = np.flatnonzero(eligible).astype(np.int32)
        changes, violators = together.select(violates[node], node, iteration)
        found, counts = np.zeros(len(ids), dtype=bool), 0
        for pivoting, (a, b) in zip(alone, pairwise(ends), strict=True):
            own = node[(node >= a) & (node < b)]
            found[own], count = pivoting.select(violates[own], own - np.int32(a), iteration)
            counts += count
        assert np.array_equal(changes, found[node])
        assert violators == counts


@pytest.mark.parametrize(("matrices", "waits"), [(50, 0), (50, 1), (50, np.inf)])
def test_random_complementarity_problems_are_solved(comm, matrices, waits):
    # 0 <= x, A x - b >= 0, x (A x - b) = 0 with a matrix all of whose
    # principal minors are positive; the linear systems are exact.
    rng = np.random.default_rng(3)
    for _ in range(matrices):
        n = 12
        A = rng.normal(size=(n, n))
        A = A @ A.T + 0.1 * np.eye(n) + 0.5 * (A - A.T)
        b = rng.normal(size=n)
        mine = np.arange(n) % comm.size == comm.rank
        ids = np.arange(n, dtype=np.int64)[mine]
        active, pivoting = np.zeros(n, dtype=bool), pivoting_of(comm, ids, waits)
        node = np.arange(len(ids), dtype=np.int32)
        for iteration in range(2000):
            x = np.zeros(n)
            x[active] = np.linalg.solve(A[np.ix_(active, active)], b[active])
            violates = np.where(active, x < 0, A @ x - b < 0)
            changes, _ = pivoting.select(violates[mine], node, iteration)
            flips = np.zeros(n)
            flips[mine] = changes
            active ^= comm.allreduce(flips) > 0
            if not violates.any():
                break
        assert x.min() >= 0
        assert (A @ x - b).min() >= -1e-10
