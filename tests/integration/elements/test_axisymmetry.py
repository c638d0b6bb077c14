"""Bodies of revolution: conservation, the axis, any number of ranks."""

from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

import dolfinx_nts as nts
from helpers.models.rings import GAP, RUBBER, R, ball_on_plate, round_block, shell
from helpers.models.round import tagged
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

SPEED, STEPS = 3.0, 18  # m/s


def run(stepper, steps=STEPS):
    """Balances of all states of a run, and the reports of its steps."""
    stepper.set_velocity(stepper.bodies[0], (0.0, -SPEED))
    diagnostics = nts.Diagnostics(stepper)
    balances, reports = [diagnostics.balance()], []
    for _ in range(steps):
        reports.append(stepper.advance())
        balances.append(diagnostics.balance())
    return balances, reports


@pytest.mark.parametrize(
    ("cell", "degree", "method", "impact"),
    [
        once("quadrilateral", 1, "node-to-segment", "elastic"),
        once("triangle", 1, "node-to-segment", "elastic"),
        ("triangle", 2, "node-to-segment", "elastic"),
        ("quadrilateral", 1, "mortar", "elastic"),
        once("triangle", 2, "mortar", "elastic"),
        ("quadrilateral", 1, "node-to-segment", "resolved"),
        once("triangle", 1, "mortar", "resolved"),
        once("quadrilateral", 2, "mortar", "resolved"),
    ],
)
def test_impact_of_a_ball_conserves_energy_and_axial_momentum(cell, degree, method, impact):
    scene = ball_on_plate(cell, degree)
    pairs = scene.pairs(method=method, enforcement=nts.LagrangeMultiplier(impact))
    stepper = nts.EnergyMomentum(scene.bodies, pairs, dt=0.002)
    (first, *others), reports = run(stepper)
    assert max(report.num_active for report in reports) > 2
    assert first.linear_momentum.shape == first.contact_force.shape == (1,)
    assert first.angular_momentum.shape == (0,)
    # A ball of facets is a little lighter.
    mass = nts.Diagnostics(stepper).bodies()["ball"].mass
    assert 0.97 < mass / (4 / 3 * np.pi * R**3 * RUBBER["rho"]) <= 1 + 1e-12
    assert first.kinetic_energy == pytest.approx(mass * SPEED**2 / 2, rel=1e-12)
    for balance in others:
        assert abs(balance.total_energy - first.total_energy) < 1e-10 * first.total_energy
        change = balance.linear_momentum - first.linear_momentum
        assert abs(change[0]) < 1e-11 * mass * SPEED


@pytest.mark.parametrize(
    ("enforcement", "eps_T", "method"),
    [
        (nts.LagrangeMultiplier(), None, "node-to-segment"),
        once(nts.LagrangeMultiplier("plastic"), 1e5, "node-to-segment"),
        once(nts.LagrangeMultiplier("restitution", e=0.5), None, "node-to-segment"),
        once(nts.Penalty(), None, "node-to-segment"),
        (nts.LagrangeMultiplier(), None, "mortar"),
        once(nts.Penalty(), None, "mortar"),
    ],
    ids=[
        *("exact stick", "tangential springs", "restitution", "penalty"),
        *("mortar, exact stick", "mortar, penalty"),
    ],
)
def test_ledger_of_friction_closes(enforcement, eps_T, method):
    scene = ball_on_plate("triangle")
    friction = nts.Coulomb(mu=0.3, eps_T=eps_T)
    pairs = scene.pairs(enforcement=enforcement, friction=friction, method=method)
    stepper = nts.EnergyMomentum(scene.bodies, pairs, dt=0.002)
    balances, reports = run(stepper)
    # Nodes on the axis do not stick tangentially, and are eliminated as all others.
    assert stepper.statistics.solver.num_direct == 0
    first, last, size = balances[0], balances[-1], 1e-10 * balances[0].total_energy
    given = sum(sum(report.contact_work) for report in reports)
    springs = sum(report.contact_work.springs for report in reports)
    change = last.total_energy - last.contact_energy - first.total_energy
    assert abs(change - given) < size
    assert abs(last.contact_energy + springs) < size
    assert all(report.contact_work.friction <= size for report in reports)
    assert sum(report.contact_work.friction for report in reports) < -1e-6 * first.total_energy
    assert abs(last.linear_momentum - first.linear_momentum)[0] < 1e-7


