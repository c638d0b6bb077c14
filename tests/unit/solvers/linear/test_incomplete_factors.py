"""Incomplete factors in single precision, against their definition in dense matrices."""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from helpers.dense_factors import (
    BEYOND,
    EPS,
    NODES,
    definition,
    dense,
    filled,
    matrix,
    rounding,
)

pytestmark = pytest.mark.serial


def solve(rows, order, b, *, fill=False):
    factors = _kernels.IncompleteFactors()
    assert factors.factorise(*rows, order.astype(np.int32), fill)
    x = np.full_like(b, np.nan)
    factors.apply(b, x)
    return x


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("is_natural", [True, False])
@pytest.mark.parametrize("fill", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_factors_agree_with_the_definition(rng, share, is_natural, fill, dim):
    rows, A, pattern = matrix(rng, share, dim)
    order = np.arange(NODES) if is_natural else rng.permutation(NODES)
    b = rng.normal(size=(NODES, dim))
    x = solve(rows, order, b, fill=fill)
    pattern = pattern[order][:, order]
    L, U = definition(A[order][:, order], filled(pattern) if fill else pattern)
    expected = np.linalg.solve(dense(L) @ dense(U), b[order].ravel())
    error = np.abs(x[order].ravel() - expected)
    assert np.all(error < rounding(L, U, expected))
    if share == 1.0:
        np.testing.assert_allclose(
            expected, np.linalg.solve(dense(A), b.ravel()).reshape(-1, dim)[order].ravel()
        )


def test_units_do_not_matter(rng):
    # Neither of these numbers is within the range of single precision.
    (start, column, value), _, _ = matrix(rng, 0.5)
    b, order = rng.normal(size=(NODES, 3)), np.arange(NODES)
    x = solve((start, column, value), order, b)
    scaled = solve((start, column, 2.0**300 * value), order, 2.0**-200 * b)
    np.testing.assert_array_equal(scaled, 2.0**-500 * x)
    np.testing.assert_array_equal(solve((start, column, value), order, 0 * b), 0 * b)


@pytest.mark.parametrize("dim", [2, 3])
def test_last_rows_may_be_kept_elsewhere(rng, dim):
    (start, column, value), _, _ = matrix(rng, 0.5, dim)
    order = rng.permutation(NODES).astype(np.int32)
    b, first = rng.normal(size=(NODES, dim)), NODES // 3
    expected = solve((start, column, value), order, b)
    factors, blocks = _kernels.IncompleteFactors(), np.split(value, [dim**2 * start[first]])
    assert factors.factorise(start, column, blocks[0], order, behind=blocks[1])
    x = np.full_like(b, np.nan)
    factors.apply(b[:first], x, b[first:])
    np.testing.assert_array_equal(x, expected)
    factors.apply_at(np.arange(NODES, dtype=np.int32), b[:first], x[:1], b[first:])
    np.testing.assert_array_equal(x, expected)
    with pytest.raises(ValueError, match="expected"):
        factors.factorise(start, column, blocks[0][:-1], order, behind=blocks[1])
    for behind in (value[1:], np.concatenate([value, value])):
        with pytest.raises(
            ValueError, match="behind: expected whole blocks, at most one for each entry of column"
        ):
            factors.factorise(start, column, blocks[0], order, behind=behind)
    for behind in (b[first + 1 :], b[: 2 * first, :1], np.concatenate([b, b])):
        with pytest.raises(ValueError, match="expected"):
            factors.apply(b[:first], x, behind)


@pytest.mark.parametrize("row", range(2))
@pytest.mark.parametrize("dim", [2, 3])
def test_entries_far_below_rounding_leave_no_trace(row, dim):
    """Their products would be denormal numbers, with which processors are slow."""
    start, column = np.array([0, 2, 4]), np.array([0, 1, 0, 1], dtype=np.int32)
    value = np.array([np.eye(dim), 1e-20 * np.ones((dim, dim))] * 2)[[0, 1, 3, 2]]
    b = np.zeros((2, dim))
    b[row] = 1
    np.testing.assert_array_equal(solve((start, column, value.ravel()), np.arange(2), b), b)


@pytest.mark.parametrize("dim", [2, 3])
def test_decaying_solutions_end_at_zero(dim):
    # x_i = -1e-3 x_(i-1), single precision ends at 1e-45.
    n = 40
    start = np.array([0, *range(1, 2 * n, 2)])
    column = np.array([0, *(j for i in range(1, n) for j in (i - 1, i))], dtype=np.int32)
    value = np.concatenate(
        [
            np.eye(dim) * (1.0 if j == i else 1e-3)
            for i in range(n)
            for j in column[start[i] : start[i + 1]]
        ]
    )
    b = np.zeros((n, dim))
    b[0] = 1
    x = solve((start, column, value.ravel()), np.arange(n), b)
    exact = (-1e-3) ** np.arange(n)
    large = np.abs(exact) > 1e-24
    np.testing.assert_allclose(x[large, 0], exact[large], rtol=4 * n * EPS)
    assert np.all(x[~large] == 0)


def test_values_of_the_first_rows_are_enough(rng):
    rows, _, _ = matrix(rng, 0.5)
    factors = _kernels.IncompleteFactors()
    assert factors.factorise(*rows, np.arange(NODES, dtype=np.int32)[::-1].copy())
    b = rng.normal(size=(NODES, 3))
    some, every = np.empty((NODES - 2, 3)), b.copy()
    factors.apply(b, some)
    factors.apply(every, every)  # in place
    np.testing.assert_array_equal(some, every[:-2])


@pytest.mark.parametrize("case", ["zero", "dependent", "eliminated", "missing", "not finite"])
def test_singular_diagonal_is_reported(rng, case):
    (start, column, value), _, _ = matrix(rng, 1.0)
    blocks = value.reshape(-1, 3, 3)
    diagonal = 4 * (NODES + BEYOND) + np.flatnonzero(column[start[4] : start[5]] == 4)[0]
    if case == "zero":
        blocks[start[4] : start[5]] = 0
    elif case == "not finite":
        blocks[diagonal] = np.nan
    elif case == "missing":
        column[diagonal] = NODES
    else:
        column[:], row = np.arange(NODES + BEYOND).tolist() * NODES, NODES + BEYOND
        blocks[:] = 0
        blocks[np.arange(NODES) * (row + 1)] = np.eye(3)
        if case == "dependent":
            blocks[4 * (row + 1)] = [[1, 2, 0], [2, 4, 0], [0, 0, 1]]
        else:
            blocks[4 * row + 3] = blocks[3 * row + 4] = np.eye(3)
    factors, order = _kernels.IncompleteFactors(), np.arange(NODES, dtype=np.int32)
    assert not factors.factorise(start, column, value, order)
    with pytest.raises(ValueError, match=r"b: expected shape \(0, 3\)"):
        factors.apply(np.zeros((NODES, 3)), np.zeros((NODES, 3)))
    # The next matrix is independent of it.
    assert factors.factorise(*matrix(rng, 0.5)[0], order)


def test_wrong_arguments_are_refused(rng):
    (start, column, value), _, _ = matrix(rng, 0.5)
    factors, order = _kernels.IncompleteFactors(), np.arange(NODES, dtype=np.int32)
    with pytest.raises(
        ValueError, match="expected ascending offsets, from 0 to the length of column"
    ):
        factors.factorise(start[:-1], column, value, order[:-1])
    with pytest.raises(
        ValueError, match="expected ascending offsets, from 0 to the length of column"
    ):
        factors.factorise(start[[0, 2, 1, *range(3, NODES + 1)]], column, value, order)
    with pytest.raises(ValueError, match="expected at least one entry"):
        factors.factorise(start[:0], column[:0], value[:0], order[:0])
    with pytest.raises(ValueError, match="expected no negative entry"):
        factors.factorise(start, column - 1, value, order)
    with pytest.raises(ValueError, match="value: expected shape"):
        factors.factorise(start, column, value[:-1], order)
    with pytest.raises(ValueError, match="order: expected shape"):
        factors.factorise(start, column, value, order[:-1])
    for wrong in (order - 1, order + 1, 0 * order):
        with pytest.raises(ValueError, match="order: expected each row once"):
            factors.factorise(start, column, value, wrong)
    assert factors.factorise(start, column, value, order)
    b = np.zeros((NODES, 3))
    with pytest.raises(ValueError, match="b: expected shape"):
        factors.apply(b[:-1], b)
    with pytest.raises(ValueError, match="expected no more rows"):
        factors.apply(b, np.zeros((NODES + 1, 3)))
    with pytest.raises(ValueError, match="x: expected shape"):
        factors.apply(b, np.zeros(3 * NODES))


def test_some_rows_alone_agree_with_the_factors(rng):
    rows, A, pattern = matrix(rng, 0.5)
    order, b = rng.permutation(NODES), rng.normal(size=(NODES, 3))
    factors = _kernels.IncompleteFactors()
    assert factors.factorise(*rows, order.astype(np.int32))
    places = np.sort(rng.choice(NODES, NODES // 2, replace=False)).astype(np.int32)
    x = np.full_like(b, np.nan)
    factors.apply_at(places, b, x)
    L, U = (
        part[np.ix_(places, places)]
        for part in definition(A[order][:, order], pattern[order][:, order])
    )
    own = order[places]
    expected = np.linalg.solve(dense(L) @ dense(U), b[own].ravel())
    assert np.all(np.abs(x[own].ravel() - expected) < rounding(L, U, expected))
    assert np.isnan(np.delete(x, own, axis=0)).all()
    everywhere, same = np.empty((2, *b.shape))
    factors.apply(b, everywhere)
    factors.apply_at(np.arange(NODES, dtype=np.int32), b, same)
    np.testing.assert_array_equal(same, everywhere)


@pytest.mark.parametrize("places", [[1, 0], [2, 2], [-1], [NODES]])
def test_places_that_are_no_rows_are_refused(rng, places):
    rows, _, _ = matrix(rng, 0.5)
    factors = _kernels.IncompleteFactors()
    assert factors.factorise(*rows, np.arange(NODES, dtype=np.int32))
    b = np.ones((NODES, 3))
    with pytest.raises(ValueError, match="places: expected ascending indices of rows"):
        factors.apply_at(np.array(places, dtype=np.int32), b, b.copy())
