"""Both halves of a step, against NumPy."""

import numpy as np
import pytest

from dolfinx_nts import _kernels

pytestmark = pytest.mark.serial


@pytest.fixture
def arrays():
    """Mobility and force or velocity and acceleration, rate, displacement."""
    return np.random.default_rng(0).normal(size=(4, 5, 3))


def test_drift_moves_by_the_velocity_in_the_middle(arrays):
    (v, a, rate, u), dt = arrays, 0.1
    start, du = u.copy(), np.empty_like(u)
    about = np.array([0.5, -1.0, 2.0])
    most, relative = _kernels.drift(dt, v, a, rate, u, du, about)
    np.testing.assert_array_equal(rate, v + dt / 2 * a)
    np.testing.assert_array_equal(u, start + dt * rate)
    np.testing.assert_array_equal(du, u - start)
    assert most == pytest.approx(np.linalg.norm(du, axis=1).max(), rel=1e-15)
    apart = np.linalg.norm(du - dt * about, axis=1).max()
    assert relative == pytest.approx(apart, rel=1e-15)


@pytest.mark.untrapped
@pytest.mark.parametrize("value", [np.nan, -np.nan, np.inf])
def test_drift_reports_an_entry_that_is_not_finite(arrays, value):
    for part in (0, 1, 3):
        v, a, rate, u = np.where(np.arange(4)[:, None, None] == part, 0.0, arrays)
        (v, a, rate, u)[part][2, 1] = value
        motion = _kernels.drift(0.1, v, a, rate, u, rate.copy(), np.zeros(3))
        assert not np.isfinite(motion).any()


def test_kick_accelerates_to_the_end(arrays):
    (mobility, force, a, rate), dt = arrays, 0.1
    start = rate.copy()
    power = _kernels.kick(dt, mobility, force, a, rate)
    np.testing.assert_array_equal(a, mobility * force)
    np.testing.assert_array_equal(rate, start + dt / 2 * a)
    np.testing.assert_allclose(power, np.sum(mobility * force**2))


def test_shapes_are_checked(arrays):
    a, b, c, d = arrays
    with pytest.raises(ValueError, match=r"v: expected shape \(5, 3\), given \(4, 3\)"):
        _kernels.drift(0.1, a[1:], b, c, d, d.copy(), np.zeros(3))
    with pytest.raises(ValueError, match=r"force: expected shape \(5, 3\), given \(4, 3\)"):
        _kernels.kick(0.1, a, b[1:], c, d)
    with pytest.raises(TypeError):
        _kernels.drift(0.1, a, b, c, d[:, ::-1], d.copy(), np.zeros(3))
