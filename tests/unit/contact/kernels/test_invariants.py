"""Invariants of a contact and the six constraints, ``invariants.h``."""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from reference import nts
from reference.bulk import rotation, sample_pairs, taylor_order

pytestmark = pytest.mark.serial

# Products of lengths of order one, up to 17 of them summed.
ROUND_OFF = 200 * np.finfo(np.float64).eps

IMPLEMENTATIONS = [pytest.param(_kernels, id="kernels"), pytest.param(nts.batched, id="twin")]
both = pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
segments = pytest.mark.parametrize("k", [3, 4], ids=["triangle", "quadrilateral"])

NUM_INVARIANTS = {3: 12, 4: 17}


def states(k, seed, num=8):
    """Return arguments of ``invariants`` that satisfy no constraint."""
    rng = np.random.default_rng([seed, k])
    x_pair = sample_pairs(k, 1, num=num, seed=seed)[0]
    return x_pair, rng.normal(size=(num, 3)), rng.normal(size=(num, 2)), rng.normal(size=num)


def flatten(x_pair, normal, xi, slack):
    """Return the coordinates z of every contact."""
    return np.hstack((x_pair.reshape(len(x_pair), -1), normal, xi, slack[:, None]))


@both
def test_invariants_of_a_quadrilateral_have_the_order_of_the_paper(implementation):
    x_pair, d, f, slack = states(4, 1)
    pi = implementation.invariants(x_pair, d, f, slack)
    for points, d_s, (xi, eta), f_3, found in zip(x_pair, d, f, slack, pi, strict=True):
        s, e_2, e_3, e_4 = points[[0, 2, 3, 4]] - points[1]
        expected = [s @ d_s, e_2 @ d_s, e_3 @ d_s, e_4 @ d_s, xi, eta, f_3, d_s @ d_s]
        expected += [e_2 @ s, e_3 @ s, e_4 @ s]
        expected += [e_2 @ e_2, e_2 @ e_3, e_2 @ e_4, e_3 @ e_3, e_3 @ e_4, e_4 @ e_4]
        np.testing.assert_allclose(found, expected, atol=ROUND_OFF, rtol=ROUND_OFF)


@both
def test_invariants_of_a_triangle_have_the_same_pattern(implementation):
    x_pair, d, f, slack = states(3, 1)
    pi = implementation.invariants(x_pair, d, f, slack)
    for points, d_s, (xi, eta), f_3, found in zip(x_pair, d, f, slack, pi, strict=True):
        s, e_2, e_3 = points[[0, 2, 3]] - points[1]
        expected = [s @ d_s, e_2 @ d_s, e_3 @ d_s, xi, eta, f_3, d_s @ d_s]
        expected += [e_2 @ s, e_3 @ s, e_2 @ e_2, e_2 @ e_3, e_3 @ e_3]
        np.testing.assert_allclose(found, expected, atol=ROUND_OFF, rtol=ROUND_OFF)


@both
@segments
def test_invariants_do_not_change_in_a_rigid_motion(implementation, k):
    x_pair, normal, xi, slack = states(k, 2)
    turn = rotation([1, 2, -1], 0.8)
    moved = implementation.invariants(x_pair @ turn.T + 1.5, normal @ turn.T, xi, slack)
    np.testing.assert_allclose(
        moved, implementation.invariants(x_pair, normal, xi, slack), atol=5 * ROUND_OFF
    )


@both
@segments
def test_midpoint_gradient_times_the_step_is_the_change_of_the_invariants(implementation, k):
    # They are quadratic, so the midpoint gradient is a discrete gradient
    one, other = states(k, 3), states(k, 4)
    change = implementation.invariants(*other) - implementation.invariants(*one)
    for z_n, z, expected in zip(flatten(*one), flatten(*other), change, strict=True):
        gradient = nts.invariants_gradient((z_n + z) / 2)
        np.testing.assert_allclose(gradient @ (z - z_n), expected, atol=5 * ROUND_OFF)


