"""Flags that are set in parts of a list, counted by a kernel."""

from itertools import pairwise

import numpy as np
import pytest

from dolfinx_nts import _kernels

pytestmark = pytest.mark.serial

ENDS = np.array([0, 3, 3, 8, 10])


def test_flags_are_counted_part_by_part(rng):
    number = np.flatnonzero(rng.random(10) < 0.7).astype(np.int32)
    flags = rng.random(len(number)) < 0.5
    expected = [
        np.count_nonzero(flags & (number >= begin) & (number < end))
        for begin, end in pairwise(ENDS)
    ]
    assert _kernels.counts_of_parts(flags, number, ENDS).tolist() == expected
    none = np.empty(0, dtype=np.int32)
    assert not _kernels.counts_of_parts(np.empty(0, dtype=bool), none, ENDS).any()


@pytest.mark.parametrize("number", [[4, 2], [9, 10], [-1, 3]])
def test_numbers_have_to_ascend_in_the_parts(number):
    flags, number = np.ones(2, dtype=bool), np.array(number, dtype=np.int32)
    with pytest.raises(ValueError, match="expected ascending numbers within the ranges of ends"):
        _kernels.counts_of_parts(flags, number, ENDS)
