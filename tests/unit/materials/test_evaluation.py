"""Values of UFL expressions, with each subexpression evaluated once."""

import basix.ufl
import numpy as np
import pytest
import ufl
from ufl.algorithms import expand_derivatives

from dolfinx_nts.materials.evaluation import Evaluation

pytestmark = pytest.mark.serial

MESH = ufl.Mesh(basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,)))
X, A = ufl.Constant(MESH), ufl.Constant(MESH, shape=(3, 3))


def test_repeated_expressions_are_evaluated_once():
    """As a tree the expression has 3^40 leaves."""
    y, expected = X, 0.5
    for _ in range(40):
        y, expected = y - y * y / 2, expected - expected * expected / 2
    assert Evaluation(y).value({X: 0.5}) == expected


def test_sums_over_indices_and_derivatives_agree_with_numpy(rng):
    B, D = rng.normal(size=(2, 3, 3))
    variable = ufl.variable(A)
    for function, expected in (
        (ufl.det(variable), np.linalg.det(B) * np.trace(np.linalg.solve(B, D))),
        (ufl.tr(variable * variable * variable), 3 * np.trace(B @ B @ D)),
        (ufl.inner(variable, variable.T), 2 * np.sum(B.T * D)),
    ):
        slope = ufl.inner(ufl.diff(function, variable), ufl.as_matrix(D.tolist()))
        evaluation = Evaluation(expand_derivatives(slope))
        assert evaluation.value({A: B.tolist()}) == pytest.approx(expected, rel=1e-12)
        # Other numbers differ from the former ones.
        assert evaluation.value({A: np.zeros((3, 3)).tolist()}) == pytest.approx(0.0)


def test_a_branch_that_is_not_taken_is_not_evaluated():
    root = ufl.conditional(ufl.gt(X, 0), ufl.sqrt(X), 1 / (X + 1))
    evaluation = Evaluation(root)
    assert evaluation.value({X: 4.0}) == 2.0
    assert evaluation.value({X: -3.0}) == -0.5
    with pytest.raises(ArithmeticError):
        evaluation.value({X: -1.0})
