"""Active sets are distinguished by their contents, alike on all ranks."""

from types import SimpleNamespace

import numpy as np
import pytest

from dolfinx_nts.common.archive import Snapshot
from dolfinx_nts.solvers.linear.active_sets import ActiveSets


def pairs(**changed):
    """One contact pair with three active pairs."""
    arrays = {
        "start": np.array([0, 4, 8, 12]),
        "nodes": np.arange(12),
        "rank": np.array([1, 3, 0]),
        "tangent_nodes": np.arange(6).reshape(2, 3),
        "fixed": np.zeros(3, dtype=bool),
        **changed,
    }
    blocks = SimpleNamespace(**arrays)
    return SimpleNamespace(global_blocks=lambda: blocks, fixed=arrays["fixed"])


OTHERS = {
    "node": pairs(nodes=np.arange(12)[::-1]),
    "list": pairs(start=np.array([0, 4, 7, 12])),
    "constraint": pairs(rank=np.array([1, 1, 0])),
    "tangent": pairs(tangent_nodes=np.arange(9).reshape(3, 3)),
    "support": pairs(fixed=np.array([False, True, False])),
}


@pytest.mark.parametrize("name", OTHERS)
def test_a_change_on_one_rank_gives_a_new_number_on_all(comm, agree, name):
    sets = ActiveSets(comm)
    assert sets.number([pairs()]) == sets.number([pairs()]) == 1
    some = OTHERS[name] if comm.rank == comm.size - 1 else pairs()
    assert agree(sets.number([some]) == sets.number([some]) == 2)
    assert agree(sets.number([pairs()]) == 3)
    assert agree(sets.number([pairs(), pairs()]) == 4)


def test_the_empty_set_is_not_counted(comm):
    sets = ActiveSets(comm)
    assert [sets.number(some) for some in ([], [pairs()], [], [pairs()])] == [0, 1, 0, 1]


@pytest.mark.parametrize("is_empty", [True, False])
def test_a_set_that_comes_back_gets_a_new_number_and_is_known(comm, is_empty):
    sets, archive = ActiveSets(comm), Snapshot()
    if not is_empty:
        sets.number([pairs()])
    sets.serialize(archive)
    later = sets.number([OTHERS["node"]])
    sets.serialize(archive.rewind())
    assert sets.version > later
    assert (sets.number([pairs()]) == later + 1) != is_empty
