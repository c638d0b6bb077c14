"""Products in single precision, compared with double precision."""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from dolfinx_nts.solvers.precond.block_ilu import SinglePrecisionOperator
from helpers.dense_factors import NODES, matrix

EPS = np.finfo(np.float32).eps


def product(rows, x):
    y = np.full((len(rows[0]) - 1, x.shape[1]), np.nan)
    _kernels.SingleMatrix(*rows).multiply(x, y)
    return y


def whole(rows, x):
    """The matrix of rows, dense, for columns x."""
    start, column, value = rows
    dim = x.shape[1]
    A = np.zeros((len(start) - 1, len(x), dim, dim))
    A[np.repeat(np.arange(len(A)), np.diff(start)), column] = value.reshape(-1, dim, dim)
    return A


@pytest.mark.serial
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("unit", [1.0, 1e-200, 1e200])
@pytest.mark.parametrize("dim", [2, 3])
def test_product_is_exact_to_single_precision_in_any_units(rng, share, unit, dim):
    (start, column, value), _, _ = matrix(rng, share, dim)
    x = rng.normal(size=(max(column) + 1, dim))
    y = product((start, column, unit * value), x / unit)
    A = whole((start, column, value), x)
    expected = np.einsum("ijkl,jl->ik", A, x)
    bound = 3 * len(x) * EPS * np.einsum("ijkl,jl->ik", np.abs(A), np.abs(x))
    assert np.all(np.abs(y - expected) <= bound)


@pytest.mark.serial
def test_zero_and_rows_without_blocks(rng):
    rows, _, _ = matrix(rng, 1.0)
    start, column, value = rows
    x = rng.normal(size=(max(column) + 1, 3))
    np.testing.assert_array_equal(product(rows, 0 * x), np.zeros((NODES, 3)))
    np.testing.assert_array_equal(product((start, column, 0 * value), x), np.zeros((NODES, 3)))
    none = np.zeros(3, dtype=np.int64), np.empty(0, dtype=np.int32), np.empty(0)
    np.testing.assert_array_equal(product(none, x[:0]), np.zeros((2, 3)))


@pytest.mark.serial
def test_values_are_copied_at_construction(rng):
    (start, column, value), _, _ = matrix(rng, 1.0)
    x, y, again = rng.normal(size=(max(column) + 1, 3)), *np.empty((2, NODES, 3))
    A = _kernels.SingleMatrix(start, column, value)
    A.multiply(x, y)
    value[:] = np.nan
    A.multiply(x, again)
    np.testing.assert_array_equal(y, again)


@pytest.mark.serial
def test_kernel_refuses_arrays_of_wrong_shape(rng):
    rows, _, _ = matrix(rng, 1.0)
    A = _kernels.SingleMatrix(*rows)
    x, y = np.zeros((max(rows[1]) + 1, 3)), np.zeros((NODES, 3))
    with pytest.raises(ValueError, match="a row for each column"):
        A.multiply(x[:-1], y)
    with pytest.raises(ValueError, match="y: expected shape"):
        A.multiply(x, y[:-1])
    with pytest.raises(ValueError, match="ascending offsets, from 0 to the length of column"):
        _kernels.SingleMatrix(rows[0][:-1], *rows[1:])


def test_products_of_single_precision_include_all_ranks(comm, matrices, agree):
    rows, dense, _ = matrices
    operator = SinglePrecisionOperator(rows)
    A = operator.matrix()
    x, y = A.createVecs()
    first, last = x.getOwnershipRange()
    values = np.random.default_rng(0).normal(size=len(dense))
    x.array[:] = values[first:last]
    A.mult(x, y)
    mine = dense[first:last]
    bound = len(dense) * EPS * np.abs(mine) @ np.abs(values)
    assert agree(np.all(np.abs(y.array - mine @ values) <= bound))
