"""Rigid bodies in the schemes that do not conserve the energy exactly."""

from functools import partial
from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models.box_meshes import boxes, distribute
from helpers.models.plane import blocks, throw
from helpers.models.rigid import CENTRE, bonded, brick, eulers, hinged, impact, pressed
from helpers.once import once
from helpers.scene import Motion

STICK = nts.Coulomb(mu=0.3)
SCHEMES = {
    "explicit": (nts.CentralDifference, nts.Penalty(), 2e-3),
    "alpha": (nts.GeneralizedAlpha, nts.LagrangeMultiplier("plastic"), 0.01),
}
of_each = pytest.mark.parametrize(("scheme", "law", "dt"), SCHEMES.values(), ids=SCHEMES)
ROTATING = {
    "explicit": nts.CentralDifference,
    **{f"rho {r}": partial(nts.GeneralizedAlpha, rho_inf=r) for r in (0.0, 0.8, 1.0)},
}


@pytest.mark.serial
@pytest.mark.parametrize("scheme", ROTATING.values(), ids=ROTATING)
def test_free_rotation_agrees_with_eulers_equations_to_second_order(scheme):
    omega = np.array([3.0, 0.4, -0.3])
    exact, errors = eulers(omega, 1.0), []
    for dt in (0.05, 0.025):
        stepper, turn = brick(dt, omega, scheme=scheme)
        for _ in stepper.run(until=1.0):
            pass
        errors.append(np.abs(turn() - exact).max())
    assert 3.7 < errors[0] / errors[1] < 4.4
    assert errors[1] < 0.02


@pytest.mark.serial
def test_moment_turns_a_tumbling_body_to_second_order_with_numerical_damping():
    """Differences of three steps; a moment about the mean state would be of first order."""

    def driven(bodies, dt):
        moment = nts.Moment(bodies[0], (0.6, -0.9, 0.5))
        return nts.GeneralizedAlpha(bodies, dt=dt, rho_inf=0.8, loads=[moment])

    turns = []
    for dt in (0.04, 0.02, 0.01):
        stepper, turn = brick(dt, np.array([3.0, 0.4, -0.3]), scheme=driven)
        for _ in stepper.run(until=1.0):
            pass
        turns.append(turn())
    coarse, fine = (np.abs(a - b).max() for a, b in pairwise(turns))
    assert 3.7 < coarse / fine < 4.3


@pytest.mark.serial
def test_explicit_tumbling_keeps_angular_momentum_and_bounds_the_energy():
    stepper, turn = brick(0.03, np.array([5.0, 0.01, 0.02]), scheme=nts.CentralDifference)
    diagnostics = nts.Diagnostics(stepper)
    first, axis, energy = diagnostics.balance(), [], []
    for _ in range(300):
        stepper.advance()
        axis.append(turn()[0, 0])
        energy.append(diagnostics.balance().total_energy)
    last = diagnostics.balance()
    assert min(axis) < -0.9 and max(axis) > 0.9
    assert np.abs(np.array(energy) / first.total_energy - 1).max() < 0.01
    drift = last.angular_momentum - first.angular_momentum
    assert np.abs(drift).max() < 1e-12 * np.abs(first.angular_momentum).max()
    assert np.abs(turn().T @ turn() - np.eye(3)).max() < 1e-12


def run(stepper, until=0.25):
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


@pytest.mark.at_most_two_ranks
@of_each
@pytest.mark.parametrize("case", ["rigid on soft", once("nodes are rigid"), once("both rigid")])
def test_impact_has_exact_momenta_and_a_ledger(comm, scheme, law, dt, case):
    kinds = {"rigid_nodes": case == "nodes are rigid", "both_rigid": case == "both rigid"}
    motion = Motion.random(np.random.default_rng(5))
    law = law if case == "rigid on soft" else nts.Penalty()
    scene = impact(comm, scheme, law, motion=motion, friction=STICK, dt=dt, **kinds)
    first, last, active, of_scheme, rest, taken = run(scene.stepper)
    assert active > 0
    size = first.total_energy
    assert abs(rest) < 1e-10 * size
    # Central differences hardly change the energy, generalised-alpha dissipates. Between rigid
    # bodies its springs dissipate the energy that the jump of the acceleration adds, as there are
    # no cells that do so.
    if case == "both rigid" and scheme is nts.GeneralizedAlpha:
        of_scheme = last.total_energy - size + taken
    assert (-0.01 if scheme is nts.CentralDifference else -0.3) * size < of_scheme < 0.01 * size
    names = ["linear_momentum"]
    if scheme is nts.CentralDifference:
        names.append("angular_momentum")
    for name in names:
        before, after = getattr(first, name), getattr(last, name)
        assert np.linalg.norm(after - before) < 1e-11 * np.linalg.norm(before)


@of_each
def test_motion_is_the_same_on_any_number_of_ranks_and_resumed(
    comm, agree, tmp_path, scheme, law, dt
):
    folder = comm.bcast(tmp_path)

    def scene(on):
        return impact(on, scheme, law, friction=STICK, dt=dt)

    alone, whole = scene(MPI.COMM_SELF), scene(comm)
    end = round(0.17 / dt)
    for each in (alone, whole):
        for _ in each.stepper.run(until=end * dt):
            pass
    for num_steps in (end - 6, end):  # during contact
        here = scene(comm)
        with nts.Recorder(folder / "run", here.stepper, checkpoint_every=2, resume=True) as files:
            for step in here.stepper.run(until=num_steps * dt):
                files.write(step)
    assert agree(step.num_active > 0)
    assert agree(np.abs(whole.positions() - alone.positions()).max() < 1e-10)
    assert agree(np.array_equal(here.stepper.x, whole.stepper.x))
    assert agree(np.array_equal(here.stepper.v.x.array, whole.stepper.v.x.array))


