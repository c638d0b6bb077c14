"""Gradient and Hessian of the gap, ``gap.h``."""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from reference import nts
from reference.bulk import renumberings, rotation, sample_pairs, taylor_order

pytestmark = pytest.mark.serial

# Segments have size one, entries of the derivatives are of order one.
ROUND_OFF = 500 * np.finfo(np.float64).eps

IMPLEMENTATIONS = [pytest.param(_kernels, id="kernels"), pytest.param(nts.batched, id="twin")]
both = pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
segments = pytest.mark.parametrize("k", [3, 4], ids=["triangle", "quadrilateral"])
signs = pytest.mark.parametrize("orientation", [1, -1])


def directions(x_pair, seed):
    """Return random directions of the coordinates."""
    return np.random.default_rng(seed).normal(size=x_pair.shape)


def along(derivatives, d):
    """Apply the last axis of ``derivatives`` to directions per pair."""
    return np.einsum("m...i,mi->m...", derivatives, d.reshape(len(d), -1))


@segments
@signs
def test_kernel_and_twin_agree(k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, num=100, seed=1)
    for name in ("gap_gradient", "gap_hessian"):
        one, other = (getattr(m, name)(x_pair, signs) for m in (_kernels, nts.batched))
        np.testing.assert_allclose(one, other, atol=ROUND_OFF, rtol=ROUND_OFF)


@both
@segments
@signs
def test_gap_has_a_second_order_remainder_with_its_gradient(implementation, k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, seed=2)
    d = directions(x_pair, 2)
    slope = along(implementation.gap_gradient(x_pair, signs), d)
    assert taylor_order(lambda x: implementation.project(x, signs)[1], x_pair, d, slope) > 1.9


@both
@segments
@signs
def test_gradient_has_a_second_order_remainder_with_the_hessian(implementation, k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, seed=3)
    d = directions(x_pair, 3)
    slope = along(implementation.gap_hessian(x_pair, signs), d)
    assert taylor_order(lambda x: implementation.gap_gradient(x, signs), x_pair, d, slope) > 1.9


@both
@segments
@signs
def test_hessian_is_symmetric(implementation, k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, seed=4)
    hessian = implementation.gap_hessian(x_pair, signs)
    np.testing.assert_allclose(hessian, hessian.transpose(0, 2, 1), atol=ROUND_OFF, rtol=0)


@both
@signs
def test_flat_segment_agrees_with_the_closed_form(implementation, orientation):
    # Plane z = 0 and the point (0.2, 0.3): gradient [n, -phi n]
    segment = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    x_pair = np.vstack(([0.2, 0.3, 0.5 * orientation], segment))[None]
    signs = np.array([float(orientation)])
    weights = np.array([1, -0.5, -0.2, -0.3])
    gradient = implementation.gap_gradient(x_pair, signs)[0].reshape(4, 3)
    np.testing.assert_allclose(
        gradient, np.outer(weights, [0, 0, orientation]), atol=ROUND_OFF, rtol=0
    )
    hessian = implementation.gap_hessian(x_pair, signs)[0].reshape(4, 3, 4, 3)
    # Vertex (1, 0) lifted by t: gap = (0.5 - orientation 0.2 t) / sqrt(1 + t^2)
    np.testing.assert_allclose(hessian[2, 2, 2, 2], -0.5, atol=ROUND_OFF, rtol=0)
    np.testing.assert_allclose(hessian[0, :, 0, :], 0, atol=ROUND_OFF, rtol=0)
    np.testing.assert_allclose(hessian[0, 0, 2, 2], -orientation, atol=ROUND_OFF, rtol=0)


@both
@segments
@signs
def test_gradient_has_no_resultant_force_and_no_moment(implementation, k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, seed=5)
    forces = implementation.gap_gradient(x_pair, signs).reshape(x_pair.shape)
    np.testing.assert_allclose(forces.sum(axis=1), 0, atol=ROUND_OFF)
    np.testing.assert_allclose(np.cross(x_pair, forces).sum(axis=1), 0, atol=ROUND_OFF)


