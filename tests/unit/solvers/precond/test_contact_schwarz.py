"""Correction in the contact subdomain, compared with dense matrices.

Where every node neighbours every other, the incomplete factors are complete.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from dolfinx_nts import _kernels
from dolfinx_nts.solvers.linear.contact_blocks import ContactBlocks
from dolfinx_nts.solvers.precond.contact_schwarz import SerialSubdomain
from helpers.contact_blocks import NODES, OWNED, blocks, dense, kinds

pytestmark = pytest.mark.serial

SINGLE = 100 * np.finfo(np.float32).eps
CONDITION = 100  # of these matrices
FAR = 4  # nodes at the end that only neighbour each other
NO_PLACES, NO_GHOSTS = np.empty(0, dtype=np.int32), np.empty((0, 6))


def matrix(rng, far=0):
    """Return a random block matrix as sparse rows, and as a dense matrix."""
    near = NODES - far
    start, column, value = [0], [], []
    full = np.zeros((NODES, NODES, 3, 3))
    for i in range(NODES):
        columns = np.arange(near) if i < near else np.arange(near, NODES)
        blocks = 0.1 * rng.normal(size=(len(columns), 3, 3))
        blocks[columns == i] += 5 * np.eye(3)
        full[i, columns] = blocks
        column.append(columns)
        value.append(blocks.ravel())
        start.append(start[-1] + len(columns))
    rows = np.array(start), np.concatenate(column).astype(np.int32), np.concatenate(value)
    return rows, full.transpose(0, 2, 1, 3).reshape(3 * NODES, 3 * NODES)


def stars(rng):
    """Return rows of three contact nodes, a neighbour of each, and a segment; also dense."""
    segment, contact = np.arange(4), np.arange(7, 10)
    pattern = np.eye(NODES, dtype=bool)
    pattern[contact, contact - 3] = pattern[contact - 3, contact] = True
    pattern[np.ix_(segment, segment)] = True
    full = np.where(pattern[..., None, None], 0.3 * rng.normal(size=(NODES, NODES, 3, 3)), 0)
    full[np.arange(NODES), np.arange(NODES)] += 5 * np.eye(3)
    start = np.concatenate([[0], np.cumsum(pattern.sum(axis=1))])
    rows = start, np.nonzero(pattern)[1].astype(np.int32), full[pattern].ravel()
    lists = np.column_stack([contact, np.tile(segment, (3, 1))]).astype(np.int32)
    return rows, full.transpose(0, 2, 1, 3).reshape(3 * NODES, 3 * NODES), lists


def projections(E, G, F):
    """Return Z and Z~^T."""
    one = np.eye(3 * NODES)
    return one - E @ np.linalg.solve(G.T @ E, G.T), one - F @ np.linalg.solve(E.T @ F, E.T)


def made(start, column, value, places=NO_PLACES):
    """Factors of a matrix whose columns are numbered as in vectors, or permuted."""
    return _kernels.ContactSchwarz(start, column, value, places)


@kinds
def test_complete_factors_solve_the_projected_system(kind, rng):
    rows, K = matrix(rng)
    arrays = blocks(kind, rng)
    E, G, F, C = dense(*arrays)
    Z, Zt = projections(E, G, F)
    schwarz = made(*rows)
    schwarz.add(_kernels.Elimination(*arrays))
    assert schwarz.build()
    assert schwarz.size == NODES
    r = Zt @ rng.normal(size=3 * NODES)
    z = rng.normal(size=(NODES, 3))  # any guess
    schwarz.correct(r.reshape(-1, 3), z, NO_GHOSTS)
    # Only the rows of the contact nodes remain for the projection.
    A = Zt @ (K + C) @ Z
    residual = A @ z.ravel() - r
    largest = np.linalg.norm(A, axis=0).max()  # below the norm of A
    assert np.linalg.norm(residual) < SINGLE * largest * np.linalg.norm(z)


@pytest.mark.parametrize("rank", [0, 1, 3])
def test_contact_nodes_on_one_segment_are_solved_exactly(rank, rng):
    """Their fill is in the pattern if they are eliminated first, for any stiffness."""
    rows, K, lists = stars(rng)
    m, k = lists.shape
    own = np.linalg.qr(rng.normal(size=(m, 3, 3)))[0]
    gradients, columns = (0.2 * rng.normal(size=(m, 3, 3 * k)) for _ in range(2))
    gradients[..., :3] += own
    columns[..., :3] += own
    tangent = 30 * rng.normal(size=(m, 3 * k, 3 * k))
    tangent = tangent @ tangent.transpose(0, 2, 1) / (3 * k)
    start = np.arange(0, lists.size + 1, k)
    ranks = np.full(m, rank, dtype=np.int32)
    arrays = (start, lists.ravel(), ranks, own[:, 0].copy(), gradients.ravel(), columns.ravel())
    arrays += (np.zeros((m, 3, 3)), lists, tangent)
    E, G, F, C = dense(*arrays)
    Z, Zt = projections(E, G, F) if rank else 2 * (np.eye(3 * NODES),)
    schwarz = made(*rows)
    schwarz.add(_kernels.Elimination(*arrays))
    assert schwarz.build()
    r = Zt @ np.pad(rng.normal(size=30), (0, 3 * NODES - 30))
    z = np.zeros((NODES, 3))
    schwarz.correct(r.reshape(-1, 3), z, NO_GHOSTS)
    A = Zt @ (K + C) @ Z
    residual = A @ z.ravel() - r
    largest = np.linalg.norm(A, axis=0).max()
    assert np.linalg.norm(residual) < SINGLE * largest * np.linalg.norm(z)


@pytest.mark.parametrize(("force", "stiffness"), [(1e-99, 1e-60), (1e99, 1e60), (1e-60, 1e60)])
def test_units_do_not_matter(force, stiffness, rng):
    (start, column, value), _ = matrix(rng)
    *others, slopes, lists, tangent = blocks(4, rng)
    r, guess = rng.normal(size=(2, NODES, 3))
    results = []
    for f, k in ((1.0, 1.0), (force, stiffness)):
        schwarz = made(start, column, k * value)
        schwarz.add(_kernels.Elimination(*others, k * slopes, lists, k * tangent))
        assert schwarz.build()
        z = f / k * guess
        schwarz.correct(f * r, z, NO_GHOSTS)
        results.append(z * (k / f))
    largest = np.abs(results[0]).max()
    np.testing.assert_allclose(*results, rtol=0, atol=CONDITION * SINGLE * largest)


@kinds
def test_factors_of_former_pairs_leave_nothing_behind(kind, rng):
    rows, _ = matrix(rng, FAR)
    first, second = blocks(kind, rng), blocks(kind, rng, NODES - FAR)
    former, fresh = made(*rows), made(*rows)
    former.add(_kernels.Elimination(*first))
    former.build()
    former.clear()
    r, z = rng.normal(size=(2, NODES, 3))
    results = []
    for schwarz in (former, fresh):
        schwarz.add(_kernels.Elimination(*second))
        assert schwarz.build()
        assert schwarz.size == NODES - FAR
        result = z.copy()
        schwarz.correct(r, result, NO_GHOSTS)
        results.append(result)
    np.testing.assert_array_equal(*results)


def test_rows_of_other_values_are_read_again(rng):
    (start, column, value), _ = matrix(rng)
    contacts = [ContactBlocks(*blocks(4, rng))]
    rows = SimpleNamespace(start=start, column=column, value=value)
    domain = SerialSubdomain(rows)
    domain.build(contacts, version=1)
    value *= 1.5  # in place, as an assembled matrix has its values
    domain.build(contacts, version=2)
    fresh = SerialSubdomain(rows)
    fresh.build(contacts, version=1)
    r, z = rng.normal(size=(2, NODES, 3))
    results = z.copy(), z.copy()
    for some, result in zip((domain, fresh), results, strict=True):
        some.correct(r, result)
    np.testing.assert_array_equal(*results)


@pytest.mark.parametrize(("wide", "size"), [(False, 2), (True, 3)])
def test_a_wide_subdomain_has_neighbours_of_neighbours(wide, size, rng):
    """In a chain whose first node is held at rest."""
    n, link = 6, np.eye(3)
    full = np.zeros((n, n, 3, 3))
    for i in range(n):
        full[i, i] = 2 * link
        full[i, [j for j in (i - 1, i + 1) if 0 <= j < n]] = -link
    pattern = full.any(axis=(2, 3))
    start = np.concatenate([[0], np.cumsum(pattern.sum(axis=1))])
    schwarz = made(start, np.nonzero(pattern)[1].astype(np.int32), full[pattern].ravel())
    node, rank = np.array([0], dtype=np.int32), np.array([3], dtype=np.int32)
    lists, normal = (np.array([0, 1]), node, rank), np.array([[1.0, 0.0, 0.0]])
    none = np.zeros((1, 3, 3)), np.empty((0, 1), dtype=np.int32), np.empty((0, 3, 3))
    schwarz.add(_kernels.Elimination(*lists, normal, link.ravel(), link.ravel(), *none))
    assert schwarz.build(wide=wide)
    assert schwarz.size == size
    r, z = rng.normal(size=(n, 3)), np.zeros((n, 3))
    r[0] = 0
    schwarz.correct(r, z, NO_GHOSTS)
    inner = full[1:size, 1:size, 0, 0]
    expected = np.zeros((n, 3))
    expected[1:size] = np.linalg.solve(inner, r[1:size])
    np.testing.assert_allclose(z, expected, rtol=0, atol=SINGLE * np.abs(expected).max())


@kinds
def test_nodes_far_from_contact_are_left_alone(kind, rng):
    rows, _ = matrix(rng, FAR)
    arrays = blocks(kind, rng, NODES - FAR)
    schwarz = made(*rows)
    schwarz.add(_kernels.Elimination(*arrays))
    assert schwarz.build()
    assert schwarz.size == NODES - FAR
    r, z = rng.normal(size=(2, NODES, 3))
    before = z.copy()
    schwarz.correct(r, z, NO_GHOSTS)
    np.testing.assert_array_equal(z[-FAR:], before[-FAR:])
    assert np.all(np.any(z[:-FAR] != before[:-FAR], axis=1))


def test_nodes_without_rows_are_left_alone(rng):
    (start, column, value), _ = matrix(rng)
    rows = NODES - 2
    schwarz = made(start[: rows + 1], column[: start[rows]], value[: 9 * start[rows]])
    schwarz.add(_kernels.Elimination(*blocks(4, rng, rows)))
    assert schwarz.build()
    assert schwarz.size == rows
    z = rng.normal(size=(NODES, 3))
    before = z.copy()
    schwarz.correct(rng.normal(size=(NODES, 3)), z, NO_GHOSTS)
    np.testing.assert_array_equal(z[rows:], before[rows:])
    assert np.all(np.any(z[:rows] != before[:rows], axis=1))


@kinds
def test_values_may_lie_anywhere_in_vectors_and_at_ghosts(kind, rng):
    rows, _ = matrix(rng)
    contacts = _kernels.Elimination(*blocks(kind, rng))
    r, z = rng.normal(size=(2, NODES, 3))
    places = rng.permutation(NODES).astype(np.int32)
    there = np.empty((2, NODES, 3))
    there[:, places] = r, z
    ghosts = np.concatenate(there[:, OWNED:], axis=1)
    schwarz, elsewhere = made(*rows), made(*rows, places)
    for some in (schwarz, elsewhere):
        some.add(contacts)
        assert some.build()
    schwarz.correct(r, z, NO_GHOSTS)
    elsewhere.correct(*there[:, :OWNED], ghosts)
    there[1, OWNED:] = ghosts[:, 3:]
    np.testing.assert_array_equal(there[1, places], z)
    with pytest.raises(ValueError, match="for each row and column of the matrix"):
        elsewhere.correct(*there[:, :OWNED], ghosts[1:])
    with pytest.raises(ValueError, match="places: expected no negative entry"):
        made(*rows, places - 1)


def test_singular_rows_are_reported(rng):
    start, column, value = matrix(rng)[0]
    schwarz = made(start, column, 0 * value)
    *others, slopes, lists, tangent = blocks(4, rng)
    schwarz.add(_kernels.Elimination(*others, 0 * slopes, lists, 0 * tangent))
    assert not schwarz.build()


def test_wrong_matrices_and_nodes_are_refused(rng):
    start, column, value = matrix(rng)[0]
    with pytest.raises(
        ValueError, match="expected ascending offsets, from 0 to the length of column"
    ):
        made(start[:-1], column, value)
    with pytest.raises(ValueError, match=r"value: expected shape"):
        made(start, column, value[:-1])
    schwarz = made(start, column, value)
    lists, nodes, *others = blocks(4, rng)
    with pytest.raises(
        ValueError, match="expected node numbers below the number of rows of the matrix"
    ):
        schwarz.add(_kernels.Elimination(lists, nodes + NODES, *others))
    with pytest.raises(ValueError, match="for each row and column of the matrix"):
        schwarz.correct(*np.zeros((2, NODES - 1, 3)), NO_GHOSTS)


@pytest.mark.parametrize("sign", [-1, 1])
def test_largest_sizes_pass_on_nan(rng, sign):
    a, b = rng.normal(size=(2, 4, 3))
    assert _kernels.largest_size(a) == np.abs(a).max()
    assert _kernels.largest_difference(a, b) == np.abs(a - b).max()
    assert _kernels.largest_size(a[:0]) == _kernels.largest_difference(a[:0], b[:0]) == 0
    a[1, 0] = sign * np.inf
    assert _kernels.largest_size(a) == np.inf
    a[1, 1] = np.copysign(np.nan, sign)
    assert np.isnan([_kernels.largest_size(a), _kernels.largest_difference(a, b)]).all()
    with pytest.raises(ValueError, match="two arrays of equal size"):
        _kernels.largest_difference(a, b[:2])


def test_largest_violation_agrees_with_constraints(rng):
    excess = rng.normal(size=(4, 3))
    rank = np.array([0, 1, 3, 2], dtype=np.int32)
    of_constraints = [*excess[1, :1], *excess[2], *excess[3, :2]]
    assert _kernels.largest_violation(excess, rank) == np.abs(of_constraints).max()
    excess[[0, 1, 3], [0, 1, 2]] = np.nan  # without constraints
    assert _kernels.largest_violation(excess, rank) == np.abs(of_constraints).max()
    excess[3, 1] = np.nan
    assert np.isnan(_kernels.largest_violation(excess, rank))
    assert _kernels.largest_violation(excess[:0], rank[:0]) == 0
    with pytest.raises(ValueError, match="excess"):
        _kernels.largest_violation(excess, rank[:2])
