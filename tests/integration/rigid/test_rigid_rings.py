"""Rigid bodies of revolution: one motion, along the axis, in all schemes and with all contact."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem, mesh

import dolfinx_nts as nts
from helpers.models.rigid_rings import DOME_MASS, STIFFNESS, dome_on_block, spring_of
from helpers.models.rings import RUBBER
from helpers.models.round import tagged
from helpers.once import once, once_except

pytestmark = pytest.mark.at_most_two_ranks

SPEED, STICK = 2.0, nts.Coulomb(mu=0.3)  # m/s, -
DOWN = (0.0, -SPEED)


def axial(function, body):
    """Values along the axis at the nodes of a body, and the greatest across it."""
    values = function.x.array.reshape(-1, 2)[body.nodes]
    return values[:, 1], np.abs(values[:, 0]).max(initial=0.0)


def run(stepper, until):
    """Balances, most active nodes; energies by the scheme, unexplained, and of friction."""
    diagnostics = nts.Diagnostics(stepper)
    first, given, active, of_scheme, taken = diagnostics.balance(), 0.0, 0, 0.0, 0.0
    for report in stepper.run(until=until):
        of_scheme += diagnostics.bulk_defect()
        given += sum(report.contact_work) - report.contact_work.springs
        given += report.load_work + report.support_work + report.solver_work
        taken -= report.contact_work.friction
        active = max(active, report.num_active)
    last = diagnostics.balance()
    rest = last.total_energy - first.total_energy - given - of_scheme
    return first, last, active, of_scheme, rest, taken


ELASTIC, PLASTIC = nts.LagrangeMultiplier(), nts.LagrangeMultiplier("plastic")
IMPACTS = {
    "elastic": ({}, {}),
    "friction": ({}, {"friction": STICK}),
    "mortar": ({}, {"method": "mortar"}),
    "mortar, friction": ({}, {"method": "mortar", "friction": STICK}),
    "plastic": ({}, {"enforcement": PLASTIC, "friction": STICK}),
    "restitution": ({}, {"enforcement": nts.LagrangeMultiplier("restitution", 0.5)}),
    "springs": ({}, {"enforcement": nts.Penalty(), "friction": STICK}),
    "degree 2": ({"cell": "triangle", "degree": 2}, {"friction": STICK}),
    "with a hole": ({"inner": 0.2}, {"friction": STICK}),
    "nodes are rigid": ({}, {"rigid_nodes": True, "friction": STICK}),
    "mortar, nodes are rigid": ({}, {"rigid_nodes": True, "method": "mortar"}),
    "both rigid": ({"both_rigid": True}, {}),
    "both rigid, springs": ({"both_rigid": True}, {"enforcement": nts.Penalty()}),
}


@pytest.mark.parametrize("case", once_except(list(IMPACTS), "friction", "mortar, friction"))
def test_impact_keeps_energy_and_axial_momentum(comm, agree, case):
    shape, laws = IMPACTS[case]
    scene = dome_on_block(comm, **shape)
    stepper = nts.EnergyMomentum(scene.bodies, [scene.pair(**laws)], dt=0.002)
    stepper.set_velocity(scene.dome, DOWN)
    first, last, active, of_scheme, rest, taken = run(stepper, 0.06)
    assert active > 0
    size = first.total_energy
    assert first.linear_momentum[0] == pytest.approx(-2 * size / SPEED, rel=1e-12)
    assert abs(rest) < 1e-10 * size and abs(of_scheme) < 1e-10 * size
    assert taken > -1e-12 * size
    if "friction" not in laws and "enforcement" not in laws:
        assert abs(last.total_energy - size) < 1e-10 * size
    change = abs(last.linear_momentum - first.linear_momentum)[0]
    assert change < 1e-10 * abs(first.linear_momentum[0])
    travels, across = axial(stepper.u, scene.dome)
    assert agree(across == 0.0 and (not len(travels) or np.ptp(travels) < 1e-13))
    if not shape.get("inner"):
        # The mass of the closed form, and the common velocity of all nodes.
        speeds, across = axial(stepper.v, scene.dome)
        fastest = comm.allreduce(speeds.max(initial=-np.inf), op=MPI.MAX)
        slowest = comm.allreduce(speeds.min(initial=np.inf), op=MPI.MIN)
        assert agree(across < 1e-12) and fastest - slowest < 1e-11
        dome = nts.Diagnostics(stepper).bodies()["2"]
        assert dome.mass == pytest.approx(DOME_MASS, rel=1e-12)
        assert dome.linear_momentum[0] == pytest.approx(DOME_MASS * fastest, rel=1e-9)


SCHEMES = {
    "midpoint": (nts.Midpoint, {}, ELASTIC, 0.002),
    "alpha": (nts.GeneralizedAlpha, {}, PLASTIC, 0.002),
    "alpha, mortar": (nts.GeneralizedAlpha, {"method": "mortar"}, PLASTIC, 0.002),
    "alpha, nodes are rigid": (
        nts.GeneralizedAlpha,
        {"rigid_nodes": True},
        nts.Penalty(),
        0.002,
    ),
    "explicit": (nts.CentralDifference, {}, nts.Penalty(), None),
    "explicit, nodes are rigid": (
        nts.CentralDifference,
        {"rigid_nodes": True},
        nts.Penalty(),
        None,
    ),
}


@pytest.mark.parametrize("friction", [once(None, id="frictionless"), STICK])
@pytest.mark.parametrize("case", once_except(list(SCHEMES), "alpha", "explicit"))
def test_other_schemes_keep_axial_momentum_and_have_a_ledger(comm, case, friction):
    make, laws, law, dt = SCHEMES[case]
    scene = dome_on_block(comm)
    pair = scene.pair(enforcement=law, friction=friction, **laws)
    stepper = make(scene.bodies, [pair], dt=dt)
    stepper.set_velocity(scene.dome, DOWN)
    first, last, active, of_scheme, rest, _ = run(stepper, 0.06)
    assert active > 0
    size = first.total_energy
    assert abs(rest) < 1e-10 * size
    assert abs(of_scheme) < 0.3 * size
    change = abs(last.linear_momentum - first.linear_momentum)[0]
    assert change < 1e-10 * abs(first.linear_momentum[0])
    if case.startswith("explicit"):
        assert abs(of_scheme) < 0.01 * size


@pytest.mark.parametrize(
    "make", [nts.EnergyMomentum, once(nts.GeneralizedAlpha), once(nts.CentralDifference)]
)
def test_free_fall_and_dead_force_agree_with_newton(comm, make):
    """A dome alone: acceleration by its weight and by a force on the mass of the closed form."""
    scene = dome_on_block(comm, both_rigid=True)
    force = nts.Force(scene.dome, (0.0, 500.0))
    weight = nts.Gravity(scene.bodies, (0.0, -3.0))
    stepper = make(scene.bodies, dt=0.01, loads=[force, weight])
    for _ in stepper.run(until=0.1):
        pass
    balances = nts.Diagnostics(stepper).bodies()
    assert balances["2"].velocity[0] == pytest.approx((500 / DOME_MASS - 3.0) * 0.1, rel=1e-9)
    assert balances["1"].velocity[0] == pytest.approx(-0.3, rel=1e-9)
    travels, across = axial(stepper.u, scene.dome)
    assert across == 0.0
    assert np.allclose(travels, (500 / DOME_MASS - 3.0) * 0.1**2 / 2, rtol=1e-9)


@pytest.mark.parametrize("friction", [once(None), STICK])
def test_dome_bounces_on_obstacles_with_exact_energy(comm, friction):
    """All nodes of its rim land together on a plane; a cone and a sphere meet one ring."""
    for obstacle in (
        nts.RigidPlane((0.0, 0.01), (0.0, 1.0)),
        nts.RigidSphere((0.0, -3.0), 3.01),
        nts.RigidCone((0.0, 0.03), np.radians(80), opens=-1),
    ):
        scene = dome_on_block(comm, both_rigid=True, inner=0.2)
        pair = nts.ContactPair(
            scene.surfaces[1],
            obstacle,
            friction=friction,
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
        weight = nts.Gravity([scene.dome], (0.0, -5.0))
        stepper = nts.EnergyMomentum(scene.bodies, [pair], dt=0.005, loads=[weight])
        stepper.set_velocity(scene.dome, (0.0, -0.5))
        first, last, active, of_scheme, rest, taken = run(stepper, 0.1)
        assert active > 0
        assert abs(rest) + abs(of_scheme) + abs(taken) < 1e-11 * first.kinetic_energy
        assert last.linear_momentum[0] > 0


@pytest.mark.parametrize("method", [once("node-to-segment"), "mortar"])
def test_tied_dome_goes_with_the_block(comm, method):
    """The node on the axis has no tied component across it; its forces used to be NaN."""
    scene = dome_on_block(comm)
    tie = scene.pair(enforcement=nts.Tied(reach=0.5), method=method)
    stepper = nts.EnergyMomentum(scene.bodies, [tie], dt=0.002)
    for body in scene.bodies:
        stepper.set_velocity(body, DOWN if body is scene.dome else (0.0, SPEED))
    first, last, _, _, rest, _ = run(stepper, 0.02)
    assert abs(rest) < 1e-10 * first.total_energy
    assert abs(last.linear_momentum - first.linear_momentum)[0] < 1e-9 * DOME_MASS
    assert last.strain_energy > 0.01 * first.total_energy


def driven(comm, make, guide, *, force=None, loads=(), dt=0.1, **laws):
    """A dome with prescribed motion or force on a block on a clamped foot."""
    scene = dome_on_block(comm, guide)
    loads = [make_load(scene) for make_load in loads]
    if force is not None:
        loads.append(nts.Force(scene.dome, force))
    pair = scene.pair(**laws)
    return make(scene.bodies, [pair], dt=dt, bcs=[scene.clamp], loads=loads), scene


def down(t):
    return 0.0, -0.3 * t


STATICS = {
    "frictionless": {},
    "friction": {"friction": STICK},
    "mortar": {"method": "mortar"},
    "mortar, friction": {"method": "mortar", "friction": STICK},
    "nodes are rigid": {"rigid_nodes": True},
    "springs": {"enforcement": nts.Penalty(1e5), "friction": STICK},
}


@pytest.mark.parametrize("case", once_except(list(STATICS), "friction"))
def test_force_control_is_displacement_control_in_statics(comm, agree, case):
    stepper, _ = driven(comm, nts.QuasiStatic, nts.Guide(motion=nts.Motion(down)), **STATICS[case])
    forces, states = [0.0], []
    for _ in range(3):
        foot, tool = stepper.advance().reactions
        assert len(foot.force) == len(tool.force) == 1 and tool.moment == ()
        assert abs(foot.force[0] + tool.force[0]) < 1e-8 * foot.force[0]
        forces.append(tool.force[0])
        states.append(stepper.x)
    assert forces[3] < forces[2] < forces[1] < -10.0

    def force(t):
        return 0.0, np.interp(t, np.arange(4) * 0.1, forces)

    for guide in (nts.Guide(slides="y"), None):
        stepper, _ = driven(comm, nts.QuasiStatic, guide, force=force, **STATICS[case])
        for state in states:
            foot, *of_guide = stepper.advance().reactions
            assert agree(np.abs(stepper.x - state).max(initial=0.0) < 1e-10)
            assert len(of_guide) == (guide is not None)
            assert all(abs(each.force[0]) < 1e-7 * abs(forces[1]) for each in of_guide)


@pytest.mark.parametrize("make", [once(nts.QuasiStatic), nts.EnergyMomentum])
def test_spring_between_dome_and_base_is_in_balance(comm, make):
    dt = 0.1 if make is nts.QuasiStatic else 0.01
    stepper, scene = driven(comm, make, None, loads=[spring_of], dt=dt, friction=STICK)
    diagnostics = nts.Diagnostics(stepper)
    for _ in range(5):
        before, u_n = diagnostics.linear_momentum(), axial(stepper.u, scene.dome)[0]
        report = stepper.advance()
        (foot,) = report.reactions
        u = axial(stepper.u, scene.dome)[0]
        drop = comm.allreduce((u_n + u if dt < 0.1 else 2 * u).min(initial=np.inf), op=MPI.MIN) / 2
        t = stepper.t - (stepper.dt / 2 if dt < 0.1 else 0.0)
        pull = -STIFFNESS * (drop + 0.1 * t)
        gained = diagnostics.linear_momentum() - before if dt < 0.1 else np.zeros(1)
        assert gained[0] / stepper.dt == pytest.approx(pull + foot.force[0], rel=1e-7, abs=1e-6)
    assert drop < -1e-5


def test_guided_dome_does_the_work_of_its_guide(comm):
    for make, dt, law in (
        (nts.EnergyMomentum, 0.01, ELASTIC),
        (nts.GeneralizedAlpha, 0.01, PLASTIC),
        (nts.Midpoint, 0.01, ELASTIC),
        (nts.CentralDifference, 2e-4, nts.Penalty()),
    ):
        guide = nts.Guide(motion=nts.Motion(down))
        stepper, scene = driven(comm, make, guide, dt=dt, friction=STICK, enforcement=law)
        stepper.set_velocity(scene.dome, (0.0, -0.3))
        _, last, active, _, rest, _ = run(stepper, 0.15)
        assert active > 0 and last.strain_energy > 1.0
        assert abs(rest) < 1e-10 * last.total_energy
        travels, across = axial(stepper.u, scene.dome)
        assert across == 0.0 and np.allclose(travels, -0.3 * 0.15, rtol=1e-12)


@pytest.mark.parametrize("make", [nts.EnergyMomentum, nts.CentralDifference])
def test_column_with_a_rigid_half_shares_its_nodes(comm, agree, make):
    domain = mesh.create_rectangle(comm, [(0.0, 0.0), (0.5, 1.0)], [3, 6])
    nts.axisymmetric(domain)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    tags = tagged(domain, lambda x: x[:, 1] > 0.5)
    soft, half = nts.Body(V, tags, 1, nts.NeoHookean(**RUBBER)), nts.RigidBody(V, tags, 2, 500.0)
    stepper = make([soft, half], dt=1e-3)
    stepper.set_velocity(soft, lambda x: np.array([0.0 * x[0], -1.0 + 2 * x[1]]))
    first, last, _, _, rest, _ = run(stepper, 0.04)
    assert abs(rest) < 1e-10 * first.total_energy
    assert abs(last.linear_momentum - first.linear_momentum)[0] < 1e-9
    assert last.strain_energy > 0.01 * first.total_energy
    travels, across = axial(stepper.u, half)
    assert agree(across == 0.0 and (not len(travels) or np.ptp(travels) < 1e-13))


RESUMED = {
    "conserving": (nts.EnergyMomentum, ELASTIC, 0.002),
    "explicit": (nts.CentralDifference, nts.Penalty(), 5e-4),
}


@pytest.mark.parametrize("case", RESUMED)
def test_motion_is_the_same_on_any_number_of_ranks_and_resumed(comm, agree, tmp_path, case):
    folder, (make, law, dt) = comm.bcast(tmp_path), RESUMED[case]

    def scene(on):
        made, parts = driven(
            on, make, nts.Guide(slides="y"), force=(0, -900), dt=dt, friction=STICK, enforcement=law
        )
        made.set_velocity(parts.dome, DOWN)
        return made, parts.dome

    alone, whole = scene(MPI.COMM_SELF), scene(comm)
    num_steps = round(0.04 / dt)
    for stepper, _ in (alone, whole):
        for _ in stepper.run(until=num_steps * dt):
            pass
    for steps in (num_steps - 6, num_steps):  # during contact
        here, dome = scene(comm)
        with nts.Recorder(folder / "run", here, checkpoint_every=2, resume=True) as files:
            for step in here.run(until=steps * dt):
                files.write(step)
    assert agree(step.num_active > 0)
    assert agree(np.array_equal(here.u.x.array, whole[0].u.x.array))
    assert agree(np.array_equal(here.v.x.array, whole[0].v.x.array))
    (travel, *_), there = axial(alone[0].u, alone[1])[0], axial(here.u, dome)[0]
    assert travel < -0.02
    assert agree(np.abs(there - travel).max(initial=0.0) < 1e-10)
    if comm.rank == 0:
        header, *_, last = (folder / "run.csv").read_text().splitlines()
        row = dict(zip(header.split(","), map(float, last.split(",")), strict=True))
        assert abs(row["guide_2_work"]) < 1e-9 and "guide_2_force_y" in row
        assert not [name for name in row if name.startswith("guide") and "moment" in name]


# --- refused arguments ---------------------------------------------------


def test_guides_that_turn_or_leave_the_axis_are_refused(comm, refused):
    turn = nts.Motion(rotation=lambda t: t)
    for guide in (
        nts.Guide(slides="x"),
        nts.Guide(slides="xy"),
        nts.Guide(turns="z"),
        nts.Guide(motion=turn),
    ):
        with refused(ValueError, "slides along the axis y, and no turns, in an axisymmetric mesh"):
            dome_on_block(comm, guide)
    aside = nts.Guide(motion=nts.Motion(lambda t: (0.1 * t, 0.0)))
    for make in (nts.EnergyMomentum, nts.CentralDifference):
        scene = dome_on_block(comm, aside)
        stepper = make(scene.bodies, dt=1e-3)
        with refused(ValueError, "a motion along the axis y of a guide in an axisymmetric mesh"):
            stepper.advance()


@pytest.mark.parametrize("make", [nts.EnergyMomentum, once(nts.CentralDifference)])
def test_states_off_the_axis_are_refused(comm, refused, make):
    for name, value in (
        ("velocity", (0.1, 0.0)),
        ("displacement", (0.1, 0.0)),
        ("velocity", lambda x: np.array([-x[1], x[0]])),
        ("velocity", lambda x: np.array([0 * x[0], x[0]])),
        ("displacement", lambda x: np.array([0.01 * (x[0] - 0.3), 0 * x[0]])),
    ):
        scene = dome_on_block(comm, inner=0.2)
        stepper = make(scene.bodies, dt=1e-3)
        getattr(stepper, f"set_{name}")(scene.dome, value)
        with refused(ValueError, f"a {name} of the rigid body 2 that moves it along the axis y"):
            stepper.advance()


def test_loads_that_turn_or_leave_the_axis_are_refused(comm, refused):
    dome = dome_on_block(comm).dome
    with refused(ValueError, "a Force along the axis y of an axisymmetric mesh, given"):
        nts.Force(dome, (1.0, 0.0))
    with refused(ValueError, "no Moment in an axisymmetric mesh, given one on body 2"):
        nts.Moment(dome, 1.0)


def test_dirichlet_conditions_on_a_rigid_dome_are_refused(comm, refused):
    scene = dome_on_block(comm)
    held = fem.dirichletbc(np.zeros(2), scene.dome.nodes, scene.V)
    with refused(
        ValueError, r"bcs at nodes of deformable bodies, given \d+ nodes of the rigid body 2"
    ):
        nts.EnergyMomentum(scene.bodies, dt=0.01, bcs=[held])


def test_a_force_that_nothing_resists_has_no_equilibrium(comm, refused):
    stepper, _ = driven(comm, nts.QuasiStatic, None, force=(0.0, 5.0))
    with refused(
        nts.ConvergenceError, r"no support or contact holds body 2 \(free: translation in y\)"
    ):
        stepper.advance()
