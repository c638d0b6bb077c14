"""Cone complementarity problem of Coulomb friction at all points of a linear system."""

import numpy as np
import pytest

from dolfinx_nts.solvers.linear import friction_cones

pytestmark = pytest.mark.serial

MU = 0.4


def corners(num: int, rng: np.random.Generator) -> np.ndarray:
    """Motions ``(3 num, 6)`` of points of one rigid body by its free motions, normal first."""
    angle = 2 * np.pi * (np.arange(num) + rng.uniform(-0.1, 0.1, num)) / num
    at = np.column_stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), np.full(num, -0.5)])
    turns = np.cross(np.eye(3)[:, None], at).transpose(1, 2, 0)
    rows = np.concatenate([np.tile(np.eye(3), (num, 1, 1)), turns], axis=2)
    return rows[:, [2, 0, 1]].reshape(3 * num, 6)


@pytest.mark.parametrize(
    ("q", "expected"),
    [
        ([1e-5, 3e-5, 0.0], (False, False)),  # opens
        ([-1e-5, 1.2e-6, -0.9e-6], (True, False)),  # sticks
        ([-1e-5, 3e-5, 4e-5], (True, True)),  # slides
    ],
)
def test_a_single_point_opens_sticks_or_slides(q, expected):
    W = np.diag([2e-6, 1e-6, 1e-6])
    found = friction_cones.solve(W, np.array(q), np.array([MU]))
    assert (found.presses[0], found.slides[0]) == expected
    p, t = found.force[0, 0], found.force[0, 1:]
    if not expected[0]:
        assert abs(found.force).max() < 1e-9
    elif expected[1]:
        slip = np.array(q[1:]) / np.linalg.norm(q[1:])
        np.testing.assert_allclose(p, 5.0, rtol=1e-8)
        np.testing.assert_allclose(t, -MU * p * slip, rtol=1e-8)
    else:
        # Regularisation of the forces moves points by 1e-10 of their free motions.
        np.testing.assert_allclose(found.force[0], [5.0, -1.2, 0.9], rtol=1e-8)
        assert abs(found.motion).max() < 1e-14


@pytest.mark.parametrize("num", [3, 4, 8])
@pytest.mark.parametrize("speed", [0.0, 0.1, 10.0])
def test_redundant_points_of_a_body_obey_all_conditions(num, speed, rng):
    rows = corners(num, rng)
    motion = np.array([*rng.normal(0, speed, 2), -1.0, *rng.normal(0, speed, 3)]) * 1e-5
    found = friction_cones.solve(rows @ rows.T * 1e-6, rows @ motion, np.full(num, MU))
    p, t, gap, slip = np.split(np.hstack([found.force, found.motion]), [1, 3, 4], axis=1)
    length, size = np.linalg.norm(slip, axis=1), np.linalg.norm(t, axis=1)
    assert gap.min() > -1e-13 and p.min() > -1e-8
    assert abs(p * gap).max() < 1e-12
    assert (size - MU * p[:, 0]).max() < 1e-7
    # The full friction opposes sliding points.
    lost = np.einsum("mi,mi->m", t, slip) + MU * p[:, 0] * length
    assert abs(lost).max() < 1e-12
    if speed == 0:
        assert found.presses.all() and not found.slides.any()


def test_points_that_share_nothing_do_not_change_each_other(rng):
    one, other = (corners(4, rng) for _ in range(2))
    mu = np.full(4, MU)
    Ws = [rows @ rows.T * 1e-6 for rows in (one, other)]
    qs = [rows @ [3e-5, 0.0, -1e-5, 0.0, 0.0, 1e-5] for rows in (one, other)]
    W = np.block([[Ws[0], np.zeros((12, 12))], [np.zeros((12, 12)), 1e6 * Ws[1]]])
    both = friction_cones.solve(W, np.concatenate([qs[0], 1e6 * qs[1]]), np.tile(mu, 2))
    for part, scale in enumerate((1.0, 1e6)):
        alone = friction_cones.solve(scale * Ws[part], scale * qs[part], mu)
        half = slice(4 * part, 4 * part + 4)
        np.testing.assert_array_equal(both.force[half], alone.force)
        np.testing.assert_array_equal(both.slides[half], alone.slides)


def test_constraints_without_dofs_stay_undecided():
    assert friction_cones.solve(np.zeros((3, 3)), np.array([-1.0, 0.0, 0.0]), np.ones(1)) is None
    assert friction_cones.solve(np.eye(3), np.zeros(3), np.ones(1)) is None
