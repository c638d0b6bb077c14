"""Kernels that pack the values of functions."""

import numpy as np
import pytest

from dolfinx_nts import _kernels


@pytest.mark.serial
def test_kernels_refuse_what_does_not_fit():
    x, nodes, rows = np.zeros((4, 3)), np.array([[0, 3]], dtype=np.int32), np.zeros((1, 8))
    _kernels.pack(x + 1, nodes, 2, rows)
    np.testing.assert_array_equal(rows, [[0, 0, 1, 1, 1, 1, 1, 1]])
    for first in (3, 9):
        with pytest.raises(ValueError, match="three columns for each node"):
            _kernels.pack(x, nodes, first, rows)
    with pytest.raises(ValueError, match="rows of x"):
        _kernels.pack(x, nodes + 1, 0, rows)
    with pytest.raises(ValueError, match="kept"):
        _kernels.follow(np.zeros(3), np.zeros(4))


@pytest.mark.serial
@pytest.mark.untrapped
def test_follow_tells_of_any_bit():
    values, kept = np.array([0.0, np.nan, 2.0]), np.array([0.0, np.nan, 2.0])
    assert not _kernels.follow(values, kept)
    for change in (-0.0, 1e-300):
        values[0] = change
        assert _kernels.follow(values, kept)
        assert not _kernels.follow(values, kept)
    assert kept[0] == 1e-300
