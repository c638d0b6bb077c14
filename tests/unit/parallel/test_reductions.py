"""Sums and extremes over all ranks, compared with the values of each rank."""

import numpy as np
import pytest

from dolfinx_nts.parallel import reductions


@pytest.mark.parametrize(
    ("reduce", "of_parts"),
    [(reductions.total, np.sum), (reductions.largest, np.max), (reductions.least, np.min)],
)
@pytest.mark.parametrize("kind", [int, float, np.float64, np.int32])
def test_numbers(reduce, of_parts, kind, comm):
    parts = [kind(3 - 2 * rank) for rank in range(comm.size)]
    result = reduce(comm, parts[comm.rank])
    assert result == of_parts(parts)
    assert isinstance(result, float) == issubclass(kind, float)


def test_large_integers_keep_all_digits(comm):
    last = np.iinfo(np.int64).max
    assert reductions.least(comm, last - comm.rank) == last - comm.size + 1


def test_flags(comm):
    first = comm.rank == 0
    assert reductions.anywhere(comm, first) is True
    assert reductions.anywhere(comm, False) is False
    assert reductions.everywhere(comm, True) is True
    assert reductions.everywhere(comm, first) is (comm.size == 1)


@pytest.mark.parametrize("shape", [(0,), (4,), (2, 3)])
def test_arrays_are_reduced_entry_by_entry_and_left_as_they_were(shape, comm, rng):
    parts = rng.normal(size=(comm.size, *shape))  # the same on all ranks
    mine = parts[comm.rank].copy()
    np.testing.assert_allclose(reductions.total(comm, mine), parts.sum(axis=0), rtol=1e-14)
    np.testing.assert_array_equal(reductions.largest(comm, mine), parts.max(axis=0))
    np.testing.assert_array_equal(reductions.least(comm, mine), parts.min(axis=0))
    np.testing.assert_array_equal(mine, parts[comm.rank])


def test_lists_are_reduced_entry_by_entry(comm):
    mine = [float(comm.rank), 0.5]
    assert reductions.total(comm, mine) == [comm.size * (comm.size - 1) / 2, comm.size / 2]
    assert reductions.largest(comm, mine) == [comm.size - 1, 0.5]
    assert mine == [comm.rank, 0.5]
