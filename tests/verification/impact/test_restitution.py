"""Impact with a coefficient of restitution: rebound, losses, and refused combinations."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers import scenes
from helpers.models import box_meshes
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

STEP, SPEED, ALONG = 0.01, 1.0, 0.5  # s, m/s to the wall and along it
REST = nts.Motion()
# Tolerances of the energy, and of momenta, relative.
ENERGY_TOLERANCE, MOMENTUM_TOLERANCE = 1e-11, 1e-11
# Tolerance of the speed: a cube with a wave speed of 1000 m/s is not quite rigid.
RIGID = 2e-3


def drop(comm, e, phase, scheme):
    """Let a stiff cube fly against a wall, with impact at a given fraction of the second step.

    Returns:
        Its velocity to the wall at the end over that before, and its relative loss of energy by
        the balance and by the ledger.
    """
    mesh, cells, facets, tag = box_meshes.distribute(
        comm, box_meshes.boxes([(1, 1, 1)], [(0.2,) * 3])
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    cube = nts.Body(V, cells, tag["body 0"], nts.SaintVenantKirchhoff(1e9, 0.0, 1e3))
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["bottom 0"]),
        nts.RigidPlane((0, 0, -(1 + phase) * STEP * SPEED), (0, 0, 1)),
        nts.LagrangeMultiplier("restitution", e=e),
        method="node-to-segment",
    )
    stepper = scheme([cube], [pair], dt=STEP)
    stepper.set_velocity(cube, (ALONG, 0, -SPEED))
    diagnostics = nts.Diagnostics(stepper)
    before = diagnostics.balance().total_energy
    work = [sum(step.contact_work) for step in stepper.run(6 * STEP)]
    loss = 1 - diagnostics.balance().total_energy / before
    return diagnostics.body_velocity(cube)[2] / SPEED, loss, -sum(work) / before


@pytest.mark.parametrize("e", [once(1.0), 0.5, once(0.0)])
@pytest.mark.parametrize("phase", [once(0.05), 0.35, once(0.65), once(0.95)])
def test_stiff_body_leaves_with_a_part_of_its_speed_wherever_in_the_step_it_arrives(
    comm, agree, e, phase
):
    rebound, loss, ledger = drop(comm, e, phase, nts.EnergyMomentum)
    assert agree(rebound == pytest.approx(e, abs=RIGID))
    expected = (1 - e**2) * SPEED**2 / (SPEED**2 + ALONG**2)
    assert agree(loss == pytest.approx(expected, abs=RIGID))
    assert agree(abs(loss - ledger) <= ENERGY_TOLERANCE)
    assert agree(e < 1 or abs(loss) <= ENERGY_TOLERANCE)


@pytest.mark.serial
def test_midpoint_rebounds_alike(comm):
    rebound, loss, _ = drop(comm, 0.5, 0.35, nts.Midpoint)
    assert rebound == pytest.approx(0.5, abs=RIGID)
    assert loss == pytest.approx(0.6, abs=RIGID)


@pytest.mark.parametrize("friction", [once(None, id="smooth"), nts.Coulomb(0.3)])
@pytest.mark.parametrize("e", [0.6, once(0.0)])
def test_soft_bodies_lose_energy_at_contacts_only_and_keep_their_momenta(comm, agree, e, friction):
    law = nts.LagrangeMultiplier("restitution", e=e)
    scene = scenes.blocks(comm, enforcement=law, friction=friction)
    diagnostics = nts.Diagnostics(scene.stepper)
    first = before = diagnostics.balance()
    most = 0
    for step in scene.stepper.run(15 * scene.stepper.dt):
        after, work = diagnostics.balance(), step.contact_work
        change = after.total_energy - before.total_energy
        tolerance = ENERGY_TOLERANCE * first.total_energy
        assert agree(abs(change - sum(work)) <= tolerance)
        assert agree(max(work) <= tolerance)
        before, most = after, max(most, step.num_active)
    assert agree(most > 3)
    assert agree(after.total_energy < 0.99 * first.total_energy)
    for name in ("linear_momentum", "angular_momentum"):
        old, new = getattr(first, name), getattr(after, name)
        assert agree(np.abs(new - old).max() <= MOMENTUM_TOLERANCE * np.abs(old).max()), name


@pytest.mark.parametrize("friction", [None, once(nts.Coulomb(0.3), id="rough")])
def test_mean_gaps_of_surfaces_lose_energy_at_contacts_only(comm, agree, friction):
    law = nts.LagrangeMultiplier("restitution", e=0.3)
    scene = scenes.ball_plate(comm, enforcement=law, friction=friction, method="mortar")
    history = scene.run(20)
    works = np.array([sum(report.contact_work) for report in history.reports])
    changes, tolerance = np.diff(history.energy), ENERGY_TOLERANCE * history.energy[0]
    assert agree(np.abs(changes - works).max() <= tolerance)
    assert agree(works.max() <= tolerance and works.sum() < -1e-3 * history.energy[0])
    assert agree(max(history.num_active) > 3)
    assert agree(max(history.linear_drift, history.angular_drift) <= MOMENTUM_TOLERANCE)


@pytest.mark.serial
def test_surfaces_without_rebound_have_no_chatter(table_row):
    roughness, loss = {}, {}
    for e in (1.0, 0.0):
        law = nts.LagrangeMultiplier("restitution", e=e)
        scene = scenes.ball_plate(scenes.MPI.COMM_SELF, enforcement=law, method="mortar")
        (contact,), pressures = scene.stepper.contacts, []
        diagnostics = nts.Diagnostics(scene.stepper)
        before = diagnostics.balance().total_energy
        for _ in scene.stepper.run(35 * scene.stepper.dt):
            pressures.append(contact.pressure.copy())
        changes = np.diff(pressures, 2, axis=0)
        roughness[e] = np.abs(changes).sum() / np.abs(pressures).sum()
        loss[e] = 1 - diagnostics.balance().total_energy / before
    table_row(
        "ball on a plate by mortar, impact with e = 0",
        "second differences in time of the nodal pressures, relative to these",
        f"{roughness[0.0]:.2f}, by elastic impact {roughness[1.0]:.1f}; loss of energy "
        f"{100 * loss[0.0]:.1f} %",
    )
    assert roughness[0.0] < 0.3 * roughness[1.0]
    assert loss[0.0] < 0.005


@pytest.mark.serial
@pytest.mark.parametrize("e", [0.5, 0.0])
@pytest.mark.parametrize("phase", [0.05, 0.65])
def test_stiff_body_leaves_a_surface_with_a_part_of_its_speed(e, phase):
    data = box_meshes.boxes([(2, 2, 1), (3, 3, 1)], [(0.2,) * 3, (0.4, 0.4, 0.1)])
    below = np.unique(data.cells[data.body == 1])
    data.X[below] -= [0.1, 0.1, 0.1 + (1 + phase) * STEP * SPEED]
    mesh, cells, facets, tag = box_meshes.distribute(scenes.MPI.COMM_SELF, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    steel = nts.SaintVenantKirchhoff(1e9, 0.0, 1e3)
    cube, plate = (nts.Body(V, cells, tag[f"body {i}"], steel) for i in range(2))
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["bottom 0"]),
        nts.Surface(V, facets, tag["top 1"]),
        nts.LagrangeMultiplier("restitution", e=e),
        method="mortar",
    )
    held = fem.dirichletbc(np.zeros(3), fem.locate_dofs_geometrical(V, lambda x: x[2] < -1e-4), V)
    stepper = nts.EnergyMomentum([cube, plate], [pair], dt=STEP, bcs=[held])
    stepper.set_velocity(cube, (0, 0, -SPEED))
    list(stepper.run(6 * STEP))
    rebound = nts.Diagnostics(stepper).body_velocity(cube)[2] / SPEED
    assert rebound == pytest.approx(e, abs=RIGID)


def rod(e, angle, cells, axis=(0.0, 0.0, 0.0), g=0.0, motion=REST):
    """A rigid rod that turns about an axis by its upper end, next to a wall that it can lie on."""
    data = box_meshes.boxes([cells], [(0.2, 0.2, 1.0)])
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    data.X[:] = (data.X - [0.1, 0.1, 1.0] - axis) @ turn.T + axis
    mesh, cells, _, tag = box_meshes.distribute(scenes.MPI.COMM_SELF, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    hinge = nts.Guide(turns="y", point=axis)
    body = nts.RigidBody(V, cells, tag["body 0"], 20.0, hinge)
    wall = nts.RigidPlane((0.1, 0, 0), (-1, 0, 0)).moving(motion)
    law = nts.LagrangeMultiplier("restitution", e=e)
    pair = nts.ContactPair(nts.boundary_of(body), wall, law, method="node-to-segment")
    loads = [nts.Gravity([body], (g, 0, 0))] if g else []
    return nts.EnergyMomentum([body], [pair], dt=STEP, loads=loads), body


@pytest.mark.serial
@pytest.mark.parametrize("e", [0.9, 0.5, 0.0])
@pytest.mark.parametrize("phase", [0.05, 0.95])
def test_side_of_a_hinged_rod_meets_a_wall_at_once_and_leaves_with_a_part_of_its_spin(e, phase):
    stepper, body = rod(e, (1 + phase) * STEP, (2, 2, 6))
    stepper.set_velocity(body, lambda X: np.array([-X[2], 0 * X[0], X[0]]))
    diagnostics = nts.Diagnostics(stepper)
    first = diagnostics.balance()
    active = max(step.num_active for step in stepper.run(6 * STEP))
    last = diagnostics.balance()
    assert active >= 3  # as many of the 21 nodes that touch the wall as needed
    spin = last.angular_momentum[1] / first.angular_momentum[1]
    assert spin == pytest.approx(-e, abs=1e-5)
    # An angle of 1/100 a step: the remaining spin at e = 0 is of second order.
    assert last.total_energy / first.total_energy == pytest.approx(e**2, abs=1e-5)


@pytest.mark.serial
@pytest.mark.parametrize("e", [0.9, 0.5, 0.0])
@pytest.mark.parametrize("phase", [0.05, 0.95])
def test_wall_that_turns_meets_the_side_of_a_rod_at_once_and_throws_it(e, phase):
    turning = nts.Motion(rotation=lambda t: (0.0, t, 0.0))
    stepper, _ = rod(e, (1 + phase) * STEP, (2, 2, 6), motion=turning)
    diagnostics = nts.Diagnostics(stepper)
    inertia = 20.0 * 0.2**2 * ((1.0 + 0.2**2) / 12 + 0.5**2)
    active = max(step.num_active for step in stepper.run(6 * STEP))
    assert active >= 3
    spin = diagnostics.balance().angular_momentum[1] / inertia
    assert spin == pytest.approx(1 + e, abs=1e-4)


@pytest.mark.serial
@pytest.mark.parametrize("e", [0.5, 0.0])
def test_nodes_that_rest_on_a_turning_drum_keep_their_gaps(e):
    mesh, cells, facets, tag = box_meshes.distribute(
        scenes.MPI.COMM_SELF, box_meshes.boxes([(4, 1, 2)], [(0.4, 0.1, 0.2)])
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, cells, tag["body 0"], nts.SaintVenantKirchhoff(1e6, 0.0, 1e3))
    top = fem.dirichletbc(
        np.zeros(3), fem.locate_dofs_topological(V, 2, facets.find(tag["top 0"])), V
    )
    turning = nts.Motion(rotation=lambda t: (0.0, t, 0.0), centre=(0.2, 0.0, -0.5))
    drum = nts.RigidCylinder((0.2, 0.0, -0.5), (0, 1, 0), 0.5).moving(turning)
    bottom = nts.Surface(V, facets, tag["bottom 0"])
    pair = nts.ContactPair(
        bottom, drum, nts.LagrangeMultiplier("restitution", e=e), method="node-to-segment"
    )
    weight = nts.Gravity([block], (0, 0, -10))
    stepper = nts.EnergyMomentum([block], [pair], dt=STEP, bcs=[top], loads=[weight])
    steps = list(stepper.run(50 * STEP))
    assert min(step.num_active for step in steps) > 0
    assert np.abs(np.nanmin(pair.gap(stepper.x))) < 1e-12


@pytest.mark.serial
def test_block_that_slides_in_a_tube_does_not_sink_into_it_step_by_step():
    """Half of the straight path of each step leaves the tube, by 9 mm in all steps."""
    radius, size, dt = 1.0, 0.1, 5e-3

    def build(model):
        corner = (-size / 2, 0.02 - radius)
        parts.add_rectangle(model, "block", corner=corner, size=(size, size), cells=(2, 2))

    mesh, cells, _, tag = nts.read_mesh(build, scenes.MPI.COMM_SELF)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    block = nts.Body(V, cells, tag["block"], nts.SaintVenantKirchhoff(1e7, 0.0, 1e3))
    tube = nts.RigidSphere((0.0, 0.0), radius, hollow=True)
    law = nts.LagrangeMultiplier("restitution", e=0.0)
    pair = nts.ContactPair(nts.boundary_of(block), tube, law, method="node-to-segment")
    stepper = nts.EnergyMomentum([block], [pair], dt=dt)
    stepper.set_velocity(block, lambda X: 5.25 * np.array([-X[1], X[0]]))
    depth = []
    for step in stepper.run(until=0.5):
        depth.append(np.linalg.norm(stepper.x, axis=1).max() - radius)
        assert sum(step.contact_work) < 1e-9
    # It has reached the wall up to the tolerance of an impact, and rests.
    assert 0 < np.mean(depth[-20:]) < 2.5e-3
    assert np.mean(depth[-20:]) - np.mean(depth[40:60]) < 1e-3


@pytest.mark.serial
@pytest.mark.parametrize("axis", [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0)], ids=["middle", "side"])
@pytest.mark.parametrize("cells", [(2, 2, 2), (2, 2, 6)], ids=["coarse", "fine"])
def test_hinged_rod_that_falls_against_a_wall_comes_to_rest_on_it(axis, cells):
    stepper, _ = rod(0.5, 0.4, cells, axis, g=9.81)
    diagnostics = nts.Diagnostics(stepper)
    first, given = diagnostics.balance(), 0.0
    for step in stepper.run(until=1.5):
        given += sum(step.contact_work) + step.load_work
        assert max(step.contact_work) < 1e-12
    last = diagnostics.balance()
    assert abs(last.total_energy - first.total_energy - given) < 1e-11
    assert last.kinetic_energy < 1e-3 and abs(stepper.x[:, 0].max() - 0.1) < 0.02


@pytest.mark.serial
@pytest.mark.parametrize("e", [1.0, 0.5, 0.0])
@pytest.mark.parametrize("tilt", [0.3, 0.8])
@pytest.mark.parametrize("phase", [0.0, 0.5])
def test_rod_that_strikes_the_floor_by_an_edge_has_the_impulse_of_a_rigid_one(e, tilt, phase):
    """Both ends of the edge arrive together; at phase 0 round-off decides at the end of a step."""
    length, height, dt = 1.0, 0.1, 1e-3
    data = box_meshes.boxes([(4, 1, 1)], [(length, height, height)])
    c, s = np.cos(tilt), np.sin(tilt)
    data.X[:] = (data.X - [length / 2, height / 2, height / 2]) @ [[c, 0, -s], [0, 1, 0], [s, 0, c]]
    data.X[:, 2] += (4 + phase) * dt * SPEED - data.X[:, 2].min()
    mesh, cells, _, tag = box_meshes.distribute(scenes.MPI.COMM_SELF, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    body, floor = nts.RigidBody(V, cells, tag["body 0"], 1e3), nts.RigidPlane((0, 0, 0), (0, 0, 1))
    law = nts.LagrangeMultiplier("restitution", e=e)
    pair = nts.ContactPair(nts.boundary_of(body), floor, law, method="node-to-segment")
    stepper = nts.EnergyMomentum([body], [pair], dt=dt)
    stepper.set_velocity(body, (0, 0, -SPEED))
    diagnostics = nts.Diagnostics(stepper)
    for _ in stepper.run(until=10 * dt):
        pass
    mass = 1e3 * length * height**2
    arm, inertia = (length * c - height * s) / 2, mass / 12 * (length**2 + height**2)
    impulse = (1 + e) * mass * SPEED / (1 + mass * arm**2 / inertia)
    last = diagnostics.balance()
    # The rod turns in the step of the impact.
    assert last.linear_momentum[2] + mass * SPEED == pytest.approx(impulse, rel=2e-3)
    loss = (1 - e) * SPEED * impulse / 2
    assert mass * SPEED**2 / 2 - last.total_energy == pytest.approx(loss, rel=2e-3, abs=1e-11)
    assert np.abs(last.angular_momentum[[0, 2]]).max() <= 1e-11  # no other end is struck


def test_laws_without_a_coefficient_of_restitution_are_refused(comm, refused):
    for impact, e in (("restitution", None), ("elastic", 0.5)):
        with refused(ValueError, f"with no other impact, given impact '{impact}' and e = {e}"):
            nts.LagrangeMultiplier(impact, e=e)
    for e in (-0.1, 1.1):
        with refused(ValueError, f"restitution e from 0 to 1, given {e}"):
            nts.LagrangeMultiplier("restitution", e=e)
    law = nts.LagrangeMultiplier("restitution", e=0.5)
    for scheme, reason in (
        (nts.GeneralizedAlpha, "LagrangeMultiplier.'plastic'. for GeneralizedAlpha"),
        (nts.CentralDifference, "contact by Penalty for an explicit step"),
    ):
        with refused(ValueError, reason):
            scenes.blocks(comm, scheme, law)
