"""Edges that cross with a coefficient of restitution: closed forms of rigid bodies."""

import numpy as np
import pytest

import dolfinx_nts as nts
from helpers.models.crossing import PLACE, VELOCITY, crossed
from helpers.once import once
from helpers.scene import Motion

MASS = 10.0  # of a cube [kg]


def with_e(comm, e, **laws):
    """Two rigid cubes whose edges meet."""
    enforcement = nts.LagrangeMultiplier("restitution", e=e)
    return crossed(comm, is_rigid=True, enforcement=enforcement, **laws)


def strike(scene, until):
    """Balances at start and end, and the work of contact [J]."""
    diagnostics, given = nts.Diagnostics(scene.stepper), 0.0
    first = diagnostics.balance()
    while scene.stepper.t < until:
        given += sum(scene.stepper.advance().contact_work)
    return first, diagnostics.balance(), given


def check(first, last, given):
    """The ledger closes, and both momenta are conserved."""
    assert abs(last.total_energy - first.total_energy - given) < 1e-11 * first.total_energy
    for name in ("linear_momentum", "angular_momentum"):
        before, after = getattr(first, name), getattr(last, name)
        size = max(np.linalg.norm(before), np.linalg.norm(first.linear_momentum))
        assert np.linalg.norm(after - before) < 1e-11 * size


def departure(scene):
    """Mean velocity of the upper cube relative to the lower one, shape ``(3,)`` [m/s]."""
    v, n = scene.stepper.v.x.array.reshape(-1, 3), len(scene.stepper.node_ids)
    comm = scene.stepper.u.function_space.mesh.comm
    means = []
    for name in ("upper", "lower"):
        nodes = scene.bodies[name].nodes
        own = nodes[nodes < n]
        means.append(comm.allreduce(v[own].sum(axis=0)) / comm.allreduce(len(own)))
    return means[0] - means[1]


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("e", [once(0.0), once(0.3), 0.7, once(1.0)])
@pytest.mark.parametrize("dt", [once(0.0073), 0.01])
def test_central_blow_of_two_edges_returns_e_times_the_speed(comm, e, dt):
    motion = Motion.random(np.random.default_rng(3))
    place, velocity = (0.0, 0.0, np.sqrt(2) + 0.02), (0.0, 0.0, -1.0)
    scene = with_e(comm, e, dt=dt, motion=motion, place=place, velocity=velocity)
    first, last, given = strike(scene, 0.1)
    check(first, last, given)
    assert np.abs(motion.Q.T @ departure(scene) - [0, 0, e]).max() < 1e-11
    assert given == pytest.approx(-(1 - e**2) * MASS / 4, abs=1e-10)


@pytest.mark.serial
@pytest.mark.parametrize("e", [0.3, 0.7, 1.0])
def test_eccentric_impact_obeys_newtons_law(comm, e):
    scene = with_e(comm, e, dt=0.002)
    first, last, given = strike(scene, 0.04)
    check(first, last, given)
    # Distance of the crossing point from the centres: x on the lower cube, y on the upper one.
    time = (PLACE[2] - np.sqrt(2)) / -VELOCITY[2]
    x, y = PLACE[:2] + time * VELOCITY[:2]
    compliance = 2 / MASS + 6 * (x**2 + y**2) / MASS
    impulse = (1 + e) / compliance
    # Up to the rotation of the normal during contact.
    assert departure(scene)[2] == pytest.approx(-1 + 2 * impulse / MASS, abs=1e-3)
    assert given == pytest.approx(-(1 - e**2) / compliance / 2, abs=2e-3 * MASS)


@pytest.mark.serial
def test_restitution_holds_with_midpoint_and_friction(comm):
    place, velocity = (0.0, 0.0, np.sqrt(2) + 0.02), (0.0, 0.0, -1.0)
    blow = {"place": place, "velocity": velocity, "dt": 0.01}
    for laws in ({"scheme": nts.Midpoint}, {"friction": nts.Coulomb(0.2)}):
        scene = with_e(comm, 0.4, **blow, **laws)
        check(*strike(scene, 0.1))
        assert departure(scene)[2] == pytest.approx(0.4, abs=1e-11)


@pytest.mark.at_most_two_ranks
def test_deformable_cubes_lose_the_energy_of_the_ledger(comm):
    enforcement = nts.LagrangeMultiplier("restitution", e=0.5)
    scene = crossed(comm, enforcement=enforcement, n=2, dt=0.004)
    first, last, given = strike(scene, 0.1)
    check(first, last, given)
    assert given < -1e-3 * first.total_energy


@pytest.mark.serial
def test_friction_dissipates_in_addition_to_restitution(comm):
    given = []
    for friction in (None, nts.Coulomb(0.2)):
        scene = with_e(comm, 0.4, friction=friction, dt=0.004)
        first, last, work = strike(scene, 0.04)
        check(first, last, work)
        given.append(work)
    assert given[1] < given[0] - 1e-3
