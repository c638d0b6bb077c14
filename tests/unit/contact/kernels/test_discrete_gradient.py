"""Averaged gradient and condensed contact, ``discrete_gradient.h``."""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from reference import nts
from reference.bulk import renumberings, rotation, sample_pairs, taylor_order

pytestmark = pytest.mark.serial

EPS = np.finfo(np.float64).eps
# Segments have size one; the condensation solves a 5x5 system whose
# condition number is below about 50 for the sampled pairs.
ROUND_OFF = 1000 * EPS
# Bilinear terms of the work: force times step minus difference of gaps.
WORK_ROUND_OFF = 50 * EPS

IMPLEMENTATIONS = [pytest.param(_kernels, id="kernels"), pytest.param(nts.batched, id="twin")]
both = pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
# Slow properties of the twin, tested where it agrees with the kernels.
kernels = pytest.mark.parametrize("implementation", IMPLEMENTATIONS[:1])
segments = pytest.mark.parametrize("k", [3, 4], ids=["triangle", "quadrilateral"])
signs = pytest.mark.parametrize("orientation", [1, -1])
schemes = pytest.mark.parametrize("scheme", ["contact_conserving", "contact_midpoint"])

NUM_INVARIANTS = {3: 12, 4: 17}


def steps(k, orientation, seed, num=12):
    """Return two states of random pairs, apart by up to 0.1, and signs."""
    x_pair, signs, _, _ = sample_pairs(k, orientation, num=num, seed=seed)
    change = np.random.default_rng([seed, k]).uniform(-0.1, 0.1, x_pair.shape)
    return x_pair + change, x_pair, signs


def invariants_of(x_pair, signs):
    """Return the invariants at the projection."""
    xi, gap, normal, _ = nts.batched.project(x_pair, signs)
    return nts.batched.invariants(x_pair, normal, xi, gap)


def work(force, x_n, x):
    """Return force times displacement per pair."""
    return np.einsum("mi,mi->m", force, (x - x_n).reshape(len(x), -1))


@both
@segments
@signs
def test_average_gradient_is_directional(implementation, k, orientation):
    x_n, x, signs = steps(k, orientation, 1)
    pi_n, pi = invariants_of(x_n, signs), invariants_of(x, signs)
    pi = pi + np.random.default_rng(1).normal(size=pi.shape) * 0.3  # off the constraints
    change = implementation.constraints(pi) - implementation.constraints(pi_n)
    W = implementation.average_gradient(pi_n, pi)
    np.testing.assert_allclose(np.einsum("mij,mj->mi", W, pi - pi_n), change, atol=ROUND_OFF)


@both
@segments
def test_average_gradient_of_equal_states_is_the_gradient(implementation, k):
    _, x, signs = steps(k, 1, 2)
    pi = invariants_of(x, signs)
    np.testing.assert_allclose(
        implementation.average_gradient(pi, pi),
        implementation.constraints_gradient(pi),
        atol=ROUND_OFF,
    )


@both
def test_average_gradient_of_a_triangle_is_the_midpoint_gradient(implementation):
    x_n, x, signs = steps(3, 1, 3)
    pi_n, pi = invariants_of(x_n, signs), invariants_of(x, signs)
    np.testing.assert_allclose(
        implementation.average_gradient(pi_n, pi),
        implementation.constraints_gradient((pi_n + pi) / 2),
        atol=ROUND_OFF,
    )


@segments
@signs
@schemes
def test_kernel_and_twin_agree(k, orientation, scheme):
    x_n, x, signs = steps(k, orientation, 4, num=60)
    found = getattr(_kernels, scheme)(x_n, x, signs)
    expected = getattr(nts.batched, scheme)(x_n, x, signs)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=ROUND_OFF, rtol=ROUND_OFF)
    pi_n, pi = invariants_of(x_n, signs), invariants_of(x, signs)
    one, other = (m.average_gradient(pi_n, pi) for m in (_kernels, nts.batched))
    np.testing.assert_allclose(one, other, atol=ROUND_OFF, rtol=ROUND_OFF)


@both
@segments
@signs
@schemes
def test_gaps_gradient_and_turn_agree_with_the_two_states(implementation, k, orientation, scheme):
    x_n, x, signs = steps(k, orientation, 5)
    gap_n, gap, _, gradient, _, turn = getattr(implementation, scheme)(x_n, x, signs)
    _, expected_n, normal_n, _ = nts.batched.project(x_n, signs)
    _, expected, normal, _ = nts.batched.project(x, signs)
    np.testing.assert_allclose(gap_n, expected_n, atol=ROUND_OFF)
    np.testing.assert_allclose(gap, expected, atol=ROUND_OFF)
    np.testing.assert_allclose(gradient, nts.batched.gap_gradient(x, signs), atol=ROUND_OFF)
    np.testing.assert_allclose(turn, np.einsum("mi,mi->m", normal_n, normal), atol=ROUND_OFF)