@both
@segments
@signs
def test_hessian_maps_rigid_motions_to_rotated_forces(implementation, k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, seed=6)
    hessian = implementation.gap_hessian(x_pair, signs)
    forces = implementation.gap_gradient(x_pair, signs).reshape(x_pair.shape)
    for axis in np.eye(3):
        shift = np.broadcast_to(axis, x_pair.shape)
        np.testing.assert_allclose(along(hessian, shift), 0, atol=ROUND_OFF)
        turned = np.cross(axis, forces).reshape(len(forces), -1)
        np.testing.assert_allclose(
            along(hessian, np.cross(axis, x_pair)), turned, atol=5 * ROUND_OFF
        )


@both
@segments
@signs
def test_derivatives_rotate_with_a_rigid_motion(implementation, k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, seed=7)
    turn = rotation([0.3, 1, -2], 2.5)
    moved = x_pair @ turn.T + [0.5, -1, 2]
    block = np.kron(np.eye(1 + k), turn)
    gradient = implementation.gap_gradient(x_pair, signs) @ block.T
    hessian = block @ implementation.gap_hessian(x_pair, signs) @ block.T
    np.testing.assert_allclose(implementation.gap_gradient(moved, signs), gradient, atol=ROUND_OFF)
    np.testing.assert_allclose(
        implementation.gap_hessian(moved, signs), hessian, atol=10 * ROUND_OFF
    )


@both
@segments
@signs
@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_derivatives_scale_with_the_unit_of_length(implementation, k, orientation, unit):
    x_pair, signs, _, _ = sample_pairs(k, orientation, seed=8)
    np.testing.assert_allclose(
        implementation.gap_gradient(unit * x_pair, signs),
        implementation.gap_gradient(x_pair, signs),
        atol=ROUND_OFF,
    )
    np.testing.assert_allclose(
        implementation.gap_hessian(unit * x_pair, signs) * unit,
        implementation.gap_hessian(x_pair, signs),
        atol=5 * ROUND_OFF,
    )


@both
@segments
@signs
def test_derivatives_follow_the_vertex_numbering(implementation, k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, seed=9)
    gradient = implementation.gap_gradient(x_pair, signs)
    hessian = implementation.gap_hessian(x_pair, signs)
    for order, sign in renumberings(k):
        points = np.array([0, *(1 + v for v in order)])
        dofs = (3 * points[:, None] + np.arange(3)).ravel()
        renumbered = np.ascontiguousarray(x_pair[:, points])
        np.testing.assert_allclose(
            implementation.gap_gradient(renumbered, sign * signs), gradient[:, dofs], atol=ROUND_OFF
        )
        np.testing.assert_allclose(
            implementation.gap_hessian(renumbered, sign * signs),
            hessian[:, dofs][:, :, dofs],
            atol=5 * ROUND_OFF,
        )


@segments
def test_empty_batch_gives_empty_results(k):
    num = 3 * (1 + k)
    empty = np.empty((0, 1 + k, 3)), np.empty(0)
    assert _kernels.gap_gradient(*empty).shape == (0, num)
    assert _kernels.gap_hessian(*empty).shape == (0, num, num)


@pytest.mark.parametrize("name", ["gap_gradient", "gap_hessian"])
@pytest.mark.parametrize(
    ("shape", "num_signs", "given"),
    [((2, 6, 3), 2, "3 or 4.*5"), ((2, 5, 2), 2, r"2\D+5\D+2"), ((2, 4, 3), 7, r"7")],
)
def test_wrong_shapes_raise_a_value_error_naming_them(name, shape, num_signs, given):
    with pytest.raises(ValueError, match=given):
        getattr(_kernels, name)(np.zeros(shape), np.ones(num_signs))
