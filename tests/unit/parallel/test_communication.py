"""What ranks do for each other, with rows and errors known beforehand."""

import numpy as np

from dolfinx_nts.parallel.communication import exchanged, on_root


def table(ids):
    """A row for each number."""
    return np.column_stack([10.0 * ids, -ids])


def test_each_rank_has_something_for_every_rank(comm, agree):
    parts = [table(np.arange(comm.rank, other + 3)) for other in range(comm.size)]
    received = exchanged(comm, iter(parts))
    assert received[comm.rank] is parts[comm.rank]
    expected = [table(np.arange(other, comm.rank + 3)) for other in range(comm.size)]
    assert agree(all(map(np.array_equal, received, expected)) and len(received) == comm.size)


def test_first_rank_acts_alone_and_all_get_the_result(comm, agree):
    called = []
    result = on_root(comm, lambda: called.append(comm.rank) or {"answer": 42})
    assert agree(result == {"answer": 42})
    assert agree(called == [0] * (comm.rank == 0))


def test_error_of_the_first_rank_is_raised_on_all(comm, refused):
    with refused(FileNotFoundError, "No such file"):
        on_root(comm, lambda: open("/nowhere/at/all"))
