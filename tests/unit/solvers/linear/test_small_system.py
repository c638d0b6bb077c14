"""Small sparse systems that are close to diagonal."""

import numpy as np
import pytest

from dolfinx_nts import _kernels

pytestmark = pytest.mark.serial


def solve(A, b):
    """Solution by the kernel, with the zeros of A left out and entries in any order."""
    order = np.random.default_rng(0).permutation(np.argwhere(A).astype(np.int64))
    number = 3 * np.arange(len(A), dtype=np.int64)[::-1]
    row, column = np.ascontiguousarray(order.T)
    values = A[row, column]
    return _kernels.SmallSystem(number, number[row], number[column], values).solve(b)


@pytest.mark.parametrize("coupling", [0.0, 0.1, 1.0])
def test_solution_is_exact_to_round_off(coupling, rng):
    n = 60
    A = np.diag(rng.uniform(0.5, 1.5, n))
    # Neighbours as in a mass matrix, of which the last is no small perturbation.
    A += coupling * 0.25 * (np.eye(n, k=1) + np.eye(n, k=-1)) * rng.uniform(0.5, 1.0, (n, n))
    b = rng.normal(size=n)
    assert solve(A, b) == pytest.approx(np.linalg.solve(A, b), rel=1e-11, abs=1e-12)


def test_no_right_hand_side_has_no_solution_but_zero():
    assert (solve(np.diag([1.0, 2.0]), np.zeros(2)) == 0).all()
    assert solve(np.empty((0, 0)), np.empty(0)).size == 0


def test_singular_systems_give_nan(rng):
    assert np.isnan(solve(np.array([[0.0, 1.0], [1.0, 0.0]]), np.ones(2))).all()
    assert np.isnan(solve(np.array([[1.0, 1.0], [1.0, 1.0]]), np.array([1.0, 0.0]))).all()