@both
@segments
@signs
def test_work_of_the_conserving_force_is_the_change_of_the_gap(implementation, k, orientation):
    x_n, x, signs = steps(k, orientation, 6, num=40)
    gap_n, gap, force, *_ = implementation.contact_conserving(x_n, x, signs)
    np.testing.assert_allclose(work(force, x_n, x), gap - gap_n, atol=WORK_ROUND_OFF, rtol=0)


@both
@segments
@signs
def test_midpoint_force_is_not_directional(implementation, k, orientation):
    # The reason for the conserving force, which shows that the test above is sharp
    x_n, x, signs = steps(k, orientation, 6, num=40)
    gap_n, gap, force, *_ = implementation.contact_midpoint(x_n, x, signs)
    assert np.abs(work(force, x_n, x) - (gap - gap_n)).max() > 1e-5


@both
@segments
@signs
@schemes
def test_force_has_no_resultant_and_no_moment_at_the_midpoint(
    implementation, k, orientation, scheme
):
    x_n, x, signs = steps(k, orientation, 7)
    forces = getattr(implementation, scheme)(x_n, x, signs)[2].reshape(x.shape)
    moments = np.cross((x_n + x) / 2, forces)
    np.testing.assert_allclose(forces.sum(axis=1), 0, atol=ROUND_OFF)
    np.testing.assert_allclose(moments.sum(axis=1), 0, atol=ROUND_OFF)


@kernels
@segments
@signs
@schemes
def test_force_has_a_second_order_remainder_with_the_tangent(
    implementation, k, orientation, scheme
):
    x_n, x, signs = steps(k, orientation, 8)
    evaluate = getattr(implementation, scheme)
    d = np.random.default_rng(8).normal(size=x.shape)
    slope = np.einsum("mij,mj->mi", evaluate(x_n, x, signs)[4], d.reshape(len(d), -1))
    assert taylor_order(lambda at: evaluate(x_n, at, signs)[2], x, d, slope) > 1.9


@both
@segments
@signs
def test_midpoint_force_and_tangent_are_gap_derivatives(implementation, k, orientation):
    x_n, x, signs = steps(k, orientation, 9)
    _, _, force, _, tangent, *_ = implementation.contact_midpoint(x_n, x, signs)
    mid = (x_n + x) / 2
    np.testing.assert_allclose(force, nts.batched.gap_gradient(mid, signs), atol=ROUND_OFF)
    np.testing.assert_allclose(tangent, nts.batched.gap_hessian(mid, signs) / 2, atol=ROUND_OFF)


@both
@segments
@signs
@pytest.mark.parametrize("size", [1e-4, 1e-8, 1e-10, 1e-12, 0.0])
def test_tiny_steps_give_the_midpoint_force_without_noise(implementation, k, orientation, size):
    x_n, x, signs = steps(k, orientation, 10)
    x_n = x + size * (x_n - x)
    conserving = implementation.contact_conserving(x_n, x, signs)
    midpoint = implementation.contact_midpoint(x_n, x, signs)
    # Forces differ by second order in the step, tangents by first order
    for index, order in ((2, 2), (4, 1)):
        np.testing.assert_allclose(
            conserving[index], midpoint[index], atol=ROUND_OFF + size**order, rtol=0
        )


@both
@segments
@signs
def test_rigid_rotation_of_a_pair_costs_no_work(implementation, k, orientation):
    _, x_n, signs = steps(k, orientation, 11)
    turn = rotation([1, 1, -0.3], 1.2)
    x = x_n @ turn.T + [0.3, -0.2, 0.1]
    gap_n, gap, force, *_ = implementation.contact_conserving(x_n, x, signs)
    np.testing.assert_allclose(gap, gap_n, atol=ROUND_OFF)
    np.testing.assert_allclose(work(force, x_n, x), 0, atol=ROUND_OFF)


@both
@segments
@signs
@schemes
def test_force_and_tangent_rotate_with_both_states(implementation, k, orientation, scheme):
    x_n, x, signs = steps(k, orientation, 12)
    turn, shift = rotation([2, 1, 1], 2.2), np.array([1.0, -1, 0.4])
    block = np.kron(np.eye(1 + k), turn)
    _, _, force, _, tangent, *_ = getattr(implementation, scheme)(x_n, x, signs)
    moved = getattr(implementation, scheme)(x_n @ turn.T + shift, x @ turn.T + shift, signs)
    np.testing.assert_allclose(moved[2], force @ block.T, atol=ROUND_OFF)
    np.testing.assert_allclose(moved[4], block @ tangent @ block.T, atol=10 * ROUND_OFF)


