"""Edges as segments of the plane, compared with quadrilaterals extruded along z."""

import numpy as np
import pytest

from dolfinx_nts import _kernels

pytestmark = pytest.mark.serial

SCHEMES = ("conserving", "midpoint", "static")
STEP = 1e-6


def states(seed, m=20):
    """Nodes and edges at both ends of large steps, ``(2, m, 3, 3)``, and orientations."""
    rng = np.random.default_rng(seed)
    x_n = np.zeros((m, 3, 3))
    x_n[:, :, :2] = [[0.4, 0.3], [0.0, 0.0], [1.0, 0.2]]
    x_n[:, :, :2] += 0.3 * rng.uniform(-1, 1, (m, 3, 2))
    x = x_n.copy()
    x[:, :, :2] += 0.3 * rng.uniform(-1, 1, (m, 3, 2))
    return x_n, x, rng.choice([-1.0, 1.0], m)


def swept(x):
    """The same with the quadrilateral extruded from the edge, ``(m, 5, 3)``."""
    up = np.array([0.0, 0.0, 1.0])
    return np.stack([x[:, 0], x[:, 1], x[:, 2], x[:, 1] + up, x[:, 2] + up], axis=1)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_force_and_gap_agree_with_the_quadrilateral_that_the_edge_sweeps(scheme):
    x_n, x, orientation = states(1)
    kernel = getattr(_kernels, f"contact_{scheme}")
    gap_n, gap, force, gradient, _, turn = kernel(x_n, x, orientation)
    facets = kernel(swept(x_n), swept(x), orientation)
    # Forces at the vertices above belong to those below.
    to_edge = [facets[i].reshape(-1, 5, 3) for i in (2, 3)]
    to_edge = [np.concatenate([f[:, :1], f[:, 1:3] + f[:, 3:]], axis=1) for f in to_edge]
    expected = (facets[0], facets[1], *to_edge, facets[5])
    for ours, theirs in zip((gap_n, gap, force, gradient, turn), expected, strict=True):
        assert np.abs(ours - theirs.reshape(ours.shape)).max() < 1e-12


def test_conserving_force_is_the_mean_normal_with_the_weights_of_the_closed_form():
    x_n, x, orientation = states(2)
    gap_n, gap, force, *_ = _kernels.contact_conserving(x_n, x, orientation)
    normals = [_kernels.project(y, orientation)[2] for y in (x_n, x)]
    d, mean = sum(normals) / 2, (x_n + x) / 2
    t = np.stack([d[:, 1], -d[:, 0]], axis=1)
    E0, E1 = (mean[:, i, :2] - mean[:, j, :2] for i, j in ((0, 1), (2, 1)))
    beta = np.einsum("mi,mi->m", E0, t) / np.einsum("mi,mi->m", E1, t)
    weights = np.stack([np.ones_like(beta), beta - 1, -beta], axis=1)
    expected = weights[:, :, None] * d[:, None]
    assert np.abs(force.reshape(expected.shape) - expected).max() < 1e-13
    work = np.einsum("md,md->m", force, (x - x_n).reshape(len(x), -1))
    assert np.abs(work - (gap - gap_n)).max() < 1e-13


@pytest.mark.parametrize("scheme", SCHEMES)
def test_tangent_is_the_derivative_of_the_force(scheme):
    x_n, x, orientation = states(3)
    kernel = getattr(_kernels, f"contact_{scheme}")
    tangent = kernel(x_n, x, orientation)[4]
    for node in range(3):
        for axis in range(2):
            moved = [x.copy(), x.copy()]
            moved[0][:, node, axis] -= STEP
            moved[1][:, node, axis] += STEP
            less, more = (kernel(x_n, y, orientation)[2] for y in moved)
            slope = (more - less) / (2 * STEP)
            in_plane = np.arange(9) % 3 < 2
            error = (slope - tangent[:, :, 3 * node + axis])[:, in_plane]
            assert np.abs(error).max() < 1e-8


def test_slip_has_one_component_and_does_its_work():
    x_n, x, orientation = states(4)
    value, force, gradient, _, _, frame_n, frame = _kernels.slip(x_n, x, orientation)
    assert not value[:, 1].any() and not force[:, 1].any() and not gradient[:, 1].any()
    assert not frame_n[:, 0, 2].any() and not frame[:, 0, 2].any()
    work = np.einsum("md,md->m", force[:, 0], (x - x_n).reshape(len(x), -1))
    assert np.abs(work - value[:, 0]).max() < 1e-13
    assert np.abs(force[:, 0].reshape(-1, 3, 3).sum(axis=1)).max() < 1e-14
