"""Closest-point projection of nodes onto segments, ``projection.h``."""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from reference import nts
from reference.bulk import renumberings, rotation, sample_pairs, taylor_order

pytestmark = pytest.mark.serial

# Segments have size one, Newton's last update is quadratic: a few
# roundings, amplified by the distortion and the curvature term.
ROUND_OFF = 200 * np.finfo(np.float64).eps

IMPLEMENTATIONS = [pytest.param(_kernels, id="kernels"), pytest.param(nts.batched, id="twin")]
both = pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
segments = pytest.mark.parametrize("k", [3, 4], ids=["triangle", "quadrilateral"])
signs = pytest.mark.parametrize("orientation", [1, -1])

UNIT = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])


def pair(node, segment):
    """Return a batch of one pair."""
    return np.vstack((node, segment))[None].astype(np.float64)


def degenerate_segments(k):
    """Return segments without a normal: a point, a line, a needle."""
    point = np.zeros((k, 3)) + 0.5
    line = UNIT[:k] * [1.0, 0, 0]
    skew_line = np.outer([0.0, 1, 2, 3][:k], [1.0, 2, -1])
    return [point, line, skew_line]


@both
@segments
@signs
def test_projection_recovers_the_point_from_which_a_node_was_lifted(implementation, k, orientation):
    x_pair, signs, xi, gap = sample_pairs(k, orientation)
    found_xi, found_gap, normal, status = implementation.project(x_pair, signs)
    assert not status.any()
    np.testing.assert_allclose(found_xi, xi, atol=ROUND_OFF, rtol=0)
    np.testing.assert_allclose(found_gap, gap, atol=ROUND_OFF, rtol=0)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=ROUND_OFF, rtol=0)


@segments
@signs
def test_kernel_and_twin_project_to_the_same_point(k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, num=200, seed=1)
    for one, other in zip(
        _kernels.project(x_pair, signs), nts.batched.project(x_pair, signs), strict=True
    ):
        np.testing.assert_allclose(one, other, atol=ROUND_OFF, rtol=0)


@both
@segments
@signs
def test_node_is_the_projection_point_plus_gap_times_normal(implementation, k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, seed=2)
    xi, gap, normal, _ = implementation.project(x_pair, signs)
    for points, at, distance, n in zip(x_pair, xi, gap, normal, strict=True):
        phi, dphi, _ = nts.shape_functions(at, k)
        tangents = dphi @ points[1:]
        np.testing.assert_allclose(phi @ points[1:] + distance * n, points[0], atol=10 * ROUND_OFF)
        assert np.abs(tangents @ n).max() <= ROUND_OFF
        assert orientation * np.linalg.det([*tangents, n]) > 0


@both
@segments
@signs
@pytest.mark.parametrize("at", [(0.25, 0.5), (0.0, 1.0), (2.5, -1.3)])
@pytest.mark.parametrize("height", [0.3, 0.0, -0.7])
def test_flat_segment_agrees_with_the_closed_form(implementation, k, orientation, at, height):
    a_1, a_2, origin = np.array([1.0, 0.2, 0.3]), np.array([-0.1, 1.1, 0.4]), np.ones(3)
    normal = orientation * np.cross(a_1, a_2) / np.linalg.norm(np.cross(a_1, a_2))
    segment = origin + np.array([0 * a_1, a_1, a_2, a_1 + a_2])[:k]
    x_pair = pair(origin + at[0] * a_1 + at[1] * a_2 + height * normal, segment)
    xi, gap, n, status = implementation.project(x_pair, np.array([float(orientation)]))
    assert status[0] == 0
    np.testing.assert_allclose(xi[0], at, atol=ROUND_OFF)
    np.testing.assert_allclose(gap[0], height, atol=ROUND_OFF)
    np.testing.assert_allclose(n[0], normal, atol=ROUND_OFF)


@both
@signs
@pytest.mark.parametrize("twist", [-0.4, 0.1, 0.5])
@pytest.mark.parametrize("at", [(0.2, 0.7), (0.9, 0.9), (-0.1, 1.1)])
@pytest.mark.parametrize("height", [0.4, -0.2])
def test_hyperbolic_paraboloid_has_its_analytic_normal(
    implementation, orientation, twist, at, height
):
    # z = twist x y over the unit square, xi = x and eta = y
    segment = UNIT + twist * np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 1]])
    normal = np.array([-twist * at[1], -twist * at[0], 1])
    normal *= orientation / np.linalg.norm(normal)
    node = np.array([*at, twist * at[0] * at[1]]) + height * normal
    xi, gap, n, status = implementation.project(pair(node, segment), np.array([float(orientation)]))
    assert status[0] == 0
    np.testing.assert_allclose(xi[0], at, atol=ROUND_OFF)
    np.testing.assert_allclose(gap[0], height, atol=ROUND_OFF)
    np.testing.assert_allclose(n[0], normal, atol=ROUND_OFF)


@both
@segments
def test_opposite_orientation_reverses_gap_and_normal_only(implementation, k):
    x_pair, signs, _, _ = sample_pairs(k, 1, seed=3)
    xi, gap, normal, _ = implementation.project(x_pair, signs)
    xi_other, gap_other, normal_other, _ = implementation.project(x_pair, -signs)
    np.testing.assert_array_equal(xi_other, xi)
    np.testing.assert_array_equal(gap_other, -gap)
    np.testing.assert_array_equal(normal_other, -normal)


