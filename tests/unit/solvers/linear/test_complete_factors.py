"""Complete factors in single precision, against dense matrices."""

import itertools

import numpy as np
import pytest

from dolfinx_nts import _kernels

pytestmark = pytest.mark.serial

EPS = np.finfo(np.float32).eps


def grid(shape, *, bodies=1):
    """Return the pattern of nodes of cells, ascending, and positions; bodies lie side by side."""
    X = np.array(list(itertools.product(*map(range, shape))), dtype=float)
    near = np.abs(X[:, None] - X).max(axis=2) <= 1
    near = np.kron(np.eye(bodies, dtype=bool), near)
    row, column = np.nonzero(near)
    start = np.searchsorted(row, np.arange(len(near) + 1))
    places = [X + np.array([2.0 * shape[0] * body, 0.0, 0.0]) for body in range(bodies)]
    return start, column.astype(np.int32), np.concatenate(places)


def matrix(rng, start, column, dim):
    """Return random blocks with a dominant diagonal, and the dense matrix."""
    n = len(start) - 1
    row = np.repeat(np.arange(n), np.diff(start))
    value = rng.normal(size=(len(column), dim, dim))
    value[row == column] += 20 * dim * np.eye(dim)
    A = np.zeros((n, n, dim, dim))
    A[row, column] = value
    return value, A.transpose(0, 2, 1, 3).reshape(dim * n, -1)


def solve(start, column, X, value, b):
    factors = _kernels.CompleteFactors(start, column, X)
    assert factors.factorise(start, column, value.ravel())
    x = np.full_like(b, np.nan)
    factors.apply(b, x)
    return x


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    ("shape", "bodies"),
    [((1, 1, 1), 1), ((4, 2, 2), 1), ((9, 7, 3), 1), ((5, 4, 2), 3)],
    ids=["node", "front", "box", "bodies"],
)
def test_solution_agrees_with_the_dense_matrix(rng, shape, bodies, dim):
    start, column, X = grid(shape, bodies=bodies)
    value, A = matrix(rng, start, column, dim)
    b = rng.normal(size=(len(X), dim))
    expected = np.linalg.solve(A, b.ravel())
    x = solve(start, column, X, value, b)
    error = np.linalg.norm(x.ravel() - expected) / np.linalg.norm(expected)
    assert error < len(A) * EPS * np.linalg.cond(A)


def test_many_right_hand_sides_are_solved_together(rng):
    start, column, X = grid((5, 4, 4))
    value, A = matrix(rng, start, column, 3)
    factors = _kernels.CompleteFactors(start, column, X)
    assert factors.factorise(start, column, value.ravel())
    b = rng.normal(size=(19, len(X), 3)) * 10.0 ** np.arange(19)[:, None, None]
    x = np.empty_like(b)
    factors.apply(b, x)
    error = (A @ x.reshape(19, -1).T).T - b.reshape(19, -1)
    assert np.all(np.abs(error).max(axis=1) < len(A) * EPS * np.abs(b).max(axis=(1, 2)))


def test_nodes_in_a_plane_up_to_round_off_are_not_divided(rng):
    start, column, X = grid((6, 6, 1))
    X[:, 2] = 1 + EPS**2 * (np.arange(len(X)) == 3)
    X[:, :2] = 1.0
    value, A = matrix(rng, start, column, 3)
    b = rng.normal(size=(len(X), 3))
    x = solve(start, column, X, value, b)
    np.testing.assert_allclose(A @ x.ravel(), b.ravel(), atol=len(A) * EPS * np.abs(b).max())


def test_rows_are_exchanged_where_the_diagonal_is_zero(rng):
    start, column, X = grid((3, 3, 1))
    value, _ = matrix(rng, start, column, 2)
    row = np.repeat(np.arange(len(X)), np.diff(start))
    value[row == column] = 100 * np.array([[0.0, 1.0], [1.0, 0.0]])
    A = np.zeros((len(X), len(X), 2, 2))
    A[row, column] = value
    A = A.transpose(0, 2, 1, 3).reshape(2 * len(X), -1)
    b = rng.normal(size=(len(X), 2))
    x = solve(start, column, X, value, b)
    np.testing.assert_allclose(A @ x.ravel(), b.ravel(), atol=1e3 * EPS)


