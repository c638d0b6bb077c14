"""Means over rings against a quadrature of high degree, on quadrilaterals of any shape."""

import basix
import numpy as np
import pytest

from dolfinx_nts.fem.ring_means import PLANE_ENTRIES, ring_means

pytestmark = pytest.mark.serial

ELEMENT = basix.create_element(basix.ElementFamily.P, basix.CellType.quadrilateral, 1)
MIDDLE = np.array([[0.5, 0.5]])


@pytest.mark.parametrize("seed", range(4))
def test_means_of_any_field_agree_with_a_fine_quadrature(seed):
    rng = np.random.default_rng(seed)
    corners = np.array([[0.0, 0.0], [1.0, 0.1], [-0.1, 0.9], [1.2, 1.1]])
    X = corners + 0.15 * rng.uniform(-1, 1, (4, 2)) + [0.3, 0.0]
    (numbers,) = ring_means(np.column_stack([X, np.zeros(4)])[None])
    v = rng.normal(size=4)

    points, weights = basix.make_quadrature(basix.CellType.quadrilateral, 12)
    values, *slopes = ELEMENT.tabulate(1, points)[..., 0]
    J = np.einsum("jqa,ai->qij", np.array(slopes), X)
    area = np.abs(np.linalg.det(J)) * weights
    ring = area * (values @ X[:, 0])
    gradient = np.einsum("jqa,qji,a->qi", np.array(slopes), np.linalg.inv(J), v)
    mean, around = ring @ gradient / ring.sum(), area @ values @ v / ring.sum()

    (shape, dx, dy, _, dxdy, _) = ELEMENT.tabulate(2, MIDDLE)[:, 0, :, 0]
    F = np.stack([dx, dy]) @ X  # rows are tangents
    first = np.linalg.solve(F, np.array([dx @ v, dy @ v]))
    mixed = dxdy @ v - first @ (dxdy @ X)
    back = np.linalg.inv(F)
    H = back @ np.array([[0.0, mixed], [mixed, 0.0]]) @ back.T
    second = np.array([H[entry] for entry in PLANE_ENTRIES])
    assert np.abs(first + second @ numbers[:6].reshape(3, 2) - mean).max() < 1e-13
    found = numbers[6] * (shape @ v) + numbers[7:9] @ first + numbers[9:12] @ second
    assert abs(found - around) < 1e-12
    middle = shape @ X[:, 0] * abs(np.linalg.det(F))
    assert abs(numbers[12] * middle - ring.sum()) < 1e-13
