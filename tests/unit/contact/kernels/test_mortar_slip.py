"""Slips of nodes as means of slips of contact points, against NumPy."""

import numpy as np
import pytest

from dolfinx_nts import _kernels

pytestmark = pytest.mark.serial

P, START = 6, np.array([0, 3, 5, 9], dtype=np.int64)


@pytest.fixture
def shares(rng):
    """Where the shares of three nodes begin, their points and values."""
    value = rng.random(START[-1])
    return START, rng.integers(P, size=START[-1]).astype(np.int32), value


def frames(rng, count):
    """Orthonormal tangents of either handedness, shape ``(count, 2, 3)``."""
    return np.linalg.qr(rng.normal(size=(count, 3, 3)))[0][:, :2]


def of_nodes(values):
    """Sums of values of shares for each node."""
    return np.add.reduceat(values, START[:-1], axis=0)


def test_shares_turn_to_the_frames_of_nodes(shares, rng):
    _, point, value = shares
    at_nodes, at_points = frames(rng, 3), frames(rng, P)
    parts = _kernels.turn_shares(*shares, at_nodes, at_points)
    to = np.repeat(at_nodes, np.diff(START), axis=0)
    products = np.einsum("iac,ibc->iab", to, at_points[point])
    U, _, V = np.linalg.svd(products)
    np.testing.assert_allclose(parts, value[:, None, None] * (U @ V), rtol=0, atol=1e-14)


def test_slips_and_tractions_agree_with_the_shares(shares, rng):
    start, point, _ = shares
    parts, slip, frame = rng.normal(size=(START[-1], 2, 2)), rng.normal(size=(P, 2)), frames(rng, P)
    mean, tangents = _kernels.sum_slip(start, point, parts, slip, frame)
    np.testing.assert_allclose(
        mean, of_nodes(np.einsum("iab,ib->ia", parts, slip[point])), rtol=0, atol=1e-14
    )
    U, _, V = np.linalg.svd(of_nodes(parts @ frame[point]), full_matrices=False)
    np.testing.assert_allclose(tangents, U @ V, rtol=0, atol=1e-12)
    traction = rng.normal(size=(3, 2))
    work = np.vdot(_kernels.spread_tractions(start, point, parts, traction, P), slip)
    assert work == pytest.approx(np.vdot(traction, mean), rel=1e-12)


@pytest.mark.parametrize("k", [3, 4])
def test_second_derivatives_agree_with_points(k, rng):
    count, phi, block = 2, rng.random((P, k)), np.array([0, 1, 1, 0, 1, 0], dtype=np.int32)
    w, b, t = rng.normal(size=(P, 1 + k)), rng.normal(size=(P, 2, 1 + k)), rng.normal(size=(P, 2))
    expected = _kernels.sum_blocks(phi, block, count, np.ones(P), _kernels.slip_hessian(w, b, t))
    found = _kernels.sum_slip_blocks(phi, block, count, w, b, t)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)
    with pytest.raises(ValueError, match="expected numbers of blocks"):
        _kernels.sum_slip_blocks(phi, block, 1, w, b, t)


def test_wrong_shares_are_refused(shares, rng):
    start, point, value = shares
    parts, slip, frame = np.zeros((START[-1], 2, 2)), np.zeros((P, 2)), frames(rng, P)
    with pytest.raises(ValueError, match="expected numbers of points"):
        _kernels.sum_slip(start, point + P, parts, slip, frame)
    with pytest.raises(
        ValueError, match="expected ascending offsets, from 0 to the number of shares"
    ):
        _kernels.turn_shares(start[:-1], point, value, frames(rng, 2), frame)