@pytest.mark.serial
@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
def test_ledger_of_friction_closes_where_impact_is_resolved(method):
    scene = ball_on_plate()
    law = nts.LagrangeMultiplier("resolved")
    pairs = scene.pairs(enforcement=law, friction=nts.Coulomb(mu=0.1), method=method)
    stepper = nts.EnergyMomentum(scene.bodies, pairs, dt=0.001)
    balances, reports = run(stepper, 60)
    first, last, size = balances[0], balances[-1], 1e-10 * balances[0].total_energy
    given = sum(sum(report.contact_work) for report in reports)
    assert abs(last.total_energy - first.total_energy - given) < size
    assert all(report.contact_work.friction <= size for report in reports)
    assert sum(report.contact_work.friction for report in reports) < -1e-5 * first.total_energy
    assert abs(last.linear_momentum - first.linear_momentum)[0] < 1e-7


@pytest.mark.serial
def test_bar_without_lateral_strain_strikes_as_one_in_the_plane():
    """Resolved impact of a column on a wall: both have 1-D waves and the mass of the section."""
    states, forces, masses = [], [], []
    for is_round in (False, True):
        domain = mesh.create_rectangle(
            MPI.COMM_WORLD, [(0.0, 0.01), (0.2, 1.01)], [2, 10], mesh.CellType.quadrilateral
        )
        if is_round:
            nts.axisymmetric(domain)
        V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
        tags = tagged(domain, lambda x: np.full(len(x), True))
        bar = nts.Body(V, tags, 2, nts.SaintVenantKirchhoff(1.0, 0.0, 1.0))
        end = nts.boundary_of(bar, where=lambda x: x[1] < 0.011)
        law = nts.LagrangeMultiplier("resolved")
        pair = nts.ContactPair(end, nts.RigidPlane((0, 0), (0, 1)), law, method="node-to-segment")
        stepper = nts.EnergyMomentum([bar], [pair], dt=0.02)
        stepper.set_velocity(bar, (0.0, -0.1))
        diagnostics, force = nts.Diagnostics(stepper), []
        first = diagnostics.balance()
        for _ in stepper.run(until=2.8):
            force.append(float(diagnostics.contact_force()[-1]))
        last = diagnostics.balance()
        assert abs(last.total_energy - first.total_energy) < 1e-11 * first.total_energy
        order = np.lexsort(V.tabulate_dof_coordinates()[:, :2].T)
        states.append([f.x.array.reshape(-1, 2)[order] for f in (stepper.u, stepper.v)])
        section = np.pi * 0.2**2 if is_round else 0.2
        assert first.linear_momentum[-1] == pytest.approx(-0.1 * section, rel=1e-12)
        forces.append(np.array(force) / section)
        masses.append(diagnostics.bodies()["2"].mass / section)
    assert masses == pytest.approx([1.0, 1.0], rel=1e-12)
    assert np.abs(forces[0]).max() > 0.05
    assert np.abs(forces[0] - forces[1]).max() < 1e-9
    for plane, rings in zip(*states, strict=True):
        assert np.abs(plane - rings).max() < 1e-9


@pytest.mark.parametrize("method", [once("node-to-segment"), "mortar"])
def test_a_ball_that_is_tied_pulls_the_plate(method):
    scene = ball_on_plate()
    pairs = scene.pairs(enforcement=nts.Tied(reach=0.3), method=method)
    stepper = nts.EnergyMomentum(scene.bodies, pairs, dt=0.002)
    stepper.set_velocity(scene.ball, (0.0, SPEED))
    diagnostics = nts.Diagnostics(stepper)
    first = diagnostics.balance()
    for report in stepper.run(until=0.02):
        assert report.num_active > 1
    last = diagnostics.balance()
    assert abs(last.total_energy - first.total_energy) < 1e-10 * first.total_energy
    assert abs(last.linear_momentum - first.linear_momentum)[0] < 1e-9 * 1e3
    assert diagnostics.body_velocity(scene.plate)[0] > 0.01


