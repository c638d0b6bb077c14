"""Transfer of NumPy arrays into the kernels and out of them."""

import weakref

import numpy as np
import pytest

from dolfinx_nts import _kernels

ROWS = np.array([2, 0, 2], dtype=np.int32)
VALUES = np.arange(9.0).reshape(3, 3)
SUMS = [[3, 4, 5], [0, 0, 0], [6, 8, 10]]

pytestmark = pytest.mark.serial


def sums(rows, values):
    total = np.zeros((3, 3))
    _kernels.add_rows(total[:2], total[2:], rows, values)
    return total


@pytest.mark.parametrize(
    "given",
    [
        VALUES,
        np.asfortranarray(VALUES),
        np.repeat(VALUES, 2, axis=0)[::2],
        VALUES.astype(np.float32),
        VALUES.astype(np.int64),
        VALUES.astype(">f8"),
    ],
    ids=["as it is", "by columns", "strided", "single", "integers", "swapped bytes"],
)
def test_arrays_of_the_same_numbers_give_the_same_result(given):
    np.testing.assert_array_equal(sums(ROWS, given), SUMS)


@pytest.mark.parametrize("rows", [ROWS.astype(float), ROWS.astype(np.int64), ROWS.tolist(), None])
def test_numbers_that_a_type_cannot_hold_are_refused(rows):
    with pytest.raises(TypeError, match="incompatible function arguments"):
        sums(rows, VALUES)


@pytest.mark.parametrize(
    "total",
    [
        np.zeros((3, 3), dtype=np.float32),
        np.zeros((3, 6))[:, ::2],
        np.frombuffer(bytes(72)).reshape(3, 3),
    ],
    ids=["single", "strided", "read-only"],
)
def test_output_arrays_are_never_copied(total):
    with pytest.raises(TypeError, match="incompatible function arguments"):
        _kernels.add_rows(total, np.zeros((0, 3)), ROWS, VALUES)
    assert not total.any()


def test_wrong_shape_is_named():
    with pytest.raises(ValueError, match=r"total: expected shape \(any, any\), given \(3\)"):
        _kernels.add_rows(np.zeros(3), np.zeros((0, 3)), ROWS, VALUES)


def test_arrays_live_as_long_as_somebody_needs_them():
    x_pair = np.array([[[0.3, 0.2, 0.1], [0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    given, results = weakref.ref(x_pair), _kernels.project(x_pair, np.ones(1))
    del x_pair
    assert given() is None
    gap = results[1]
    assert gap.flags.owndata
    assert gap.flags.writeable
    results = [weakref.ref(array) for array in results]
    np.testing.assert_allclose(gap, 0.1)
    assert [result() is None for result in results] == [True, False, True, True]
