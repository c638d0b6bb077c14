"""Rigid obstacles: gap, conserving force, slip, and refused arguments."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers import scenes
from helpers.scene import Totals
from reference.bulk import taylor_order

pytestmark = pytest.mark.at_most_two_ranks

ROUNDING = 1e3 * np.finfo(float).eps
POINT, AXIS = np.array([0.3, -0.2, 0.1]), np.array([1.0, 2.0, 2.0])

UNIT = AXIS / 3


def radial(x):
    return x - POINT - np.outer((x - POINT) @ UNIT, UNIT)


# Obstacle and its signed distance by the definition.
CASES = {
    "plane": (nts.RigidPlane(POINT, AXIS), lambda x: (x - POINT) @ UNIT),
    "sphere": (
        nts.RigidSphere(POINT, 0.7),
        lambda x: np.sqrt(((x - POINT) ** 2).sum(axis=1)) - 0.7,
    ),
    "bowl": (
        nts.RigidSphere(POINT, 2.0, hollow=True),
        lambda x: 2.0 - np.sqrt(((x - POINT) ** 2).sum(axis=1)),
    ),
    "cylinder": (
        nts.RigidCylinder(POINT, AXIS, 0.5),
        lambda x: np.linalg.norm(radial(x), axis=1) - 0.5,
    ),
    "tube": (
        nts.RigidCylinder(POINT, AXIS, 3.0, hollow=True),
        lambda x: 3.0 - np.linalg.norm(radial(x), axis=1),
    ),
}
obstacles = pytest.mark.parametrize("name", CASES)
schemes = pytest.mark.parametrize("scheme", ["conserving", "midpoint", "static"])


def states(rng, m=30):
    # Away from the axis, where the curvature is bounded.
    x_n = POINT + rng.normal(size=(m, 3))
    r = radial(x_n)
    x_n += r / np.linalg.norm(r, axis=1)[:, None]
    return x_n, x_n + 0.3 * rng.normal(size=(m, 3)), np.zeros(m, dtype=np.int32)


@pytest.mark.serial
@obstacles
def test_gap_is_the_signed_distance_and_the_normal_its_gradient(name, rng):
    obstacle, distance = CASES[name]
    _, x, _ = states(rng)
    gap, normal = obstacle.distance(x)
    np.testing.assert_allclose(gap, distance(x), atol=ROUNDING)
    d = 0.2 * rng.normal(size=x.shape)
    slope = np.einsum("mi,mi->m", normal, d)
    if name == "plane":
        np.testing.assert_allclose(distance(x + d) - gap, slope, atol=ROUNDING)
    else:
        assert taylor_order(distance, x, d, slope) > 1.9
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, rtol=ROUNDING)


@pytest.mark.serial
@obstacles
def test_work_of_the_conserving_force_is_the_change_of_the_gap(name, rng):
    obstacle, distance = CASES[name]
    x_n, x, segment = states(rng)
    gap_n, gap, force, *_ = obstacle.contact("conserving", x_n, x, segment)
    work = np.einsum("mi,mi->m", force, x - x_n)
    np.testing.assert_allclose(work, distance(x) - distance(x_n), atol=ROUNDING)
    np.testing.assert_allclose(gap - gap_n, work, atol=ROUNDING)


@pytest.mark.serial
@obstacles
@schemes
def test_tangent_is_the_derivative_of_the_force(name, scheme, rng):
    obstacle, _ = CASES[name]
    x_n, x, segment = states(rng)
    d = 0.1 * rng.normal(size=x.shape)
    tangent = obstacle.contact(scheme, x_n, x, segment)[4]
    slope = np.einsum("mij,mj->mi", tangent, d)

    def force(y):
        return obstacle.contact(scheme, x_n, y, segment)[2]

    if name == "plane":
        assert np.array_equal(force(x + d), force(x)) and not slope.any()
    else:
        assert taylor_order(force, x, d, slope) > 1.9


@pytest.mark.serial
@obstacles
def test_work_of_a_traction_on_an_obstacle_is_the_slip(name, rng):
    obstacle, _ = CASES[name]
    x_n, x, segment = states(rng)
    slip = obstacle.slip(x_n, x, segment)
    work = np.einsum("mij,mj->mi", slip.force, x - x_n)
    np.testing.assert_allclose(work, slip.value, atol=ROUNDING)
    for state, normal in ((x_n, slip.normal_n), (x, slip.normal)):
        np.testing.assert_allclose(normal, obstacle.distance(state)[1], atol=ROUNDING)


@pytest.mark.serial
@obstacles
def test_tangents_turn_with_the_normal_by_the_smallest_rotation(name, rng):
    """For any choice of axes: a traction must not turn about the normal."""
    obstacle, _ = CASES[name]
    x_n, x, segment = states(rng, m=300)
    slip = obstacle.slip(x_n, x, segment)
    axis = np.cross(slip.normal_n, slip.normal)
    sine, cosine = np.linalg.norm(axis, axis=1), np.einsum("mi,mi->m", slip.normal_n, slip.normal)
    axis /= np.maximum(sine, 1e-12)[:, None]
    for k in range(2):
        v = slip.frame_n[:, k]  # turned by Rodrigues' formula
        along = np.einsum("mi,mi->m", axis, v)[:, None] * axis
        expected = along + cosine[:, None] * (v - along) + sine[:, None] * np.cross(axis, v)
        np.testing.assert_allclose(slip.frame[:, k], expected, atol=ROUNDING)


@pytest.mark.serial
@obstacles
def test_friction_at_the_end_of_a_step_acts_along_the_surface_there(name, rng):
    obstacle, _ = CASES[name]
    x_n, x, segment = states(rng)
    t, d = rng.normal(size=(len(x), 2)), 0.1 * rng.normal(size=x.shape)

    def force(y):
        return np.einsum("mi,mij->mj", t, obstacle.slip(x_n, y, segment).at_end().force)

    normal = obstacle.distance(x)[1]
    np.testing.assert_allclose(np.einsum("mi,mi->m", force(x), normal), 0, atol=ROUNDING)
    tangent = obstacle.slip(x_n, x, segment).at_end().tangent(t)
    slope = np.einsum("mij,mj->mi", tangent, d)
    if name == "plane":
        assert np.array_equal(force(x + d), force(x)) and not slope.any()
    else:
        assert taylor_order(force, x, d, slope) > 1.9


def on_obstacle(scene, obstacle, friction=None):
    """Return the scene with an obstacle in place of the segments."""
    old = scene.stepper
    pair = nts.ContactPair(
        old.pairs[0].nodes,
        obstacle,
        friction=friction,
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    stepper = type(old)(old.bodies, [pair], dt=old.dt)
    for body in old.bodies:
        stepper.set_velocity(body, old.v)
    return replace(scene, stepper=stepper)


@pytest.mark.parametrize("friction", [None, nts.Coulomb(0.3)], ids=["frictionless", "friction"])
def test_ball_on_a_rigid_plane_keeps_energy_and_loses_only_by_friction(comm, friction):
    scene = scenes.ball_plate(comm, shift=scenes.NO_TIES)
    scene = on_obstacle(scene, nts.RigidPlane((0, 0, 0.0), (0, 0, 1)), friction)
    (pair,) = scene.stepper.pairs
    totals = Totals(scene)
    start, lost = totals.row()[1:3].sum(), 0.0
    for _ in scene.stepper.run(until=0.3):
        lost += comm.allreduce(pair.history.dissipation.sum())
        assert comm.allreduce(pair.history.dissipation.min(initial=0.0)) > -1e-12 * start
    assert comm.allreduce(int(pair.history.active.sum())) > 3
    assert abs(totals.row()[1:3].sum() + lost - start) < 1e-10 * start
    assert (lost > 0.01 * start) == (friction is not None)


def test_body_inside_an_obstacle_at_the_start_is_refused(comm, refused):
    scene = scenes.ball_plate(comm)
    scene = on_obstacle(scene, nts.RigidPlane((0, 0, 0.1), (0, 0, 1)))
    message = r"outside of obstacles, given \d+ nodes of .* up to 0\.05 inside a RigidPlane"
    with refused(ValueError, message):
        scene.stepper.advance()
    assert scene.stepper.t == 0


def test_body_that_is_put_into_an_obstacle_between_steps_is_refused(comm, refused, agree):
    scene = scenes.ball_plate(comm)
    scene = on_obstacle(scene, nts.RigidPlane((0, 0, 0), (0, 0, 1)))
    stepper, bodies = scene.stepper, scene.bodies
    while not agree(stepper.advance().num_active > 3):
        pass
    # Active nodes slightly inside may stay, and move down by less.
    gap = stepper.contacts[0].gap(stepper.x).min(initial=0.0)
    assert -1e-2 < comm.allreduce(gap, op=MPI.MIN) < -1e-5
    now = fem.Function(stepper.u.function_space)
    now.x.array[:] = stepper.u.x.array
    stepper.set_displacement(bodies["ball"], now)
    stepper.advance()
    now.x.array[2::3] -= 0.05
    stepper.set_displacement(bodies["ball"], now)
    step = stepper.step
    for _ in range(2):
        with refused(ValueError, r"nodes of .* up to 0\.05\d* inside a RigidPlane"):
            stepper.advance()
    assert stepper.step == step
    now.x.array[2::3] += 0.05
    stepper.set_displacement(bodies["ball"], now)
    assert stepper.advance().step == step + 1


@pytest.mark.serial
def test_invalid_numbers_of_obstacles_are_refused():
    with pytest.raises(ValueError, match=r"radius > 0, given -1"):
        nts.RigidSphere((0, 0, 0), -1)
    with pytest.raises(ValueError, match="three finite numbers for centre"):
        nts.RigidSphere((0, 0, 0, 0), 1)
    with pytest.raises(ValueError, match="two finite numbers for normal"):
        nts.RigidPlane((0, 0), (0, 0, 1))
    with pytest.raises(ValueError, match="direction for normal"):
        nts.RigidPlane((0, 0, 0), (0, 0, 0))
    with pytest.raises(ValueError, match="direction for axis"):
        nts.RigidCylinder((0, 0, 0), (0, 0, 0), 1)