@pytest.mark.parametrize(
    ("kind", "degree"),
    [once("Midpoint", 1), once("GeneralizedAlpha", 1), ("CentralDifference", 1)],
)
def test_other_schemes_conserve_the_axial_momentum_and_close_their_ledgers(kind, degree):
    scene = ball_on_plate("quadrilateral", degree)
    is_explicit = kind == "CentralDifference"
    law = nts.Penalty() if is_explicit else nts.LagrangeMultiplier("plastic")
    options = {} if is_explicit else {"dt": 0.002}
    stepper = getattr(nts, kind)(scene.bodies, scene.pairs(enforcement=law), **options)
    stepper.set_velocity(scene.ball, (0.0, -1.0))
    diagnostics = nts.Diagnostics(stepper)
    first, gained, touched = diagnostics.balance(), 0.0, 0
    for report in stepper.run(until=0.05):
        gained += diagnostics.bulk_defect() + sum(report.contact_work) - report.contact_work.springs
        touched = max(touched, report.num_active)
    last = diagnostics.balance()
    assert touched
    assert abs(last.total_energy - first.total_energy - gained) < 1e-9 * first.total_energy
    assert abs(last.linear_momentum - first.linear_momentum)[0] < 1e-9 * 1e3


@pytest.mark.serial
def test_conserving_stress_is_exact_for_large_steps_of_any_law():
    """A law of a user without closed form: rings that swell and shrink by half in a step."""

    def psi(C, mu, kappa):
        J2 = ufl.det(C)
        shape = mu / 2 * (ufl.tr(C * C) - ufl.tr(C)) - mu / 2 * ufl.ln(J2)
        return shape + kappa / 8 * (J2 - 1) ** 2

    law = nts.Hyperelastic(psi, rho=1e3, mu=1e4, kappa=2e4, one_point=())
    data, V = round_block((3, 3), corner=(0.0, 0.0), skew=0.03)
    body = nts.Body(V, data.cells, data.tag["block"], law)
    stepper = nts.EnergyMomentum([body], dt=0.04)
    stepper.set_velocity(body, lambda x: np.array([4 * x[0] * x[1], 2 * x[1] ** 2]))
    diagnostics = nts.Diagnostics(stepper)
    first = diagnostics.balance()
    for _ in range(10):
        stepper.advance()
        last = diagnostics.balance()
        assert abs(last.total_energy - first.total_energy) < 1e-11 * first.total_energy
    assert last.strain_energy > 0.05 * first.total_energy


