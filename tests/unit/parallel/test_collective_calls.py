"""Ranks that make the same call, and ranks that do not."""

import time

import pytest

from dolfinx_nts.parallel.collective_calls import meet
from dolfinx_nts.parallel.errors import agreed, all_come


@pytest.mark.parametrize("numbers", [0, 1, 2])
def test_ranks_that_meet_learn_the_largest_numbers(comm, agree, numbers):
    mine = [-1.0 - comm.rank, 10.0 * comm.rank][:numbers]
    assert agree(meet(comm, "the same", *mine) == [-1.0, 10.0 * (comm.size - 1)][:numbers])


def test_different_calls_are_refused_on_all_ranks_whatever_they_bring(comm, refused):
    if comm.size == 1:
        pytest.skip("for several ranks")
    is_last = comm.rank == comm.size - 1
    with refused(ValueError, "do the same, given first call on some and other call on others"):
        meet(comm, *(["other call", 1.0, 2.0] if is_last else ["first call"]))
    meet(comm, "the same")


def test_a_context_that_other_ranks_do_not_enter_is_refused_on_all(comm, refused):
    if comm.size == 1:
        pytest.skip("for several ranks")

    def act():
        if comm.rank == 0:
            with agreed(comm, "context"):
                pass
        else:
            meet(comm, "call")

    with refused(ValueError, "do the same, given context on some and call on others"):
        act()


def test_late_ranks_are_distinguished_from_missing_ones(comm, agree):
    assert agree(all_come(comm, "leave"))
    if comm.size == 1:
        return
    assert not agree(all_come(comm, "leave" if comm.rank else "go on"))
    if comm.rank == 0:
        assert not all_come(comm, "leave")
    else:
        time.sleep(1.0)
        all_come(comm, "leave")  # nobody waits any more at this time
    comm.barrier()
