"""Obstacles of users, given by a signed distance: a torus, and a sphere against the closed form."""

import numpy as np
import pytest

import dolfinx_nts as nts
from reference.bulk import taylor_order

pytestmark = pytest.mark.serial


class Torus(nts.ExactObstacle):
    """Torus of radii 1 m and 0.3 m around the axis z."""

    def distance(self, x):
        across = np.hypot(x[:, 0], x[:, 1])
        middle = x * [1, 1, 0] / across[:, None]
        away = np.linalg.norm(x - middle, axis=1)
        return away - 0.3, (x - middle) / away[:, None]


class Ball(nts.ExactObstacle):
    """Ball of radius 1 m by its distance alone."""

    def distance(self, x):
        r = np.linalg.norm(x, axis=1)
        return r - 1.0, x / r[:, None]


def test_work_of_the_force_is_the_change_of_the_gap(rng):
    x_n, d = rng.normal(size=(2, 50, 3))
    for size in (1.0, 1e-3, 1e-9):
        x = x_n + size * d
        of = Torus().contact("conserving", x_n, x, np.zeros(50, dtype=np.int32))
        work = np.einsum("mi,mi->m", of.force, x - x_n)
        np.testing.assert_allclose(work, of.gap - of.gap_n, atol=1e-14)


@pytest.mark.parametrize("scheme", ["conserving", "midpoint", "static"])
def test_tangent_is_the_derivative_of_the_force(rng, scheme):
    x_n, x, d = rng.normal(size=(3, 20, 3))
    segment = np.zeros(20, dtype=np.int32)
    slope = np.einsum("mij,mj->mi", Torus().contact(scheme, x_n, x, segment).tangent, 1e-3 * d)

    def force(y):
        return Torus().contact(scheme, x_n, y, segment).force

    assert taylor_order(force, x, 1e-3 * d, slope) > 1.9


def test_ball_by_its_distance_is_a_rigid_sphere(rng):
    x_n, x = 2 * rng.normal(size=(2, 50, 3))
    exact, ball = nts.RigidSphere((0, 0, 0), 1.0), Ball()
    outside = np.full(50, -1, dtype=np.int32)
    inside = np.linalg.norm(x_n, axis=1) < 1
    x_n[inside] *= 2 / np.linalg.norm(x_n[inside], axis=1)[:, None]
    found, expected = (each.follow(x_n, x, outside, None) for each in (ball, exact))
    np.testing.assert_array_equal(found.entered, expected.entered)
    assert (found.entered == 0).sum() > 5
    enters = found.entered == 0
    np.testing.assert_allclose(found.begin[enters], expected.begin[enters], atol=1e-6)
    np.testing.assert_allclose(found.length[enters], expected.length[enters], atol=1e-6)


def test_obstacle_of_a_user_shows_its_arguments():
    class Bowl(Ball):
        def __init__(self, radius):
            self.radius, self.shortest_passage = radius, radius / 2

    def lift(t):
        return 0.0, 0.0, t

    bowl = Bowl(2.0)
    assert repr(bowl) == "Bowl(radius=2)"
    assert repr(bowl.moving(nts.Motion(lift))).startswith("Bowl(radius=2).moving(Motion(")