def test_impulses_of_loads_and_obstacles_balance_the_momentum():
    """Ring forces: traction, body force, weight and a plane that comes down."""
    data, V = round_block((3, 4), corner=(0.2, 0.0), size=(0.3, 1.0))
    body = nts.Body(V, data.cells, data.tag["block"], nts.NeoHookean(**RUBBER))
    surface = {
        side: nts.Surface(V, data.facets, data.tag[f"block_{side}"]) for side in ("top", "bottom")
    }
    ring = np.pi * (0.5**2 - 0.2**2)
    assert MPI.COMM_WORLD.allreduce(surface["top"].area.sum()) == pytest.approx(ring)
    loads = [
        nts.Traction(surface["bottom"], (0.0, 30.0)),
        nts.BodyForce(body, (500.0, -20.0)),
        nts.Gravity([body], (0.0, -2.0)),
    ]
    down = nts.Motion(lambda t: (0.0, -0.5 * t))
    lid = nts.RigidPlane((0, 1.002), (0, -1)).moving(down)
    pair = nts.ContactPair(
        surface["top"], lid, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    stepper = nts.EnergyMomentum([body], [pair], dt=0.004, loads=loads)
    diagnostics = nts.Diagnostics(stepper)
    first, impulse, given, on_lid = diagnostics.balance(), 0.0, 0.0, 0.0
    for step in stepper.run(until=0.08):
        (on,) = diagnostics.obstacles().values()
        assert on.force.shape == (1,) and on.torque.shape == (0,)
        impulse -= step.dt * on.force[0]
        on_lid += step.dt * on.force[0] * 0.5
        given += sum(step.load_works) + sum(step.contact_work)
    last = diagnostics.balance()
    dead = ring * (30.0 - 20.0 * 1.0 - 2.0 * 1e3) * 0.08
    assert last.linear_momentum[0] == pytest.approx(impulse + dead, rel=1e-9)
    assert on_lid > 1.0
    assert abs(last.total_energy - first.total_energy - given) < 1e-9 * on_lid


def test_a_column_of_liquid_pressure_does_the_work_of_its_volume():
    """Pressure all around a free ring: work p times the volume it loses, and no resultant."""
    data, V = round_block((3, 3), corner=(0.2, 0.0), size=(0.3, 1.0), skew=0.02)
    body = nts.Body(V, data.cells, data.tag["block"], nts.NeoHookean(**RUBBER))
    pressure = nts.Pressure(nts.boundary_of(body), 2e3)
    stepper = nts.EnergyMomentum([body], dt=0.02, loads=[pressure])
    r = ufl.SpatialCoordinate(data.mesh)[0]
    u = stepper.u
    F = ufl.Identity(2) + ufl.grad(u)
    J = ufl.det(F) * (1 + u[0] / r)
    form = fem.form((J - 1) * 2 * np.pi * r * ufl.dx)
    work = sum(float(stepper.advance().load_works[0]) for _ in range(5))
    lost = -MPI.COMM_WORLD.allreduce(fem.assemble_scalar(form))
    assert lost > 1e-3
    assert work == pytest.approx(2e3 * lost, rel=1e-6)
    assert abs(nts.Diagnostics(stepper).linear_momentum()[0]) < 1e-9


def test_a_ball_rests_on_a_plate_by_contact_alone():
    scene = ball_on_plate()
    weight = nts.Gravity(scene.bodies, (0.0, -0.5))
    below = fem.locate_dofs_geometrical(scene.V, lambda x: x[1] < -0.299)
    clamp = fem.dirichletbc(np.zeros(2), below, scene.V)
    pairs = scene.pairs(friction=nts.Coulomb(0.3))
    stepper = nts.QuasiStatic(scene.bodies, pairs, dt=1.0, bcs=[clamp], loads=[weight])
    stepper.set_displacement(scene.ball, (0.0, -GAP - 1e-3))
    (reaction,) = stepper.advance().reactions
    bodies = nts.Diagnostics(stepper).bodies()
    (pair,) = nts.Diagnostics(stepper).pairs().values()
    assert pair.force[0] == pytest.approx(0.5 * bodies["ball"].mass, rel=1e-6)
    assert reaction.force[0] == pytest.approx(
        0.5 * sum(body.mass for body in bodies.values()), rel=1e-6
    )
    assert len(reaction.force) == 1 and reaction.moment == ()
    x = stepper.x[: len(stepper.node_ids)]
    on_axis = stepper.u.function_space.tabulate_dof_coordinates()[: len(x), 0] < 1e-9
    assert np.all(x[on_axis, 0] < 1e-9)


def test_the_poles_of_a_shell_that_meet_on_the_axis_bounce():
    body = shell()
    pairs = nts.all_pairs(
        [body],
        self_contact=[body],
        friction=nts.Coulomb(0.3),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    stepper = nts.EnergyMomentum([body], pairs, dt=0.0025)
    stepper.set_velocity(
        body, lambda x: np.array([0 * x[0], -22 * x[1] * np.exp(-((x[0] / 0.25) ** 2))])
    )
    diagnostics = nts.Diagnostics(stepper)
    first, given, most = diagnostics.balance(), 0.0, 0
    for step in stepper.run(until=0.12):
        given += sum(step.contact_work)
        most = max(most, step.num_active)
    last = diagnostics.balance()
    assert most and diagnostics.min_gap() > -0.01
    assert abs(last.total_energy - first.total_energy - given) < 1e-10 * first.total_energy
    assert abs(last.linear_momentum - first.linear_momentum)[0] < 1e-9


@pytest.mark.serial
@pytest.mark.parametrize(("cell", "degree"), [("quadrilateral", 1), ("triangle", 2)])
def test_the_stable_step_is_estimated_on_the_safe_side(cell, degree):
    """Against the highest frequency of the whole body, by its stiffness and lumped mass."""
    data, V = round_block((4, 4), cell, degree, skew=0.05)
    body = nts.Body(V, data.cells, data.tag["block"], nts.NeoHookean(**RUBBER))
    explicit, static = nts.CentralDifference([body]), nts.QuasiStatic([body], dt=1.0)
    mass, bulk = np.repeat(explicit.mass, 2), static._bulk
    bulk.stabilisation = None
    K = np.array([bulk.action(unit.reshape(-1, 2)).ravel() for unit in np.eye(len(mass))])
    free = np.setdiff1d(np.arange(len(mass)), static.supports.fixed)
    scale = 1 / np.sqrt(mass[free])
    values = np.linalg.eigvalsh(K[np.ix_(free, free)] * scale * scale[:, None])
    # The only rigid motion is the translation along the axis.
    assert np.count_nonzero(np.abs(values) < 1e-9 * values[-1]) == 1
    assert 0.6 < explicit.stable_step / (2 / np.sqrt(values[-1])) <= 1


@pytest.mark.parametrize("impact", ["elastic", once("resolved")])
def test_files_and_checkpoints_of_axisymmetric_bodies(tmp_path, monkeypatch, impact):
    monkeypatch.chdir(tmp_path if MPI.COMM_WORLD.size == 1 else MPI.COMM_WORLD.bcast(str(tmp_path)))

    def stepper():
        scene = ball_on_plate(size=0.15)
        pairs = scene.pairs(enforcement=nts.LagrangeMultiplier(impact))
        made = nts.EnergyMomentum(scene.bodies, pairs, dt=0.002)
        made.set_velocity(scene.ball, (0.0, -SPEED))
        return made

    whole = stepper()
    for _ in whole.run(until=0.024):
        pass
    with nts.Recorder("rings", first := stepper(), checkpoint_every=4, stress=True) as record:
        for step in first.run(until=0.012):
            record.write(step)
    second = stepper()
    with nts.Recorder("rings", second, checkpoint_every=4, stress=True, resume=True) as record:
        for step in second.run(until=0.024):
            record.write(step)
    assert second.step == whole.step
    assert np.array_equal(second.u.x.array, whole.u.x.array)
    MPI.COMM_WORLD.Barrier()
    names = Path("rings.csv").read_text().splitlines()[0].split(",")
    assert "linear_momentum_y" in names and "contact_force_y" in names
    assert not [name for name in names if name.endswith(("_x", "_z")) or "angular" in name]
    table = np.genfromtxt("rings.csv", delimiter=",", names=True)
    assert np.abs(table["energy_unaccounted"]).max() < 1e-10 * table["total_energy"][0]
    assert "angular" not in record.summary()


# --- refused arguments ---------------------------------------------------


def square(dim=2, low=0.0):
    """Mesh of a square, or of a cube."""
    if dim == 3:
        return mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2)
    return mesh.create_rectangle(MPI.COMM_WORLD, [(low, 0.0), (1.0, 1.0)], [3, 3])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: square(3), "a mesh of the plane"),
        (lambda: square(low=-0.5), "radii x >= 0"),
    ],
    ids=["cube", "both sides of the axis"],
)
def test_meshes_on_both_sides_of_the_axis_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        nts.axisymmetric(make())