@both
@segments
def test_constraints_are_the_geometric_conditions(implementation, k):
    # (38): normal and tangential position of the node, normal on both
    # tangents and of length one
    x_pair, normal, xi, slack = states(k, 5)
    found = implementation.constraints(implementation.invariants(x_pair, normal, xi, slack))
    for points, d, at, f_3, g in zip(x_pair, normal, xi, slack, found, strict=True):
        phi, dphi, _ = nts.shape_functions(at, k)
        a, difference = dphi @ points[1:], points[0] - phi @ points[1:]
        expected = [difference @ d - f_3, *(a @ d), (d @ d - 1) / 2, *(a @ difference)]
        np.testing.assert_allclose(g, expected, atol=10 * ROUND_OFF, rtol=10 * ROUND_OFF)


@both
@segments
@pytest.mark.parametrize("orientation", [1, -1])
def test_constraints_vanish_at_the_projection(implementation, k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, seed=6)
    xi, gap, normal, _ = implementation.project(x_pair, signs)
    g = implementation.constraints(implementation.invariants(x_pair, normal, xi, gap))
    np.testing.assert_allclose(g, 0, atol=ROUND_OFF)


@both
@segments
def test_constraints_have_a_second_order_remainder_with_their_gradient(implementation, k):
    pi = implementation.invariants(*states(k, 7))
    d = np.random.default_rng(7).normal(size=pi.shape)
    slope = np.einsum("mij,mj->mi", implementation.constraints_gradient(pi), d)
    assert taylor_order(implementation.constraints, pi, d, slope) > 1.9


@segments
def test_kernel_and_twin_agree(k):
    arguments = states(k, 8, num=100)
    pi = nts.batched.invariants(*arguments)
    np.testing.assert_allclose(_kernels.invariants(*arguments), pi, atol=ROUND_OFF)
    for name in ("constraints", "constraints_gradient"):
        one, other = (getattr(m, name)(pi) for m in (_kernels, nts.batched))
        np.testing.assert_allclose(one, other, atol=10 * ROUND_OFF, rtol=10 * ROUND_OFF)


@segments
def test_hessian_of_the_constraints_in_the_twin_has_a_second_order_remainder(k):
    pi = nts.batched.invariants(*states(k, 9, num=1))[0]
    d = np.random.default_rng(9).normal(size=pi.shape)
    slope = nts.constraints_hessian(pi) @ d
    if k == 3:  # constraints of triangles are quadratic
        exact = nts.constraints_gradient(pi + d) - nts.constraints_gradient(pi)
        np.testing.assert_allclose(slope, exact, atol=10 * ROUND_OFF, rtol=10 * ROUND_OFF)
    else:
        assert taylor_order(nts.constraints_gradient, pi, d, slope) > 1.9


@segments
def test_empty_batch_gives_empty_results(k):
    num = NUM_INVARIANTS[k]
    empty = np.empty((0, 1 + k, 3)), np.empty((0, 3)), np.empty((0, 2)), np.empty(0)
    assert _kernels.invariants(*empty).shape == (0, num)
    assert _kernels.constraints(np.empty((0, num))).shape == (0, 6)
    assert _kernels.constraints_gradient(np.empty((0, num))).shape == (0, 6, num)


@pytest.mark.parametrize(
    ("shapes", "given"),
    [
        (((2, 6, 3), (2, 3), (2, 2), (2,)), "3 or 4.*5"),
        (((2, 5, 3), (2, 4), (2, 2), (2,)), r"2\D+4"),
        (((2, 5, 3), (2, 3), (2, 9), (2,)), r"2\D+9"),
        (((2, 5, 3), (2, 3), (2, 2), (7,)), r"7"),
    ],
)
def test_wrong_shapes_of_a_state_raise_a_value_error_naming_them(shapes, given):
    with pytest.raises(ValueError, match=given):
        _kernels.invariants(*(np.zeros(shape) for shape in shapes))


@pytest.mark.parametrize("name", ["constraints", "constraints_gradient"])
@pytest.mark.parametrize("shape", [(2, 13), (17,), (2, 3, 4)])
def test_wrong_shapes_of_invariants_raise_a_value_error_naming_them(name, shape):
    with pytest.raises(ValueError, match=r"\D+".join(map(str, shape))):
        getattr(_kernels, name)(np.zeros(shape))
