"""Distributed numbered rows in contiguous slabs, with known contents."""

import numpy as np
import pytest

from dolfinx_nts.parallel.slabs import Slab, Slabs, Some, fetch_rows

# Numbers of vertices, and of edge midpoints, which need 62 bits.
NUMBERS = np.concatenate([3 * np.arange(200), 2**31 * np.arange(1, 1801) + 5])


def table(ids):
    """A row for each number."""
    return np.column_stack([10 * ids, -ids])


@pytest.fixture
def mine(comm, rng):
    """Row numbers of this rank in random order; none on the last rank, few on the first."""
    order = rng.permutation(NUMBERS)
    if comm.size == 1:
        return order
    return [order[:10], *np.array_split(order[10:], max(comm.size - 2, 1)), order[:0]][comm.rank]


def whole(comm, slab):
    """All rows, from slabs that must be consecutive."""
    parts = comm.allgather((slab.begin, slab.values))
    ends = np.cumsum([0, *(len(values) for _, values in parts)])
    assert [begin for begin, _ in parts] == ends[:-1].tolist()
    assert ends[-1] == slab.length == slab.shape[0]
    return np.concatenate([values for _, values in parts])


def test_rows_lie_in_the_order_of_their_numbers(comm, mine, agree):
    slabs = Slabs(comm, mine)
    assert agree(np.array_equal(whole(comm, slabs.numbers()), NUMBERS))
    for rows in (table(mine), table(mine)[:, 0].astype(np.int32), table(mine)[:, None] > 0):
        expected = [table(NUMBERS), table(NUMBERS)[:, 0].astype(np.int32)]
        expected += [table(NUMBERS)[:, None] > 0]
        found = whole(comm, slabs.slab(rows))
        assert agree(any(np.array_equal(found, e) and found.dtype == e.dtype for e in expected))


def test_rows_replace_unused_ones(comm, mine, agree):
    slabs, rows = Slabs(comm, mine), table(mine).astype(float)
    former = slabs.slab(rows + 1).values
    found = slabs.slab(rows, former)
    assert agree(found.values is former or np.shares_memory(found.values, former))
    assert agree(np.array_equal(whole(comm, found), table(NUMBERS)))
    # A buffer of the same size and type is reused, others are not.
    others = former.ravel(), former[:-1].copy(), former.astype(np.int64)
    for number, other in enumerate(others):
        found = slabs.slab(rows, other)
        assert agree(np.array_equal(whole(comm, found), table(NUMBERS)))
        assert agree(np.shares_memory(found.values, other) == (number == 0))


def test_only_some_rows_differ_from_the_others(comm, mine, agree):
    slabs, is_even = Slabs(comm, mine), NUMBERS % 2 == 0
    even = np.flatnonzero(mine % 2 == 0).astype(np.int32)
    former = None
    for shift in (0.0, 0.5):
        some = Some(even, table(mine)[even] + shift, 7.0)
        found = slabs.slab(some, former)
        expected = np.where(is_even[:, None], table(NUMBERS) + shift, 7.0)
        assert agree(np.array_equal(whole(comm, found), expected))
        former = found.values


def test_no_rank_has_many_more_rows_than_others(comm, mine, agree):
    share = len(NUMBERS) / comm.size
    assert agree(abs(len(Slabs(comm, mine).numbers().values) - share) < 0.15 * share)


def test_places_of_any_numbers_are_known(comm, mine, agree, rng):
    wanted = rng.permutation(NUMBERS)[comm.rank : comm.rank + 70]
    places = Slabs(comm, mine).places(wanted)
    assert agree(np.array_equal(NUMBERS[places], wanted))


def test_rows_are_split_on_all_ranks_alike(comm, mine, agree):
    halves = Slabs(comm, mine).slab(table(mine)).split(2)
    assert agree(np.array_equal(whole(comm, halves), table(NUMBERS).ravel()))


def test_without_rows_slabs_are_empty(comm, agree):
    slab = Slabs(comm, np.empty(0, dtype=np.int64)).slab(np.empty((0, 3)))
    assert agree(slab.shape == (0, 3) and slab.begin == 0)


def test_an_array_of_one_rank_is_a_slab(agree):
    assert agree(Slab.whole(np.ones((4, 2))).shape == (4, 2))
    assert agree(Slab.whole(np.array(1.0)).shape == ())


def test_a_number_that_no_rank_has_is_refused_on_all(comm, refused):
    known = np.arange(comm.rank * 10, comm.rank * 10 + 5)
    assert (
        fetch_rows(comm, known[::-1], known, table(known)).tolist() == table(known)[::-1].tolist()
    )
    wanted = np.array([0, 7] if comm.rank == comm.size - 1 else [0])
    with refused(ValueError, "expected numbers of existing rows, given one that no rank has"):
        fetch_rows(comm, wanted, known, table(known))
