"""What ranks do for each other, with rows and errors known beforehand."""

import numpy as np
import pytest

from dolfinx_nts.parallel.communication import exchanged, gathered, on_root, scattered


def table(ids):
    """A row for each number."""
    return np.column_stack([10.0 * ids, -ids])


@pytest.fixture
def mine(comm, rng):
    """Numbers of this rank's rows, out of 20 in any order; none on the last of several."""
    shares = np.array_split(3 * rng.permutation(20), max(comm.size - 1, 1))
    return [*shares, np.empty(0, dtype=np.int64)][comm.rank]


def test_each_rank_has_something_for_every_rank(comm, agree):
    parts = [table(np.arange(comm.rank, other + 3)) for other in range(comm.size)]
    received = exchanged(comm, iter(parts))
    assert received[comm.rank] is parts[comm.rank]
    expected = [table(np.arange(other, comm.rank + 3)) for other in range(comm.size)]
    assert agree(all(map(np.array_equal, received, expected)) and len(received) == comm.size)


def test_rows_of_all_ranks_come_to_the_first_in_order(comm, mine, agree):
    ids, rows = gathered(comm, mine, table(mine))
    expected = 3 * np.arange(20) if comm.rank == 0 else mine
    assert agree(np.array_equal(ids, expected) and np.array_equal(rows, table(expected)))


def test_each_rank_gets_the_rows_that_it_asks_for(comm, mine, agree, rng):
    ids, rows = gathered(comm, mine, table(mine))
    wanted = 3 * rng.permutation(20)[comm.rank : comm.rank + 7]
    assert agree(np.array_equal(scattered(comm, wanted, ids, rows), table(wanted)))


def test_a_number_that_is_not_there_is_refused_on_all_ranks(comm, mine, refused):
    ids, rows = gathered(comm, mine, table(mine))
    wanted = np.array([0, 1] if comm.rank == comm.size - 1 else [0])
    with refused(ValueError, "expected the numbers of the same nodes, given others"):
        scattered(comm, wanted, ids, rows)


def test_first_rank_acts_alone_and_all_get_the_result(comm, agree):
    called = []
    result = on_root(comm, lambda: called.append(comm.rank) or {"answer": 42})
    assert agree(result == {"answer": 42})
    assert agree(called == [0] * (comm.rank == 0))


def test_error_of_the_first_rank_is_raised_on_all(comm, refused):
    with refused(FileNotFoundError, "No such file"):
        on_root(comm, lambda: open("/nowhere/at/all"))