@pytest.mark.serial
def test_axisymmetric_is_declared_before_other_objects():
    domain = square()
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    nts.Surface.where(V, lambda x: np.isclose(x[1], 1.0))
    with pytest.raises(ValueError, match="before bodies, surfaces"):
        nts.axisymmetric(domain)


@pytest.mark.serial
def test_axis_without_nodes_gives_no_warning(caplog):
    domain = square(low=0.5)
    nts.axisymmetric(domain)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    numbers = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
    cells = mesh.meshtags(domain, 2, numbers, np.ones_like(numbers))
    nts.QuasiStatic([nts.Body(V, cells, 1, nts.NeoHookean(**RUBBER))], dt=1.0)
    assert not caplog.records


def test_facets_on_the_axis_are_no_surface():
    domain = square()
    nts.axisymmetric(domain)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    with pytest.raises(ValueError, match="on the axis only"):
        nts.Surface.where(V, lambda x: np.isclose(x[0], 0.0))
    around = nts.Surface.where(V, lambda x: np.full(x.shape[1], True))
    area = MPI.COMM_WORLD.allreduce(around.area.sum())
    assert area == pytest.approx(2 * np.pi + 2 * np.pi)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("obstacle", "message"),
    [
        (nts.RigidPlane((0, 2), (0.1, -1)), "a RigidPlane normal to the axis"),
        (nts.RigidSphere((0.3, 2), 0.5), "its centre on it"),
        (nts.RigidPlane((0, 0, 2), (0, 0, -1)), "points of 2 coordinates"),
    ],
    ids=["oblique plane", "sphere off the axis", "plane in space"],
)
def test_obstacles_that_are_not_of_revolution_are_refused(obstacle, message):
    data, V = round_block()
    top = nts.Surface(V, data.facets, data.tag["block_top"])
    with pytest.raises(ValueError, match=message):
        nts.ContactPair(
            top, obstacle, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        )


