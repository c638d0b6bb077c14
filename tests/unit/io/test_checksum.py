"""Checksums detect every change, and do not depend on the distribution of rows."""

import numpy as np
import pytest

from dolfinx_nts.io.checksum import checksum

pytestmark = pytest.mark.serial


@pytest.fixture(params=[("f8", (3,)), ("i8", ()), ("?", ()), ("i4", (3,)), ("u1", (2, 5))])
def rows(request, rng):
    """Return numbered rows of some type and shape."""
    dtype, shape = request.param
    return rng.permutation(50) << 56, rng.integers(0, 2, (50, *shape)).astype(dtype)


def test_parts_in_any_order_add_up(rows, rng):
    numbers, values = rows
    order = rng.permutation(50)
    parts = [checksum(numbers[part], values[part]) for part in np.array_split(order, 7)]
    assert sum(parts) % 2**64 == checksum(numbers, values) > 0


def test_every_change_of_a_bit_or_a_number_and_exchanged_rows_are_noticed(rows):
    numbers, values = rows
    sums, words = {checksum(numbers, values)}, values.reshape(-1).view(np.uint8)
    for at in range(len(words)):
        words[at] ^= 1
        sums.add(checksum(numbers, values))
        words[at] ^= 1
    assert len(sums) == len(words) + 1
    different = np.flatnonzero((values != values[0]).reshape(50, -1).any(axis=1))[0]
    for i, j in ((0, different), (different, 0)):
        numbers[i], numbers[j] = numbers[j] + (i == 0), numbers[i]
        sums.add(checksum(numbers, values))
    assert len(sums) == len(words) + 3


def test_nothing_has_the_sum_nought():
    assert checksum(np.empty(0, dtype=np.int64), np.empty((0, 3))) == 0