def test_units_and_the_place_of_the_result_do_not_matter(rng):
    # Neither of these numbers is within the range of single precision.
    start, column, X = grid((6, 5, 3))
    value, _ = matrix(rng, start, column, 3)
    b = rng.normal(size=(len(X), 3))
    x = solve(start, column, X, value, b)
    scaled = solve(start, column, 1e3 * X, 2.0**300 * value, 2.0**-200 * b)
    np.testing.assert_array_equal(scaled, 2.0**-500 * x)
    factors = _kernels.CompleteFactors(start, column, X)
    assert factors.factorise(start, column, value.ravel())
    factors.apply(b, b)
    np.testing.assert_array_equal(b, x)


@pytest.mark.parametrize("shape", [(24, 24, 2), (2, 24, 24)])
def test_dissection_keeps_fill_small(shape):
    # A band of the short side would fill 2 b n with b = 3 (2 * 24 + 2), about 3e5 numbers a plane.
    entries = []
    for n in (12, 24):
        start, column, X = grid([min(n, extent) for extent in shape])
        factors = _kernels.CompleteFactors(start, column, X)
        assert factors.factorise(start, column, matrix_of_ones(start, column))
        entries.append(factors.entries)
    # Four times the nodes: n log n makes it 5 to 6, a band 8, a dense matrix 16.
    assert entries[1] < 6.5 * entries[0]


def matrix_of_ones(start, column):
    row = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return ((row == column)[:, None, None] * 100.0 * np.eye(3) + 0.1).ravel()


@pytest.mark.parametrize("case", ["zero", "not finite"])
def test_singular_matrix_is_reported(rng, case):
    start, column, X = grid((4, 4, 3))
    value, _ = matrix(rng, start, column, 3)
    row = np.repeat(np.arange(len(X)), np.diff(start))
    if case == "zero":
        value[(row == 5) | (column == 5)] = 0
    else:
        value[(row == 5) & (column == 5)] = np.nan
    factors = _kernels.CompleteFactors(start, column, X)
    assert not factors.factorise(start, column, value.ravel())
    with pytest.raises(ValueError, match=r"b: expected shape \(0, 3\)"):
        factors.apply(np.zeros((len(X), 3)), np.zeros((len(X), 3)))
    assert factors.factorise(start, column, matrix_of_ones(start, column))


def test_wrong_arguments_are_refused(rng):
    start, column, X = grid((3, 2, 2))
    value = matrix_of_ones(start, column)
    make = _kernels.CompleteFactors
    with pytest.raises(ValueError, match="X: expected shape"):
        make(start, column, X[:-1])
    with pytest.raises(ValueError, match="expected at least one entry"):
        make(start[:0], column, X)
    with pytest.raises(
        ValueError, match="expected ascending offsets, from 0 to the length of column"
    ):
        make(start - 1, column, X)
    with pytest.raises(ValueError, match="expected row numbers"):
        make(start, column + 1, X)
    wrong = column.copy()
    wrong[:2] = wrong[1::-1]
    with pytest.raises(ValueError, match="expected a symmetric pattern, ascending in each row"):
        make(start, wrong, X)
    factors = make(start, column, X)
    with pytest.raises(ValueError, match="expected the sparsity pattern with which"):
        factors.factorise(start[:-1], column[: start[-2]], value[: 9 * start[-2]])
    assert factors.factorise(start, column, value)
    b = np.zeros((len(X), 3))
    with pytest.raises(ValueError, match="b: expected shape"):
        factors.apply(b[:-1], b)
    with pytest.raises(ValueError, match="x: expected shape"):
        factors.apply(b, b[:-1].copy())
