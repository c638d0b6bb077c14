"""Conjugate gradients that search for a negative eigenvalue with a random force."""

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_nts.solvers.statics.negative_curvature import negative_curvature_direction

SIZE, TRIALS = 40, 200


def searched(rng, least: float):
    """Search with a preconditioner close to the matrix except for its least eigenvalue.

    Returns the matrix, the result, and the number of products.
    """
    Q, _ = np.linalg.qr(rng.standard_normal((SIZE, SIZE)))
    values = rng.uniform(1.0, 100.0, SIZE)
    nearby = (Q * values * rng.uniform(0.8, 1.2, SIZE)) @ Q.T
    values[0] = least
    A = (Q * values) @ Q.T
    inverse, products = np.linalg.inv(nearby), []
    weight = np.sqrt(np.diag(nearby))

    def act(x):
        products.append(x)
        return A @ x

    b = weight * rng.standard_normal(SIZE)
    found = negative_curvature_direction(MPI.COMM_SELF, b, weight, lambda r: inverse @ r, act)
    return A, found, len(products)


def test_definite_matrix_has_no_negative_curvature(rng):
    for _ in range(TRIALS):
        _, found, products = searched(rng, least=0.5)
        assert found is None
        assert products <= 10


@pytest.mark.parametrize("least", [-0.1, -1.0, -100.0])
def test_a_negative_eigenvalue_is_missed_no_more_often_than_promised(rng, least):
    """With a probability of 0.024, of which twice as much is far beyond chance."""
    missed = 0
    for _ in range(TRIALS):
        A, found, _ = searched(rng, least)
        missed += found is None
        assert found is None or found @ A @ found < 0
    assert missed <= 0.06 * TRIALS


def test_a_preconditioner_that_is_not_symmetric_gives_no_false_alarm(rng):
    """Directions are conjugate to all before them, whatever the preconditioner is."""
    for _ in range(TRIALS):
        A = np.diag(rng.uniform(1.0, 2.0, SIZE))
        B = np.eye(SIZE) + 0.3 * rng.standard_normal((SIZE, SIZE)) / np.sqrt(SIZE)
        weight = np.sqrt(np.diag(A))
        b = weight * rng.standard_normal(SIZE)
        assert (
            negative_curvature_direction(MPI.COMM_SELF, b, weight, B.__matmul__, A.__matmul__)
            is None
        )
