"""Slip of a pair between two states: objective, quadratic, in equilibrium."""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from reference.bulk import rotation, sample_pairs, taylor_order

pytestmark = pytest.mark.serial

ROUNDING = 1e3 * np.finfo(float).eps

kinds = pytest.mark.parametrize("k", [3, 4])
sides = pytest.mark.parametrize("orientation", [1.0, -1.0])


def two_states(k, orientation):
    """Return pairs at t_n, with a known projection, and after a small motion."""
    x_n, signs, xi, _ = sample_pairs(k, orientation)
    rng = np.random.default_rng(k)
    return x_n, x_n + 0.1 * rng.normal(size=x_n.shape), signs, xi


def by_definition(x_n, x, xi, k):
    """Return e_i . (x_s - x_bar(xi_n)), the frame convected with the segment."""
    a, b = xi
    if k == 3:
        phi, dphi = np.array([1 - a - b, a, b]), np.array([[-1, 1, 0], [-1, 0, 1]])
    else:
        phi = np.array([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b])
        dphi = np.array([[b - 1, 1 - b, -b, b], [a - 1, -a, 1 - a, a]])
    tangents = dphi @ x_n[1:]
    # e_i = c_ia a_a is orthonormal at t_n: c is the inverse of R in QR.
    _, R = np.linalg.qr(tangents.T)
    c = np.linalg.inv(R * np.sign(np.diag(R))[:, None]).T
    return c @ dphi @ x[1:] @ (x[0] - phi @ x[1:])


@kinds
@sides
def test_slip_is_the_displacement_along_the_convected_frame(k, orientation):
    x_n, x, signs, xi = two_states(k, orientation)
    value = _kernels.slip(x_n, x, signs)[0]
    expected = [by_definition(*pair, k) for pair in zip(x_n, x, xi, strict=True)]
    np.testing.assert_allclose(value, expected, atol=ROUNDING)


@kinds
@sides
def test_work_of_a_unit_traction_is_the_slip(k, orientation):
    x_n, x, signs, _ = two_states(k, orientation)
    value, force, *_ = _kernels.slip(x_n, x, signs)
    work = np.einsum("mid,md->mi", force, (x - x_n).reshape(len(x), -1))
    np.testing.assert_allclose(work, value, atol=ROUNDING)


@kinds
@sides
def test_forces_and_their_moments_at_the_midpoint_vanish(k, orientation):
    x_n, x, signs, _ = two_states(k, orientation)
    force = _kernels.slip(x_n, x, signs)[1].reshape(len(x), 2, 1 + k, 3)
    assert np.abs(force.sum(axis=2)).max() < ROUNDING
    assert np.abs(np.cross((x_n + x)[:, None] / 2, force).sum(axis=2)).max() < ROUNDING


@kinds
def test_slip_is_unchanged_by_a_rigid_motion_within_the_step(k):
    x_n, x, signs, _ = two_states(k, 1.0)
    moved = x @ rotation(np.array([1.0, 2, 3]), 1.1).T + [3.0, -1, 2]
    value, turned = (_kernels.slip(x_n, y, signs)[0] for y in (x, moved))
    np.testing.assert_allclose(turned, value, atol=ROUNDING)
    rigid = x_n @ rotation(np.array([3.0, 2, 1]), 0.7).T
    assert np.abs(_kernels.slip(x_n, rigid, signs)[0]).max() < ROUNDING


@kinds
@sides
def test_gradient_and_second_derivative_have_remainders_of_second_order(k, orientation, rng):
    x_n, x, signs, _ = two_states(k, orientation)
    _, force, gradient, w, b, *_ = _kernels.slip(x_n, x, signs)
    d = rng.normal(size=x.shape)
    slope = np.einsum("mid,md->mi", gradient, d.reshape(len(x), -1))
    assert taylor_order(lambda y: _kernels.slip(x_n, y, signs)[0], x, d, slope) > 1.9
    # The force is linear in x: half the (constant) second derivative.
    outer = np.einsum("ma,mib->miab", w, b)
    change = np.einsum("miab,mbc->miac", outer + outer.swapaxes(2, 3), d) / 2
    moved = _kernels.slip(x_n, x + d, signs)[1]
    np.testing.assert_allclose(moved - force, change.reshape(force.shape), atol=1e2 * ROUNDING)


@kinds
@sides
def test_frames_are_orthonormal_and_span_the_tangent_plane(k, orientation):
    x_n, x, signs, _ = two_states(k, orientation)
    *_, frame_n, frame = _kernels.slip(x_n, x, signs)
    for state, e in ((x_n, frame_n), (x, frame)):
        products = np.einsum("mic,mjc->mij", e, e)
        np.testing.assert_allclose(products, np.tile(np.eye(2), (len(x), 1, 1)), atol=ROUNDING)
        normal = _kernels.project(state, signs)[2]
        assert np.abs(np.einsum("mic,mc->mi", e, normal)).max() < ROUNDING
        cross = signs[:, None] * np.cross(e[:, 0], e[:, 1])
        np.testing.assert_allclose(cross, normal, atol=ROUNDING)


@kinds
def test_tractions_turn_with_the_segment_whatever_the_order_of_its_vertices(k):
    x_n, x, signs, _ = two_states(k, 1.0)
    vertices = [1, 2, 0] if k == 3 else [1, 3, 0, 2]  # turned about the normal
    turns = []
    for order in (np.arange(1 + k), np.array([0, *np.add(vertices, 1)])):
        *_, frame_n, frame = _kernels.slip(x_n[:, order], x[:, order], signs)
        np.testing.assert_allclose(
            frame @ frame.swapaxes(1, 2), np.tile(np.eye(2), (len(x), 1, 1)), atol=ROUNDING
        )
        turns.append(np.einsum("mai,maj->mij", frame, frame_n))
    np.testing.assert_allclose(turns[1], turns[0], atol=ROUNDING)
