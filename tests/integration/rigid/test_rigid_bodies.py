"""Free rigid bodies: exact balances, alone and in contact, and refused arguments."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.integrators.rigid import redundant
from helpers.models.box_meshes import boxes, distribute
from helpers.models.plane import blocks, throw
from helpers.models.rigid import NUMBERS, bonded, brick, eulers, impact, pressed, spin
from helpers.once import once
from helpers.scene import Motion
from reference.bulk import rotation

RHO = 2.0
RUBBER = (1e5, 0.3, 10.0)  # Young's modulus [Pa], Poisson's ratio, density [kg/m^3]
STICK = nts.Coulomb(mu=0.3)


@pytest.mark.serial
def test_free_rotation_agrees_with_eulers_equations_to_second_order():
    omega = np.array([3.0, 0.4, -0.3])
    exact = eulers(omega, 1.0)
    errors = []
    for dt in (0.05, 0.025):
        stepper, turn = brick(dt, omega)
        for _ in stepper.run(until=1.0):
            pass
        errors.append(np.abs(turn() - exact).max())
    assert 3.7 < errors[0] / errors[1] < 4.3
    assert errors[1] < 0.01


@pytest.mark.serial
def test_tumbling_about_the_intermediate_axis_keeps_energy_and_angular_momentum():
    # 1.5 rad a step would be coarse for accuracy, 0.15 makes the body turn over several times.
    stepper, turn = brick(0.03, np.array([5.0, 0.01, 0.02]))
    diagnostics = nts.Diagnostics(stepper)
    first, axis = diagnostics.balance(), []
    for _ in range(300):
        stepper.advance()
        axis.append(turn()[0, 0])
    last = diagnostics.balance()
    assert min(axis) < -0.9 and max(axis) > 0.9
    assert abs(last.total_energy - first.total_energy) < 1e-12 * first.total_energy
    drift = last.angular_momentum - first.angular_momentum
    assert np.abs(drift).max() < 1e-12 * np.abs(first.angular_momentum).max()
    assert np.abs(turn().T @ turn() - np.eye(3)).max() < 1e-12


@pytest.mark.serial
@pytest.mark.parametrize("v", [1e-10, 1e-14, 0.0])
def test_a_body_far_from_its_start_may_be_almost_at_rest(v):
    # Forces are at most the round-off of the displacement times its inertia.
    stepper, _ = brick(0.01, np.zeros(3))
    body = stepper.bodies[0]
    stepper.set_displacement(body, (1.0, -2.0, 3.0))
    stepper.set_velocity(body, (v, 2 * v, 0.0))
    for _ in range(3):
        stepper.advance()
    nodes = body.nodes
    velocity = stepper.v.x.array.reshape(-1, 3)[nodes]
    assert np.abs(velocity - [v, 2 * v, 0.0]).max() < 1e-12
    assert np.abs(stepper.u.x.array.reshape(-1, 3)[nodes] - [1.0, -2.0, 3.0]).max() < 1e-11


def run(scene, num_steps=25):
    """Balances at start and end, work of contact, and most active nodes."""
    diagnostics = nts.Diagnostics(scene.stepper)
    first, given, active = diagnostics.balance(), 0.0, 0
    for _ in range(num_steps):
        report = scene.stepper.advance()
        given += sum(report.contact_work)
        active = max(active, report.num_active)
    return first, diagnostics.balance(), given, active


def check_balances(first, last, given, tol=1e-11):
    """Energy without the contribution of contact, and both momenta, are conserved."""
    energy = last.total_energy - last.contact_energy
    assert abs(energy - first.total_energy - given) < tol * first.total_energy
    for name in ("linear_momentum", "angular_momentum"):
        before, after = getattr(first, name), getattr(last, name)
        assert np.linalg.norm(after - before) < tol * np.linalg.norm(before)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("friction", [once(None, id="frictionless"), STICK])
def test_impact_on_a_free_block_keeps_energy_and_momenta_in_any_position(comm, friction):
    motion = Motion.random(np.random.default_rng(5))
    scene = impact(comm, motion=motion, friction=friction)
    first, last, given, active = run(scene)
    assert active > 5
    check_balances(first, last, given)
    if friction is None:
        assert abs(given) < 1e-11 * first.total_energy
    else:
        assert given < -0.05 * first.total_energy
    # The other body has deformed, this one has not.
    assert last.strain_energy > 1e-3 * first.total_energy
    local = scene.bodies["rigid"].nodes[:5]
    X, x = (
        y[local]
        for y in (scene.stepper.u.function_space.tabulate_dof_coordinates(), scene.stepper.x)
    )
    for y, z in ((X[i] - X, x[i] - x) for i in range(len(local))):
        assert np.abs(np.linalg.norm(y, axis=1) - np.linalg.norm(z, axis=1)).max() < 1e-12


CASES = {
    "mortar": {"method": "mortar", "friction": STICK},
    "plastic": {"enforcement": nts.LagrangeMultiplier("plastic")},
    "springs": {"enforcement": nts.Penalty(), "rho": 2.0, "friction": STICK},
    "light": {"rho": 0.2},
}


@pytest.mark.serial
@pytest.mark.parametrize("case", CASES)
def test_ledger_closes_with_every_law_of_contact(comm, case):
    first, last, given, active = run(impact(comm, **CASES[case]))
    assert active > 0
    check_balances(first, last, given)


def falling(
    comm, tilt, friction, enforcement=None, dt=0.01, scheme=nts.EnergyMomentum, target=None
):
    """A rigid cube that slides while it falls on a floor."""
    data = boxes([(2, 2, 2)], [(1.0, 1.0, 1.0)])
    data.X[:] = (data.X - 0.5) @ rotation([1, 0.7, 0.2], tilt).T + [0, 0, 0.75]
    mesh, cells, _, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    cube = nts.RigidBody(V, cells, tag["body 0"], RHO)
    floor = target or nts.RigidPlane((0, 0, 0), (0, 0, 1))
    pair = nts.ContactPair(
        nts.boundary_of(cube), floor, enforcement, friction, method="node-to-segment"
    )
    gravity = nts.Gravity([cube], (0, 0, -9.81))
    stepper = scheme([cube], [pair], dt=dt, loads=[gravity])
    stepper.set_velocity(cube, (0.5, 0.0, -1.0))
    return stepper


FALLS = {"edge": (0.3, None), "face": (0.0, STICK), "corner": (0.05, nts.Coulomb(mu=0.8))}


@pytest.mark.serial
@pytest.mark.parametrize("dt", [0.004, 0.0037])
def test_a_rigid_block_that_friction_has_stopped_is_at_rest_by_default(comm, dt):
    def build(model):
        nts.parts.add_rectangle(model, "block", corner=(0, 0), size=(0.2, 0.1), cells=(4, 2))

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    block = nts.RigidBody(V, cells, tag["block"], RHO, guide=nts.Guide(slides="xy"))
    floor = nts.RigidPlane((0, 0), (0, 1))
    pair = nts.ContactPair(nts.boundary_of(block), floor, friction=0.4)
    gravity = nts.Gravity([block], (0, -9.81))
    stepper = nts.EnergyMomentum([block], [pair], dt=dt, loads=[gravity])
    stepper.set_velocity(block, (1.0, 0.0))
    diagnostics, v, friction = nts.Diagnostics(stepper), [], []
    start = diagnostics.centre_of_mass(block)[0]
    for step in stepper.run(until=0.5):
        if step.t > 0.45:
            v.append(diagnostics.body_velocity(block)[0])
            (force,) = diagnostics.pairs().values()
            friction.append(force.force[0])
    mass = RHO * 0.2 * 0.1
    assert np.abs(v).max() < 1e-4
    assert np.abs(friction).max() < 0.02 * 0.4 * mass * 9.81
    path = diagnostics.centre_of_mass(block)[0] - start
    assert path == pytest.approx(1 / (2 * 0.4 * 9.81), rel=5e-3)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("tilt", "friction"), [once(*FALLS["edge"]), FALLS["face"], once(*FALLS["corner"])]
)
def test_rigid_body_bounces_on_a_floor_with_exact_energy(comm, tilt, friction):
    # All nine nodes of a face touch together: only the sum of their forces is unique.
    stepper = falling(comm, tilt, friction, nts.LagrangeMultiplier())
    diagnostics = nts.Diagnostics(stepper)
    first, given, active, rises = diagnostics.balance(), 0.0, 0, False
    for _ in range(40):
        report = stepper.advance()
        given += sum(report.contact_work) + report.load_work
        active = max(active, report.num_active)
        rises |= diagnostics.balance().linear_momentum[2] > 0
    last = diagnostics.balance()
    assert active == 9 if tilt == 0 else 1 <= active <= 3
    assert abs(last.total_energy - first.total_energy - given) < 1e-11 * first.total_energy
    assert rises


@pytest.mark.serial
@pytest.mark.parametrize("rho", [1e-6, 1e3, 1e9])
def test_elastic_impact_of_a_corner_in_short_steps_agrees_with_rigid_body_mechanics(rho):
    # Normal impulse per mass at a frictionless point: 2 v / (1 + (r x n) J (r x n)), with the
    # inverse J of the inertia per mass. Inertia per step squared is 1e9 times as large as in the
    # first impact of the documentation, for any unit of mass.
    sizes, dt = np.array([0.3, 0.2, 0.1]), 1e-6
    turn = rotation([0.6, 0.4, 0.2], 0.75)
    data = boxes([(2, 2, 2)], [tuple(sizes)])
    data.X[:] = (data.X - sizes / 2) @ turn.T
    corner = data.X[np.argmin(data.X[:, 2])]
    mesh, cells, _, tag = distribute(MPI.COMM_SELF, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    brick = nts.RigidBody(V, cells, tag["body 0"], rho)
    floor = nts.RigidPlane((0, 0, corner[2] - 2.5 * dt), (0, 0, 1))
    stepper = nts.EnergyMomentum([brick], [nts.ContactPair(nts.boundary_of(brick), floor)], dt=dt)
    stepper.set_velocity(brick, (0.0, 0.0, -1.0))
    for _ in range(6):
        report = stepper.advance()
        assert report.newton_iterations < 10
    arm = turn.T @ np.cross(corner, (0, 0, 1))
    inertia = ((sizes**2).sum() - sizes**2) / 12
    expected = 2 / (1 + arm @ (arm / inertia)) - 1
    velocity = nts.Diagnostics(stepper).linear_momentum()[2] / (rho * sizes.prod())
    assert velocity == pytest.approx(expected, abs=2e-5)


@pytest.mark.serial
@pytest.mark.parametrize(
    # Rigid bodies stick to each other unless friction is small.
    ("lower", "friction"),
    [("rigid", None), ("rigid", nts.Coulomb(0.1)), ("deformable", None), ("deformable", STICK)],
)
def test_nodes_of_a_rigid_body_may_touch(comm, lower, friction):
    scene = impact(comm, rigid_nodes=True, both_rigid=lower == "rigid", friction=friction)
    first, last, given, active = run(scene)
    assert active > 0
    check_balances(first, last, given)
    if friction is None:
        assert abs(given) < 1e-11 * first.total_energy
    else:
        assert given < -1e-3 * first.total_energy


@pytest.mark.serial
@pytest.mark.parametrize(
    ("enforcement", "friction", "warns"),
    [
        (nts.LagrangeMultiplier(), STICK, True),
        (nts.LagrangeMultiplier(), None, False),
        (None, STICK, False),
    ],
)
def test_failures_name_pairs_without_unique_forces(comm, enforcement, friction, warns):
    floor = nts.RigidPlane((0, 0, 0), (0, 0, 1))
    stepper = falling(comm, 0.0, friction, enforcement, target=floor)
    names = redundant(stepper.bodies, stepper.pairs)
    assert names == (f"the boundary of body 0 and {floor.name}" if warns else "")
    scene = impact(comm, friction=STICK).stepper
    assert not redundant(scene.bodies, scene.pairs)


@pytest.mark.serial
@pytest.mark.parametrize("dt", [0.01, 0.0025])
@pytest.mark.parametrize("tilt", [0.3, 0.05], ids=["edge", "corner"])
def test_default_springs_limit_penetration_to_the_motion_in_two_steps(comm, tilt, dt):
    stepper = falling(comm, tilt, None, nts.Penalty(), dt)
    diagnostics, speeds, depth = nts.Diagnostics(stepper), [], 0.0
    for _ in stepper.run(until=0.5):
        depth = max(depth, -stepper.x[:, 2].min())
        speeds.append(diagnostics.balance().linear_momentum[2] / RHO)
    (contact,) = stepper.contacts
    assert contact.eps_N == pytest.approx(0.5 * RHO / dt**2, rel=1e-12)  # a cube of one metre
    assert max(speeds) > 0.5  # it bounces
    assert 0.2 * dt < depth / -min(speeds) < 2 * dt


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("rigid_nodes", [False, True])
def test_default_springs_use_the_lighter_of_two_rigid_bodies(comm, agree, rigid_nodes):
    scene = impact(comm, enforcement=nts.Penalty(), rigid_nodes=rigid_nodes, both_rigid=True)
    first, last, _, active = run(scene)
    assert active > 0
    energy = last.total_energy - first.total_energy
    assert abs(energy) < 1e-11 * first.total_energy
    (contact,) = scene.stepper.contacts
    light = 10.0 * 0.5  # against 20 kg/m^3 in 0.63 m^3
    assert agree(contact.eps_N == pytest.approx(0.5 * light / 0.01**2, rel=1e-12))


@pytest.mark.at_most_two_ranks
def test_default_springs_between_rigid_and_soft_bodies_use_the_soft_side(comm, agree):
    E, nu, _ = NUMBERS
    of_cells = E * (1 - nu) / (1 + nu) / (1 - 2 * nu) / 0.25  # per area, height 0.25 m
    for rigid_nodes in (False, True):
        scene = impact(comm, enforcement=nts.Penalty(), rigid_nodes=rigid_nodes)
        scene.stepper.advance()
        (contact,) = scene.stepper.contacts
        area = contact.pair.nodes.area
        assert agree(contact.eps_N == pytest.approx(0.6 * of_cells * area, rel=1e-12))


@pytest.mark.serial
def test_statics_of_rigid_bodies_alone_is_refused(comm, refused):
    with refused(ValueError, r"a body that deforms in statics, given rigid ones alone \(body 0\)"):
        falling(comm, 0.0, None, scheme=nts.QuasiStatic)


def block_on_floor(comm, kind, prescribed, scheme=nts.EnergyMomentum, law=None, reverse=False):
    """Stepper of a block, rigid or soft, that touches a floor with prescribed nodes.

    ``prescribed`` selects "no" node, of the "bottom", of the "top" or of "all" of the floor.
    """
    data = boxes([(2, 2, 1), (3, 3, 2)], [(1.0, 1.0, 0.5), (3.0, 3.0, 1.0)])
    data.X[np.unique(data.cells[data.body == 0])] += [1.0, 1.0, 1.0]
    mesh, cells, facets, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(1e5, 0.3, 1e3))
    if kind == "rigid":
        guide = nts.Guide(slides="z") if scheme is nts.QuasiStatic else None
        block = nts.RigidBody(V, cells, tag["body 0"], 1e3, guide=guide)
    floor = nts.Body(V, cells, tag["body 1"], nts.NeoHookean(1e9, 0.3, 1e3))
    least, most = {"no": (2, 1), "bottom": (0, 0), "top": (1, 1), "all": (0, 1)}[prescribed]
    z = V.tabulate_dof_coordinates()[floor.nodes, 2]
    held = floor.nodes[(z > least - 1e-9) & (z < most + 1e-9)]
    surfaces = [nts.Surface(V, facets, tag[name]) for name in ("bottom 0", "top 1")]
    pair = nts.ContactPair(
        *(surfaces[::-1] if reverse else surfaces), law or nts.Penalty(), method="node-to-segment"
    )
    bcs = [fem.dirichletbc(np.zeros(3), held, V)]
    return scheme([block, floor], [pair], dt=0.01, bcs=bcs)


def range_of_springs(comm, *scene, **arguments):
    """Least and greatest stiffness of the springs of a `block_on_floor` [N/m]."""
    stepper = block_on_floor(comm, *scene, **arguments)
    stepper.advance()
    eps_N = np.concatenate(comm.allgather(stepper.contacts[0].eps_N))
    return np.array([eps_N.min(), eps_N.max()])


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("prescribed", ["bottom", "top", "all"])
@pytest.mark.parametrize("reverse", [False, True])
def test_default_springs_use_the_deformable_side(comm, agree, prescribed, reverse):
    soft = range_of_springs(comm, "soft", prescribed, reverse=reverse)
    free = range_of_springs(comm, "soft", "no", reverse=reverse)
    assert agree(soft == pytest.approx(free, rel=1e-12))


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("prescribed", ["top", "all"])
@pytest.mark.parametrize("reverse", [False, True])
def test_default_springs_between_rigid_and_prescribed_nodes_scale_with_inertia(
    comm, agree, prescribed, reverse
):
    eps_N = range_of_springs(comm, "rigid", prescribed, reverse=reverse)
    # Half the mass of the block divided by the square of the step.
    assert agree(eps_N == pytest.approx(0.5 * 500.0 / 0.01**2, rel=1e-9))


@pytest.mark.serial
def test_statics_where_nothing_resists_is_refused(comm, refused):
    for law in (nts.Penalty(), nts.Penalty(1e8)):
        with refused(ValueError, r"all displacements prescribed \(body 1\): use EnergyMomentum"):
            block_on_floor(comm, "rigid", "all", nts.QuasiStatic, law)
    # The prescribed top is as rigid as the block, but the part below deforms.
    assert range_of_springs(comm, "rigid", "top", scheme=nts.QuasiStatic).min() > 1e8


@pytest.mark.serial
@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.QuasiStatic])
def test_default_springs_with_all_displacements_prescribed(comm, refused, scheme):
    data = boxes([(2, 2, 2)], [(1.0, 1.0, 1.0)])
    mesh, cells, facets, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    body = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(*RUBBER))
    plane = nts.RigidPlane((0, 0, 0), (0, 0, 1))
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["bottom 0"]), plane, nts.Penalty(), method="node-to-segment"
    )
    every = np.arange(len(V.tabulate_dof_coordinates()), dtype=np.int32)
    bcs = [fem.dirichletbc(np.zeros(3), every, V)]
    stepper = scheme([body], [pair], dt=0.1, bcs=bcs)
    if scheme is nts.QuasiStatic:
        with refused(ValueError, r"all displacements are prescribed, .* Penalty\(eps_N=...\)"):
            stepper.advance()
        return
    stepper.advance()
    mass = RUBBER[2]
    assert stepper.contacts[0].eps_N == pytest.approx(0.5 * mass / 0.1**2, rel=1e-9)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("what", ["a body", once("an obstacle")])
def test_soft_springs_are_named_as_the_cause_of_a_failure(comm, refused, what):
    law = nts.Penalty(eps_N=2.0)
    if what == "a body":
        stepper = impact(comm, enforcement=law, both_rigid=True, dt=0.02).stepper
    else:
        floor = nts.RigidSphere((0.2, 0.0, -1.1), 1.0)
        stepper = falling(comm, 0.0, None, law, target=floor)
    with refused(nts.ConvergenceError, r"accepted step: stiffer springs .* eps_N = 2 N/m\)\n"):
        while stepper.t < 2.0:
            stepper.advance()


@pytest.mark.serial
def test_midpoint_rule_keeps_both_momenta(comm):
    first, last, _, active = run(impact(comm, nts.Midpoint, dt=0.005))
    assert active > 5
    for name in ("linear_momentum", "angular_momentum"):
        before, after = getattr(first, name), getattr(last, name)
        assert np.linalg.norm(after - before) < 1e-11 * np.linalg.norm(before)
    assert 1e-9 < abs(last.total_energy / first.total_energy - 1) < 0.01


@pytest.mark.serial
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_plane_has_rigid_bodies_with_three_unknowns(cell):
    scene = blocks(cell, angle=0.4, rigid=True)
    pair = nts.ContactPair(
        scene.segments,
        scene.nodes,
        friction=STICK,
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    stepper = nts.EnergyMomentum([scene.lower, scene.upper], [pair], dt=0.01)
    throw(scene, stepper)
    diagnostics = nts.Diagnostics(stepper)
    first = diagnostics.balance()
    reports = [stepper.advance() for _ in range(12)]
    assert max(report.num_active for report in reports) > 0
    given = sum(sum(report.contact_work) for report in reports)
    check_balances(first, diagnostics.balance(), given)


@pytest.mark.several_ranks
def test_motion_is_the_same_on_any_number_of_ranks(comm, agree):
    here, alone = (impact(each, friction=STICK) for each in (comm, MPI.COMM_SELF))
    for _ in range(12):
        report, other = here.stepper.advance(), alone.stepper.advance()
    assert agree(report.num_active == other.num_active > 0)
    assert agree(np.abs(here.positions() - alone.positions()).max() < 1e-10)


@pytest.mark.serial
def test_linear_systems_need_few_iterations_and_converge_quadratically(comm):
    scene = impact(comm, n=6)
    reports = [scene.stepper.advance() for _ in range(20)]
    newton = sum(report.newton_iterations for report in reports)
    assert newton < 5.5 * len(reports)
    solver = scene.stepper.statistics.solver
    assert solver.num_iterations < 5 * newton and solver.num_direct == 0


@pytest.mark.at_most_two_ranks
def test_a_resumed_run_is_the_same_run(comm, tmp_path):
    folder = comm.bcast(tmp_path)

    def record(stepper, num_steps):
        with nts.Recorder(folder / "run", stepper, checkpoint_every=2, resume=True) as recorder:
            for step in stepper.run(until=num_steps * stepper.dt):
                recorder.write(step)

    whole = impact(comm, friction=STICK)
    for _ in whole.stepper.run(until=12 * whole.stepper.dt):
        pass
    for num_steps in (6, 12):  # during contact
        scene = impact(comm, friction=STICK)
        record(scene.stepper, num_steps)
    assert np.array_equal(scene.stepper.x, whole.stepper.x)
    assert np.array_equal(scene.stepper.v.x.array, whole.stepper.v.x.array)


@pytest.mark.at_most_two_ranks
def test_body_that_shares_nodes_with_a_rigid_one_is_bonded_to_it(comm):
    soft, rigid, *_ = bonded(comm)
    stepper = nts.EnergyMomentum([soft, rigid], dt=0.02)
    stepper.set_velocity(soft, lambda X: np.array([5 * X[2], 0 * X[0], 0 * X[0]]))
    stepper.set_velocity(rigid, spin((0.0, 0.0, 3.0), (0.0, 0.0, 0.0)))
    diagnostics = nts.Diagnostics(stepper)
    first = diagnostics.balance()
    for _ in range(20):
        stepper.advance()
    last = diagnostics.balance()
    check_balances(first, last, 0.0)
    assert last.strain_energy > 0.01 * first.total_energy
    assert stepper.statistics.solver.num_direct == 0


def held(body):
    """Supports of a body at its nodes."""
    dofs = body.nodes[: max(len(body.nodes) // 2, 1)]
    return fem.dirichletbc(np.zeros(3), dofs, body.V)


@pytest.mark.at_most_two_ranks
def test_unsupported_rigid_bodies_are_refused(comm, refused):
    soft, rigid, facets, tag = bonded(comm)
    bodies = [soft, rigid]
    for scheme in (nts.EnergyMomentum, nts.CentralDifference):
        with refused(
            ValueError, r"bcs at nodes of deformable bodies, given \d+ nodes of the rigid"
        ):
            scheme(bodies, dt=1e-3, bcs=[held(rigid)])
    top, bottom = (nts.Surface(soft.V, facets, tag[name]) for name in ("top 0", "bottom 0"))
    law = nts.LagrangeMultiplier("resolved")
    with refused(ValueError, "nodes of deformable bodies with impact 'resolved', given"):
        nts.EnergyMomentum(
            bodies, [nts.ContactPair(top, bottom, law, method="node-to-segment")], dt=0.1
        )
    with refused(ValueError, "rigid bodies without a guide together with impact 'resolved', given"):
        pressed(comm, nts.EnergyMomentum, nts.Guide(slides="z"), enforcement=law)


@pytest.mark.at_most_two_ranks
def test_state_that_would_deform_a_rigid_body_is_refused(comm, refused):
    soft, rigid, *_ = bonded(comm)
    for name, value in (
        ("velocity", lambda X: np.array([X[0], 0 * X[0], 0 * X[0]])),
        ("velocity", lambda X: np.array([X[2] ** 2, 0 * X[0], 0 * X[0]])),
        ("displacement", lambda X: np.array([0 * X[0], 0.01 * X[0], 0 * X[0]])),
    ):
        for scheme in (nts.EnergyMomentum, nts.CentralDifference):
            stepper = scheme([soft, rigid], dt=1e-3)
            getattr(stepper, f"set_{name}")(rigid, value)
            with refused(
                ValueError, f"expected a {name} of the rigid .* that moves and rotates it"
            ):
                stepper.advance()


@pytest.mark.serial
@pytest.mark.parametrize("rho", [0.0, -1.0, np.nan])
def test_a_free_rigid_body_needs_mass(comm, rho):
    mesh, cells, _, tag = distribute(comm, boxes([(1, 1, 1)], [(1.0, 1.0, 1.0)]))
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    with pytest.raises(ValueError, match=r"expected .*rho.*, given"):
        nts.RigidBody(V, cells, tag["body 0"], rho)


@pytest.mark.serial
def test_two_rigid_bodies_may_not_share_nodes(comm):
    data = boxes([(1, 1, 2)], [(1.0, 1.0, 1.0)])
    data.body[1] = 1
    mesh, cells, _, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bodies = [nts.RigidBody(V, cells, tag[f"body {i}"], 1.0) for i in (0, 1)]
    with pytest.raises(ValueError, match=r"rigid bodies without common nodes, given .* with 4"):
        nts.EnergyMomentum(bodies, dt=0.1)
