"""Patch preconditioner around the contacts, against dense matrices.

Where every node neighbours every other, the incomplete factors are complete.
"""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from helpers.contact_pairs import NODES, dense, kinds, pairs

pytestmark = pytest.mark.serial

SINGLE = 100 * np.finfo(np.float32).eps
CONDITION = 100  # of the matrices here
FAR = 4  # nodes at the end that only neighbour each other


def matrix(rng, far=0):
    """Return a random block matrix as rows, and dense."""
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


def projections(E, G, F):
    """Return Z and Z~^T."""
    one = np.eye(3 * NODES)
    return one - E @ np.linalg.solve(G.T @ E, G.T), one - F @ np.linalg.solve(E.T @ F, E.T)


@kinds
def test_complete_factors_solve_the_projected_system(k, rng):
    rows, K = matrix(rng)
    arrays = pairs(k, rng)
    E, G, F, C = dense(*arrays)
    Z, Zt = projections(E, G, F)
    patch = _kernels.ContactSchwarz(*rows)
    patch.add(_kernels.Elimination(*arrays))
    assert patch.build()
    assert patch.size == NODES
    r = Zt @ rng.normal(size=3 * NODES)
    z = rng.normal(size=(NODES, 3))  # any guess
    patch.correct(r.reshape(-1, 3), z)
    # Only the rows of the contact nodes in z are left to the projection.
    A = Zt @ (K + C) @ Z
    residual = A @ z.ravel() - r
    largest = np.linalg.norm(A, axis=0).max()  # below the norm of A
    assert np.linalg.norm(residual) < SINGLE * largest * np.linalg.norm(z)


@pytest.mark.parametrize(("force", "stiffness"), [(1e-99, 1e-60), (1e99, 1e60), (1e-60, 1e60)])
def test_units_do_not_matter(force, stiffness, rng):
    (start, column, value), _ = matrix(rng)
    *rest, tangent = pairs(4, rng)
    r, guess = rng.normal(size=(2, NODES, 3))
    results = []
    for f, k in ((1.0, 1.0), (force, stiffness)):
        patch = _kernels.ContactSchwarz(start, column, k * value)
        patch.add(_kernels.Elimination(*rest, k * tangent))
        assert patch.build()
        z = f / k * guess
        patch.correct(f * r, z)
        results.append(z * (k / f))
    largest = np.abs(results[0]).max()
    np.testing.assert_allclose(*results, rtol=0, atol=CONDITION * SINGLE * largest)


@kinds
def test_factors_of_former_pairs_leave_nothing_behind(k, rng):
    rows, _ = matrix(rng, FAR)
    first, second = pairs(k, rng), list(pairs(k, rng))
    second[0] = np.minimum(second[0], NODES - FAR - 1).astype(np.int32)
    kept, fresh = _kernels.ContactSchwarz(*rows), _kernels.ContactSchwarz(*rows)
    kept.add(_kernels.Elimination(*first))
    kept.build()
    kept.clear()
    r, z = rng.normal(size=(2, NODES, 3))
    results = []
    for patch in (kept, fresh):
        patch.add(_kernels.Elimination(*second))
        assert patch.build()
        assert patch.size == NODES - FAR
        result = z.copy()
        patch.correct(r, result)
        results.append(result)
    np.testing.assert_array_equal(*results)


@kinds
def test_nodes_far_from_contact_are_left_alone(k, rng):
    rows, _ = matrix(rng, FAR)
    arrays = list(pairs(k, rng))
    arrays[0] = np.minimum(arrays[0], NODES - FAR - 1).astype(np.int32)
    patch = _kernels.ContactSchwarz(*rows)
    patch.add(_kernels.Elimination(*arrays))
    assert patch.build()
    assert patch.size == NODES - FAR
    r, z = rng.normal(size=(2, NODES, 3))
    before = z.copy()
    patch.correct(r, z)
    np.testing.assert_array_equal(z[-FAR:], before[-FAR:])
    assert np.all(np.any(z[:-FAR] != before[:-FAR], axis=1))


def test_nodes_without_rows_are_left_alone(rng):
    (start, column, value), _ = matrix(rng)
    rows = NODES - 2
    patch = _kernels.ContactSchwarz(
        start[: rows + 1], column[: start[rows]], value[: 9 * start[rows]]
    )
    dofs, *rest = pairs(4, rng)
    patch.add(_kernels.Elimination(np.minimum(dofs, rows - 1).astype(np.int32), *rest))
    assert patch.build()
    assert patch.size == rows
    z = rng.normal(size=(NODES, 3))
    before = z.copy()
    patch.correct(rng.normal(size=(rows, 3)), z)
    np.testing.assert_array_equal(z[rows:], before[rows:])
    assert np.all(np.any(z[:rows] != before[:rows], axis=1))


def test_singular_rows_are_reported(rng):
    start, column, value = matrix(rng)[0]
    patch = _kernels.ContactSchwarz(start, column, 0 * value)
    patch.add(_kernels.Elimination(*pairs(4, rng)[:5], np.zeros((5, 15, 15))))
    assert not patch.build()


def test_wrong_matrices_and_nodes_are_refused(rng):
    start, column, value = matrix(rng)[0]
    with pytest.raises(ValueError, match="expected rows that hold all columns"):
        _kernels.ContactSchwarz(start[:-1], column, value)
    with pytest.raises(ValueError, match=r"value: expected shape"):
        _kernels.ContactSchwarz(start, column, value[:-1])
    patch = _kernels.ContactSchwarz(start, column, value)
    dofs, *rest = pairs(4, rng)
    with pytest.raises(ValueError, match="expected dofs that are rows of the matrix"):
        patch.add(_kernels.Elimination(dofs + NODES, *rest))
    with pytest.raises(ValueError, match="expected a row for each column"):
        patch.correct(np.zeros((NODES, 3)), np.zeros((NODES - 1, 3)))