@of_each
@pytest.mark.at_most_two_ranks
def test_guided_tools_have_a_ledger(comm, scheme, law, dt):
    dt = 1e-3 if scheme is nts.CentralDifference else dt
    led = nts.Guide(motion=nts.Motion(lambda t: (0.05 * t, 0.0, -0.3 * t), centre=CENTRE))
    for guide, force in ((nts.Guide(slides="z"), (0, 0, -40.0)), (led, None)):
        stepper, tool = pressed(comm, scheme, guide, force, dt=dt, enforcement=law)
        if force is None:
            stepper.set_velocity(tool, (0.05, 0.0, -0.3))
        first, last, active, _, rest, _ = run(stepper, 0.3)
        assert active > 0
        scale = max(first.total_energy, last.total_energy)
        assert abs(rest) < 1e-10 * scale


@pytest.mark.serial
def test_explicit_guides_are_exact_in_their_reaction():
    stepper, _ = hinged(moment=(1.0, 0.5, 2.0), dt=0.01, scheme=nts.CentralDifference)
    diagnostics, work = nts.Diagnostics(stepper), 0.0
    for step in stepper.run(until=1.0):
        work += step.load_work + diagnostics.bulk_defect()
        assert abs(step.reactions[0].work) < 1e-12
    balance = diagnostics.balance()
    assert abs(balance.kinetic_energy - work) < 1e-11 * work
    X = stepper.u.function_space.tabulate_dof_coordinates()
    axis = np.isclose(X[:, 0], 0) & np.isclose(X[:, 2], 0)
    assert axis.any() and np.abs(stepper.x - X)[axis].max() < 1e-12


@pytest.mark.at_most_two_ranks
@of_each
def test_bonded_body_conserves_momenta(comm, scheme, law, dt):
    soft, rigid, *_ = bonded(comm)
    stepper = scheme([soft, rigid], dt=dt)
    stepper.set_velocity(soft, lambda X: np.array([5 * X[2], 0 * X[0], 0 * X[0]]))
    stepper.set_velocity(rigid, (2.5, 0.0, 0.0))
    first, last, _, _, rest, _ = run(stepper, 0.1)
    assert abs(rest) < 1e-10 * first.total_energy
    change = last.linear_momentum - first.linear_momentum
    assert np.linalg.norm(change) < 1e-11 * np.linalg.norm(first.linear_momentum)
    assert last.strain_energy > 0.01 * first.total_energy


@pytest.mark.serial
@of_each
def test_plane_has_rigid_bodies(scheme, law, dt):
    scene = blocks("quadrilateral", angle=0.4, rigid=True)
    pair = nts.ContactPair(scene.segments, scene.nodes, law, STICK, method="node-to-segment")
    dt = None if scheme is nts.CentralDifference else dt
    stepper = scheme([scene.lower, scene.upper], [pair], dt=dt)
    throw(scene, stepper)
    first, last, active, _, rest, _ = run(stepper, 0.12)
    assert active > 0
    assert abs(rest) < 1e-10 * first.total_energy
    change = last.linear_momentum - first.linear_momentum
    assert np.linalg.norm(change) < 1e-10 * np.linalg.norm(first.linear_momentum)


@pytest.mark.serial
@pytest.mark.parametrize("both_rigid", [False, True])
def test_estimate_of_the_stable_step_holds_for_springs_at_rigid_nodes(comm, both_rigid):
    springs = nts.Penalty(500.0)
    stepper = impact(comm, nts.CentralDifference, springs, dt=1e-4, both_rigid=both_rigid).stepper
    stepper.dt = 0.98 * stepper.stable_step
    _, _, active, of_scheme, rest, _ = run(stepper, 0.3)
    assert active > 0
    assert abs(of_scheme) < 0.5 and abs(rest) < 1e-9  # of 25 J


def test_default_springs_of_rigid_bodies_hardly_depend_on_cell_sizes(comm):
    def stiffness(power):
        data = boxes([(4, 4, 4), (4, 4, 4)], [(1.0, 1.0, 1.0), (1.0, 1.0, 1.0)])
        data.X[:] = data.X**power  # cells that are small at one corner
        data.X[np.unique(data.cells[data.body == 1])] += [0.0, 0.0, 1.1]
        mesh, cells, facets, tag = distribute(comm, data)
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        bodies = [nts.RigidBody(V, cells, tag[f"body {k}"], 10.0) for k in (0, 1)]
        surfaces = [nts.Surface(V, facets, tag[name]) for name in ("top 0", "bottom 1")]
        pair = nts.ContactPair(*surfaces, nts.Penalty(), method="node-to-segment")
        stepper = nts.CentralDifference(bodies, [pair], dt=1e-3)
        stepper.advance()
        return comm.allreduce(stepper.contacts[0].eps_N.min(initial=np.inf), MPI.MIN)

    even, graded = stiffness(1), stiffness(2)
    assert graded > 0.5 * even


@pytest.mark.serial
def test_unsupported_combinations_are_refused(comm, refused):
    with refused(ValueError, "expected a step dt if all bodies are rigid, given None"):
        brick(None, np.ones(3), scheme=nts.CentralDifference)
    plastic = nts.LagrangeMultiplier("plastic")
    for kinds in ({"rigid_nodes": True}, {"both_rigid": True}):
        with refused(ValueError, "expected Penalty for GeneralizedAlpha between .*, given Lag"):
            impact(comm, nts.GeneralizedAlpha, plastic, **kinds)
    stepper, _ = brick(0.1, np.array([30.0, 0, 0]), scheme=nts.CentralDifference)
    with refused(nts.ConvergenceError, "smallest cell|rotates too far in it"):
        stepper.advance()
