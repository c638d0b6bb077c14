"""Projections that eliminate multipliers, against dense matrices."""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from helpers.contact_pairs import NODES, ROUNDING, dense, kinds, pairs

pytestmark = pytest.mark.serial


@kinds
def test_constrain_is_the_projection_on_the_constraints(k, rng):
    arrays = pairs(k, rng)
    E, G, _, _ = dense(*arrays)
    x = rng.normal(size=(NODES, 3))
    z = x.copy()
    _kernels.Elimination(*arrays).constrain(np.empty(0), z)
    expected = x.ravel() - E @ np.linalg.solve(G.T @ E, G.T @ x.ravel())
    np.testing.assert_allclose(z.ravel(), expected, atol=ROUNDING)
    assert np.abs(G.T @ z.ravel()).max() < ROUNDING


@kinds
def test_constrain_reaches_given_values(k, rng):
    arrays = pairs(k, rng)
    _, G, _, _ = dense(*arrays)
    values = rng.normal(size=(5, 3))
    x = np.zeros((NODES, 3))
    _kernels.Elimination(*arrays).constrain(values, x)
    wanted = values[np.arange(3) < arrays[1][:, None]]
    np.testing.assert_allclose(G.T @ x.ravel(), wanted, atol=ROUNDING)


@kinds
def test_act_adds_the_tangent_and_removes_multipliers(k, rng):
    arrays = pairs(k, rng)
    E, _, F, C = dense(*arrays)
    x, y = rng.normal(size=(2, NODES, 3))
    # Vertices are no contact nodes, so rows of the tangent at a contact
    # node come from its own pair alone.
    result = y.copy()
    _kernels.Elimination(*arrays).act(x, result)
    total = y.ravel() + C @ x.ravel()
    expected = total - F @ np.linalg.solve(E.T @ F, E.T @ total)
    np.testing.assert_allclose(result.ravel(), expected, atol=ROUNDING)
    assert np.abs(E.T @ result.ravel()).max() < ROUNDING


@pytest.mark.parametrize("c", [1, 3])
def test_multipliers_balance_forces_along_the_normals(rng, c):
    normal, rest = rng.normal(size=(2, 6, 3))
    columns = rng.normal(size=(6, c, 12))
    columns[0, 0, :3] = np.cross(normal[0], rest[0])  # nothing along the normal
    lambda_N = _kernels.balance(normal, rest, columns)
    total = rest + lambda_N[:, None] * columns[:, 0, :3]
    assert lambda_N[0] == 0
    np.testing.assert_allclose(np.einsum("mi,mi->m", normal, total)[1:], 0, atol=ROUNDING)


@kinds
def test_nodes_move_along_their_normals_to_zero_gap(k, rng):
    dofs, _, normal, gradients, _, _ = pairs(k, rng)
    gap = np.array([0.1, -0.2, 0.1, 5.0, np.nan])
    moves = np.array([True, True, False, True, True])
    x = np.zeros((NODES, 3))
    _kernels.close_gaps(dofs[:, 0], moves, gap, normal, gradients, 1.0, x)
    # To first order in the displacements of the nodes themselves.
    change = np.einsum("mi,mi->m", gradients[:, 0, :3], x[dofs[:, 0]])
    np.testing.assert_allclose(gap[:2] + change[:2], 0, atol=ROUNDING)
    assert np.abs(np.cross(x[dofs[:2, 0]], normal[:2])).max() < ROUNDING
    # Held back, too far, without a gap; and all that are no contact nodes.
    np.testing.assert_array_equal(x[2:], 0)


def test_columns_without_three_numbers_are_refused(rng):
    with pytest.raises(ValueError, match="three numbers of each pair"):
        _kernels.balance(*rng.normal(size=(2, 6, 3)), rng.normal(size=(6, 1, 2)))


def test_wrong_pairs_and_vectors_are_refused(rng):
    dofs, *rest = pairs(3, rng)
    with pytest.raises(ValueError, match="no negative entry"):
        _kernels.Elimination(-dofs - 1, *rest)
    with pytest.raises(ValueError, match="normal: expected shape"):
        _kernels.Elimination(dofs, rest[0], rest[1][:, :2], *rest[2:])
    elimination = _kernels.Elimination(dofs, *rest)
    with pytest.raises(ValueError, match="x: expected a row for each of the dofs"):
        elimination.constrain(np.empty(0), np.zeros((4, 3)))
    with pytest.raises(ValueError, match="y: expected a row for each of the dofs"):
        elimination.act(np.zeros((4, 3)), np.zeros((4, 3)))
    with pytest.raises(ValueError, match="values: expected shape"):
        elimination.constrain(np.zeros((4, 3)), np.zeros((NODES, 3)))