def test_user_defined_sphere_acts_as_rigid_sphere():
    class Ball(nts.ExactObstacle):
        dim, is_of_revolution, shortest_passage = 2, True, 0.2

        def distance(self, x):
            away = x - [0.0, 1.41, 0.0]
            r = np.linalg.norm(away, axis=1)
            return r - 0.4, away / r[:, None]

    ends = []
    for obstacle in (Ball(), nts.RigidSphere((0.0, 1.41), 0.4)):
        data, V = round_block()
        block = nts.Body(V, data.cells, data.tag["block"], nts.NeoHookean(**RUBBER))
        top = nts.Surface(V, data.facets, data.tag["block_top"])
        stepper = nts.EnergyMomentum([block], [nts.ContactPair(top, obstacle)], dt=0.002)
        stepper.set_velocity(block, (0.0, SPEED))
        assert max(step.num_active for step in stepper.run(until=0.04)) > 1
        ends.append(stepper.x)
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-7)


def test_unsupported_axisymmetric_features_are_refused():
    scene = ball_on_plate(size=0.15)
    stepper = nts.EnergyMomentum(scene.bodies, dt=0.01)
    with pytest.raises(ValueError, match="no radial velocity on the axis"):
        stepper.set_velocity(scene.ball, (0.1, 0.0))
    assert not stepper.v.x.array.any()
    with pytest.raises(ValueError, match="along the axis"):
        nts.Gravity(scene.bodies, (9.81, 0.0))
    every = fem.locate_dofs_geometrical(scene.V, lambda x: x[1] < -0.299)
    wrong = fem.dirichletbc(np.array([0.1, 0.0]), every, scene.V)
    with pytest.raises(ValueError, match="0 m by the axis in direction x"):
        nts.EnergyMomentum(scene.bodies, dt=0.01, bcs=[wrong])
    aside = nts.RigidPlane((0, 3), (0, -1)).moving(nts.Motion(lambda t: (0.1 * t, 0.0)))
    stepper = nts.EnergyMomentum(
        scene.bodies,
        [
            nts.ContactPair(
                nts.boundary_of(scene.ball),
                aside,
                enforcement=nts.LagrangeMultiplier(),
                method="node-to-segment",
            )
        ],
        dt=0.01,
    )
    with pytest.raises(ValueError, match="a motion along the axis"):
        stepper.advance()


@pytest.mark.serial
def test_cones_need_an_axis():
    domain = square()
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    top = nts.Surface.where(V, lambda x: np.isclose(x[1], 1.0))
    with pytest.raises(ValueError, match="axisymmetric mesh with a RigidCone"):
        nts.ContactPair(
            top,
            nts.RigidCone((0, 1), 1.2),
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
    for arguments, message in (
        (((0.1, 0), 1.2), "on the axis"),
        (((0, 0), 1.6), "half_angle < pi/2"),
    ):
        with pytest.raises(ValueError, match=message):
            nts.RigidCone(*arguments)