@both
@segments
@signs
def test_projection_is_invariant_under_rigid_motion(implementation, k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, seed=4)
    turn, shift = rotation([1, -2, 0.5], 1.9), np.array([1.0, -2, 0.5])
    xi, gap, normal, _ = implementation.project(x_pair, signs)
    moved = implementation.project(x_pair @ turn.T + shift, signs)
    for one, other in zip(moved, (xi, gap, normal @ turn.T), strict=False):
        np.testing.assert_allclose(one, other, atol=5 * ROUND_OFF, rtol=0)


@both
@segments
@signs
@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_projection_does_not_depend_on_the_unit_of_length(implementation, k, orientation, unit):
    x_pair, signs, _, _ = sample_pairs(k, orientation, seed=5)
    xi, gap, normal, _ = implementation.project(x_pair, signs)
    scaled = implementation.project(unit * x_pair, signs)
    for one, other in zip(scaled, (xi, gap * unit, normal), strict=False):
        scale = unit if other.ndim == 1 else 1
        np.testing.assert_allclose(one, other, atol=5 * ROUND_OFF * scale, rtol=0)
    assert not scaled[3].any()


@both
@segments
@signs
def test_projection_does_not_depend_on_the_vertex_numbering(implementation, k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, seed=6)
    _, gap, normal, _ = implementation.project(x_pair, signs)
    for order, sign in renumberings(k):
        renumbered = np.ascontiguousarray(x_pair[:, [0, *(1 + v for v in order)]])
        _, gap_other, normal_other, _ = implementation.project(renumbered, sign * signs)
        np.testing.assert_allclose(gap_other, gap, atol=ROUND_OFF, rtol=0)
        np.testing.assert_allclose(normal_other, normal, atol=ROUND_OFF, rtol=0)


@segments
@signs
def test_projection_sensitivity_of_the_twin_has_a_second_order_remainder(k, orientation):
    x_pair, signs, _, _ = sample_pairs(k, orientation, num=6, seed=7)
    d = np.random.default_rng(7).normal(size=x_pair.shape)
    gradients = [nts.projection_gradient(x, s) for x, s in zip(x_pair, signs, strict=True)]
    slope = np.einsum("maj,mj->ma", gradients, d.reshape(len(d), -1))
    assert taylor_order(lambda x: _kernels.project(x, signs)[0], x_pair, d, slope) > 1.9


@both
@segments
def test_degenerate_segments_are_reported(implementation, k):
    for segment in degenerate_segments(k):
        *_, status = implementation.project(pair([0.2, 0.3, 0.4], segment), np.ones(1))
        assert status[0] != 0


@pytest.mark.untrapped
@both
@segments
def test_nan_appears_only_with_a_status(implementation, k):
    rng = np.random.default_rng(8)
    wild = rng.normal(size=(500, 1 + k, 3)) * 10.0 ** rng.integers(-3, 4, (500, 1 + k, 1))
    broken = sample_pairs(k, 1, num=3)[0]
    broken[0, 0, 1], broken[1, 2, 0], broken[2] = np.nan, np.inf, 0
    flat = [pair([0.2, 0.3, 0.4], segment)[0] for segment in degenerate_segments(k)]
    x_pair = np.concatenate((wild, broken, flat))
    with np.errstate(all="ignore"):
        xi, gap, normal, status = implementation.project(x_pair, np.ones(len(x_pair)))
    finite = np.isfinite(np.column_stack((xi, gap, normal))).all(axis=1)
    assert finite[status == 0].all()
    assert (status[500:] != 0).all()


@segments
def test_a_degenerate_pair_does_not_touch_its_neighbours(k):
    x_pair, signs, _, _ = sample_pairs(k, 1, num=3)
    expected = _kernels.project(x_pair, signs)
    spoiled = x_pair.copy()
    spoiled[1, 1:] = degenerate_segments(k)[1]
    for one, other in zip(_kernels.project(spoiled, signs), expected, strict=True):
        np.testing.assert_array_equal(one[[0, 2]], other[[0, 2]])


@segments
def test_empty_batch_gives_empty_results(k):
    results = _kernels.project(np.empty((0, 1 + k, 3)), np.empty(0))
    assert [r.shape for r in results] == [(0, 2), (0,), (0, 3), (0,)]
    assert results[3].dtype == np.int8


@pytest.mark.parametrize(
    ("shape", "num_signs", "given"),
    [
        ((2, 6, 3), 2, "3 or 4.*5"),
        ((2, 2, 3), 2, "3 or 4.*1"),
        ((2, 5, 2), 2, r"2\D+5\D+2"),
        ((5, 3), 5, r"5\D+3"),
        ((2, 5, 3), 7, r"7"),
    ],
)
def test_wrong_shapes_raise_a_value_error_naming_them(shape, num_signs, given):
    with pytest.raises(ValueError, match=given):
        _kernels.project(np.zeros(shape), np.ones(num_signs))
