"""Products of constraint rows with the eliminated directions of their nodes."""

import numpy as np
import pytest

from dolfinx_nts import _kernels

pytestmark = pytest.mark.serial


def problem(rng, b, h):
    """Arguments of the kernel: nodes 0 to 3 are constrained, other nodes depend on h of them."""
    count, c, d = 9, b, 5
    rank = np.array([1, 0, b, 1], dtype=np.int32)
    nodes = np.array(
        [[node, *rng.integers(0, count, d - 1)] for node in (2, 0, 3, 1)], dtype=np.int32
    )
    parents = np.repeat(np.arange(count, dtype=np.int32)[:, None], h, axis=1)
    weights = np.zeros((count, h))
    weights[:, 0] = 1
    parents[5:], weights[5:] = rng.integers(0, 4, (count - 5, h)), rng.uniform(size=(count - 5, h))
    directions = np.zeros((c, count, b))
    for own, held in zip(nodes[:, 0], rank, strict=True):
        directions[:held, own] = rng.normal(size=(held, b))
    rows = rng.normal(size=(len(rank), 3, d * b))
    return nodes, rank, rows, parents, weights, directions


def dense(nodes, rank, rows, parents, weights, directions):
    """All of G^T E, with constraint a of a node at c node + a: G and E as matrices."""
    c, n, b = directions.shape
    G, E, travel = np.zeros((c * n, n, b)), np.zeros((c * n, n, b)), np.zeros((n, n))
    np.add.at(travel, (np.arange(n)[:, None], parents), weights)
    for own, held, some, row in zip(nodes[:, 0], rank, nodes, rows, strict=True):
        for a in range(held):
            np.add.at(G[c * own + a], some, row[a].reshape(-1, b))
    for vertex in range(n):
        for a in range(c):
            E[c * vertex + a] = travel[:, vertex, None] * directions[a, vertex]
    return G.reshape(c * n, -1) @ E.reshape(c * n, -1).T


@pytest.mark.parametrize(("b", "h"), [(2, 1), (3, 1), (2, 2), (3, 4)])
@pytest.mark.parametrize("transposed", [False, True])
def test_entries_agree_with_the_product_of_dense_matrices(b, h, transposed, rng):
    arguments = problem(rng, b, h)
    row, column, value = _kernels.constraint_products(*arguments)
    whole = dense(*arguments)
    if transposed:
        row, column, whole = column, row, whole.T
    nodes, rank = arguments[:2]
    held = [b * own + a for own, r in zip(nodes[:, 0], rank, strict=True) for a in range(r)]
    A = np.zeros_like(whole)
    np.add.at(A, (row, column), value)
    assert np.isin(row, held).all()
    assert np.isin(column, held).all()
    assert A[np.ix_(held, held)] == pytest.approx(whole[np.ix_(held, held)], rel=1e-13, abs=1e-13)
    assert np.count_nonzero(whole) == np.count_nonzero(A)


def test_nodes_without_parents_are_their_own(rng):
    *arguments, parents, weights, directions = problem(rng, 3, 1)
    parents[:, 0], weights[:] = np.arange(len(parents)), 1.0
    products = _kernels.constraint_products(*arguments, parents, weights, directions)
    none = np.empty((len(parents), 0))
    bare = _kernels.constraint_products(*arguments, none.astype(np.int32), none, directions)
    assert all(map(np.array_equal, products, bare))


@pytest.mark.parametrize("b", [2, 3])
def test_eliminated_directions_are_normals_or_own_parts_of_the_rows(b, rng):
    _, rank, rows, *_ = problem(rng, b, 1)
    normal = rng.normal(size=(len(rank), b))
    directions = _kernels.eliminated_directions(rank, rows, normal, b)
    for own, held, each, row in zip(directions, rank, normal, rows, strict=True):
        expected = each[None] if held == 1 else row[:held, :b]
        assert np.array_equal(own[:held], expected)
        assert (own[held:] == 0).all()


def test_rows_that_are_not_numbers_have_entries_of_constrained_nodes_only(rng):
    nodes, rank, rows, *others = problem(rng, 3, 1)
    rows[0] = np.nan
    row, column, value = _kernels.constraint_products(nodes, rank, rows, *others)
    number = np.array([3, 6, 9, 10, 11], dtype=np.int64)
    assert np.isnan(value[row == 6]).all()
    assert np.isin(column, number).all()
    system = _kernels.SmallSystem(number, row, column, value)
    assert np.isnan(system.solve(np.ones(len(number)))).all()


def test_entries_of_unknown_rows_or_columns_are_refused():
    number, one = np.array([2, 5], dtype=np.int64), np.ones(1)
    known, unknown = np.array([5], dtype=np.int64), np.array([3], dtype=np.int64)
    for place in ((known, unknown), (unknown, known)):
        with pytest.raises(
            ValueError, match="number: expected every number that row and column contain"
        ):
            _kernels.SmallSystem(number, *place, one)
