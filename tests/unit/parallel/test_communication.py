"""Exchange of rows and errors between ranks, with known results."""

import numpy as np

from dolfinx_nts.parallel.communication import (
    exchanged,
    joined,
    on_root,
    places_among_all,
    rows_by_rank,
)


def table(ids):
    """A row for each number."""
    return np.column_stack([10.0 * ids, -ids])


def test_each_rank_receives_messages_of_its_senders(comm, agree):
    # The lower one of two neighbours first has rows for the other, then the reverse.
    for step in (1, -1) * 3:
        to, source = comm.rank + step, comm.rank - step
        parts = {rank: table(np.arange(comm.rank, rank + 3)) for rank in (to, comm.rank)}
        parts = {rank: part for rank, part in parts.items() if 0 <= rank < comm.size}
        received = exchanged(comm, parts)
        senders = [rank for rank in sorted({source, comm.rank}) if 0 <= rank < comm.size]
        expected = [table(np.arange(rank, comm.rank + 3)) for rank in senders]
        assert agree(list(received) == senders and received[comm.rank] is parts[comm.rank])
        assert agree(all(map(np.array_equal, received.values(), expected)))


def test_rows_go_to_their_ranks_in_their_order(comm, agree):
    ranks = np.array([5, 0, 5, 7, 0]) + comm.size
    rows = {rank - comm.size: list(some) for rank, some in rows_by_rank(comm, ranks).items()}
    assert agree(rows == {comm.rank - comm.size: [], 0: [1, 4], 5: [0, 2], 7: [3]})


def test_first_rank_acts_alone_and_all_get_the_result(comm, agree):
    called = []
    result = on_root(comm, lambda: called.append(comm.rank) or {"answer": 42})
    assert agree(result == {"answer": 42})
    assert agree(called == [0] * (comm.rank == 0))


def test_error_of_the_first_rank_is_raised_on_all(comm, refused):
    with refused(FileNotFoundError, "No such file"):
        on_root(comm, lambda: open("/nowhere/at/all"))


def test_rows_of_all_ranks_stand_in_the_order_of_the_ranks(comm, agree):
    own = table(np.arange(comm.rank + 1))
    expected = np.concatenate([table(np.arange(rank + 1)) for rank in range(comm.size)])
    assert agree(np.array_equal(joined(comm, own), expected))


def test_places_of_rows_do_not_depend_on_the_partition(comm, agree, rng):
    rows = np.array([(i, j) for i in range(5) for j in range(4)])
    shuffled = rng.permutation(len(rows))
    mine = np.array_split(shuffled, comm.size)[comm.rank]
    assert agree(np.array_equal(places_among_all(comm, rows[mine]), mine))