@kernels
@segments
@signs
@schemes
@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1e3, 1e9])
def test_force_does_not_depend_on_the_unit_of_length(implementation, k, orientation, scheme, unit):
    x_n, x, signs = steps(k, orientation, 13)
    _, _, force, _, tangent, *_ = getattr(implementation, scheme)(x_n, x, signs)
    scaled = getattr(implementation, scheme)(unit * x_n, unit * x, signs)
    np.testing.assert_allclose(scaled[2], force, atol=ROUND_OFF)
    np.testing.assert_allclose(scaled[4] * unit, tangent, atol=5 * ROUND_OFF)


@kernels
@segments
@signs
@schemes
def test_force_and_tangent_follow_the_vertex_numbering(implementation, k, orientation, scheme):
    x_n, x, signs = steps(k, orientation, 14)
    evaluate = getattr(implementation, scheme)
    _, _, force, _, tangent, *_ = evaluate(x_n, x, signs)
    for order, sign in renumberings(k):
        points = np.array([0, *(1 + v for v in order)])
        dofs = (3 * points[:, None] + np.arange(3)).ravel()
        states = [np.ascontiguousarray(state[:, points]) for state in (x_n, x)]
        renumbered = evaluate(*states, sign * signs)
        np.testing.assert_allclose(renumbered[2], force[:, dofs], atol=ROUND_OFF)
        np.testing.assert_allclose(renumbered[4], tangent[:, dofs][:, :, dofs], atol=5 * ROUND_OFF)


@pytest.mark.untrapped
@segments
@schemes
def test_turn_is_nan_for_degenerate_pairs(k, scheme):
    x_n, x, signs = steps(k, 1, 15, num=6)
    x_n[0, 1:] = 0.5  # a point
    x[1, 1:] = x[1, 1] + np.outer(np.arange(k), [1.0, 2, -1])  # a line
    x_n[2, 1, 0], x[3, 0, 2] = np.nan, np.inf
    x[4] = x_n[4] @ rotation([1, 0, 0], np.pi).T  # normals opposed: often singular
    *results, turn = getattr(_kernels, scheme)(x_n, x, signs)
    finite = np.all([np.isfinite(r).reshape(6, -1).all(axis=1) for r in results], axis=0)
    np.testing.assert_array_equal(np.isnan(turn), ~finite)
    assert not finite[:4].any() and finite[5]


@segments
@schemes
def test_a_degenerate_pair_does_not_touch_its_neighbours(k, scheme):
    x_n, x, signs = steps(k, 1, 16, num=3)
    expected = getattr(_kernels, scheme)(x_n, x, signs)
    x[1, 1:] = 0
    for one, other in zip(getattr(_kernels, scheme)(x_n, x, signs), expected, strict=True):
        np.testing.assert_array_equal(one[[0, 2]], other[[0, 2]])


@segments
def test_empty_batch_gives_empty_results(k):
    num, pairs = 3 * (1 + k), np.empty((0, 1 + k, 3))
    shapes = [(0,), (0,), (0, num), (0, num), (0, num, num), (0,)]
    for scheme in (_kernels.contact_conserving, _kernels.contact_midpoint):
        assert [r.shape for r in scheme(pairs, pairs, np.empty(0))] == shapes
    pi = np.empty((0, NUM_INVARIANTS[k]))
    assert _kernels.average_gradient(pi, pi).shape == (0, 6, NUM_INVARIANTS[k])


@schemes
@pytest.mark.parametrize(
    ("shape_n", "shape", "num_signs", "given"),
    [
        ((2, 6, 3), (2, 6, 3), 2, "3 or 4.*5"),
        ((2, 5, 3), (2, 4, 3), 2, r"2\D+4\D+3"),
        ((3, 5, 3), (2, 5, 3), 2, r"[23]\D+5\D+3"),
        ((2, 5, 3), (2, 5, 3), 7, r"7"),
    ],
)
def test_wrong_shapes_raise_a_value_error_naming_them(scheme, shape_n, shape, num_signs, given):
    with pytest.raises(ValueError, match=given):
        getattr(_kernels, scheme)(np.zeros(shape_n), np.zeros(shape), np.ones(num_signs))


@pytest.mark.parametrize(("shape_n", "shape"), [((2, 17), (2, 12)), ((2, 17), (3, 17))])
def test_wrong_shapes_of_invariants_raise_a_value_error_naming_them(shape_n, shape):
    with pytest.raises(ValueError, match=r"\D+".join(map(str, shape))):
        _kernels.average_gradient(np.zeros(shape_n), np.zeros(shape))
