"""Guided rigid bodies: tools with prescribed motion or forces, in statics and in time."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.plotting.scene import von_mises
from helpers.models.plane import blocks
from helpers.models.rigid import CENTRE, hinged, pressed, spin
from helpers.once import once, once_except
from helpers.scene import Scene
from reference.bulk import rotation

STICK = nts.Coulomb(mu=0.3)
RHO = 20.0
DEPTH, TURN = 0.3, 0.8  # speeds of tools [m/s, rad/s]


def down(t):
    return 0.0, 0.0, -0.1 * t


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("friction", [once(None, id="frictionless"), STICK])
def test_force_control_is_displacement_control_in_statics(comm, agree, friction):
    stepper, _ = pressed(
        comm, nts.QuasiStatic, nts.Guide(motion=nts.Motion(down)), friction=friction
    )
    forces, states = [0.0], []
    for _ in range(3):
        foot, tool = stepper.advance().reactions
        assert np.allclose(np.add(foot.force, tool.force), 0.0, atol=1e-9 * foot.force[2])
        forces.append(tool.force[2])
        states.append(stepper.x)
    assert forces[3] < forces[2] < forces[1] < -1.0

    def force(t):
        return 0.0, 0.0, np.interp(t, np.arange(4) * stepper.dt, forces)

    stepper, tool = pressed(comm, nts.QuasiStatic, nts.Guide(slides="z"), force, friction=friction)
    for state in states:
        reaction = stepper.advance().reactions[1]
        assert agree(np.abs(stepper.x - state).max(initial=0.0) < 1e-10)
        assert abs(reaction.force[2]) < 1e-9 * abs(forces[1]) and reaction.work < 1e-12


@pytest.mark.at_most_two_ranks
def test_stress_is_in_the_block_alone(comm):
    stepper, tool = pressed(comm, nts.QuasiStatic, nts.Guide(motion=nts.Motion(down)))
    stepper.advance()
    stress = von_mises(stepper)
    is_rigid = np.concatenate([np.full(len(body.cells), body is tool) for body in stepper.bodies])
    assert len(stress) == len(is_rigid)
    assert (stress[is_rigid] == 0.0).all() and (stress[~is_rigid] > 0.0).all()


STATICS = {
    "tilts": (nts.Guide(slides="z", turns="xyz"), None, {"force": lambda t: (0, 0, -30 * t)}),
    "turns": (
        nts.Guide(slides="z", turns="z"),
        nts.Coulomb(0.5),
        {"force": lambda t: (0, 0, -30 * t), "moment": lambda t: (0, 0, t)},
    ),
    "free": (None, STICK, {"force": lambda t: (0, 0, -30 * t)}),
    "aside": (
        nts.Guide(slides="z", point=(0.7, 0.6, 0.6)),
        None,
        {"force": lambda t: (0, 0, -30 * t)},
    ),
    "spring": (nts.Guide(slides="z"), None, {"spring": True}),
}


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("case", once_except(list(STATICS), "turns"))
def test_static_tool_is_in_equilibrium_with_the_foot(comm, case):
    guide, friction, loads = STATICS[case]
    stepper, tool = pressed(comm, nts.QuasiStatic, guide, friction=friction, dt=0.5, **loads)
    for _ in range(2):
        foot, *of_guide = stepper.advance().reactions
    assert stepper.step == 2
    press, moment = 30.0, 1.0 if case == "turns" else 0.0
    if case == "spring":
        z = nts.Diagnostics(stepper).centre_of_mass(tool)[2]
        press = 300.0 * (0.1 - (CENTRE[2] - z))
        assert 20.0 < press < 29.0
    assert abs(foot.force[2] - press) < 1e-8 * press
    # The guide carries all other components; friction resists the moment of a rotating tool.
    rest = np.sum([r.force for r in of_guide], axis=0) + np.array(foot.force)
    assert np.abs(rest - [0, 0, press]).max() < 1e-7
    if moment:
        lever = np.cross(CENTRE, of_guide[0].force)[2]
        assert abs(foot.moment[2] + lever + moment) < 1e-7
        assert abs(of_guide[0].moment[2] - lever) < 1e-7


def check_ledger(stepper, num_steps, force=(0, 0, 0)):
    """Energy and momentum change by the reported values; return the reports."""
    diagnostics = nts.Diagnostics(stepper)
    first, reports = diagnostics.balance(), []
    for _ in range(num_steps):
        before = diagnostics.balance()
        report = stepper.advance()
        reports.append(report)
        after = diagnostics.balance()
        impulse = stepper.dt * np.sum([r.force for r in report.reactions], axis=0)
        impulse = impulse + stepper.dt * np.array(force)
        change = after.linear_momentum - before.linear_momentum
        assert np.linalg.norm(change - impulse) < 1e-10
    last = diagnostics.balance()
    given = sum(
        sum(report.contact_work) + report.load_work + report.support_work for report in reports
    )
    scale = max(last.total_energy, first.total_energy)
    assert abs(last.total_energy - first.total_energy - given) < 1e-11 * scale
    return reports


@pytest.mark.at_most_two_ranks
def test_guided_tool_presses_and_turns_with_an_exact_ledger(comm):
    motion = nts.Motion(
        lambda t: (0.05 * t, 0.0, -DEPTH * t), lambda t: (0, 0, TURN * t), centre=CENTRE
    )
    stepper, tool = pressed(
        comm, nts.EnergyMomentum, nts.Guide(motion=motion), friction=STICK, dt=0.01
    )
    stepper.set_velocity(tool, spin((0, 0, TURN), CENTRE, (0.05, 0.0, -DEPTH)))
    X = stepper.x[tool.nodes]
    reports = check_ledger(stepper, 12)
    assert max(report.num_active for report in reports) > 5
    assert sum(report.reactions[1].work for report in reports) > 0.01
    Q, t = rotation([0, 0, 1], TURN * stepper.t), stepper.t
    exact = (X - CENTRE) @ Q.T + CENTRE + [0.05 * t, 0.0, -DEPTH * t]
    assert np.abs(stepper.x[tool.nodes] - exact).max(initial=0.0) < 1e-12


CASES = {
    "slide": (nts.Guide(slides="z"), (0, 0, -40.0), None),
    "spindle": (nts.Guide(slides="z", turns="z"), (0, 0, -40.0), (0, 0, 0.5)),
    "oblique": (nts.Guide(slides=(0.3, 0, 1.0)), (0, 0, -40.0), None),
    "ball": (nts.Guide(turns="xyz", point=CENTRE + 0.1), (0, 3.0, -40.0), None),
    "plane": (nts.Guide(slides="xz", turns="y"), (1.0, 0, -40.0), (0, 0.2, 0)),
}


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("case", once_except(list(CASES), "spindle"))
def test_pushed_tool_has_an_exact_ledger(comm, case):
    guide, force, moment = CASES[case]
    stepper, _ = pressed(
        comm, nts.EnergyMomentum, guide, force, friction=STICK, dt=0.01, moment=moment
    )
    reports = check_ledger(stepper, 25, force)
    assert stepper.statistics.solver.num_direct == 0
    assert max(report.num_active for report in reports) > 0
    # A guide at rest does no work.
    assert max(abs(r.reactions[1].work) for r in reports) < 1e-12


def test_motion_is_the_same_on_any_number_of_ranks_and_resumed(comm, agree, tmp_path):
    folder = comm.bcast(tmp_path)
    guide, force, moment = CASES["spindle"]

    def scene(on):
        return pressed(
            on, nts.EnergyMomentum, guide, force, friction=STICK, dt=0.01, moment=moment
        )[0]

    alone = scene(MPI.COMM_SELF)
    for _ in alone.run(until=0.2):
        pass
    for num_steps in (14, 20):  # during contact
        here = scene(comm)
        with nts.Recorder(folder / "run", here, checkpoint_every=2, resume=True) as recorder:
            for step in here.run(until=num_steps * here.dt):
                recorder.write(step)
    there, other = (Scene(each, {}, ()).positions() for each in (here, alone))
    assert agree(np.abs(there - other).max() < 1e-10)
    if comm.rank == 0:
        header, *_, last = (folder / "run.csv").read_text().splitlines()
        row = dict(zip(header.split(","), map(float, last.split(",")), strict=True))
        assert abs(row["energy_unaccounted"]) < 1e-11
        assert abs(row["guide_1_work"]) < 1e-11 < abs(row["guide_1_force_x"])


INERTIA = RHO * 0.08 * (0.4**2 / 12 + 1.0 / 3)  # about the hinge [kg m^2]


def angle(stepper):
    """Rotation angle of a hinged brick, from its lowest points."""
    x = stepper.x - stepper.x[np.argmin(np.linalg.norm(stepper.x, axis=1))]
    X = stepper.u.function_space.tabulate_dof_coordinates()
    low = np.isclose(X[:, 2], -1.0)
    middle = x[low].mean(axis=0)
    return np.arctan2(-middle[0], -middle[2])


@pytest.mark.serial
def test_moment_on_a_hinge_turns_it_as_by_newtons_law():
    errors = []
    for dt in (0.02, 0.01):
        stepper, _ = hinged(moment=(1.0, 0.5, 2.0), dt=dt)
        work = 0.0
        for step in stepper.run(until=1.0):
            work += step.load_work
            reaction = step.reactions[0]
            # The hinge carries the components of the moment normal to its axis.
            assert np.allclose(np.array(reaction.moment)[[0, 2]], [-1.0, -2.0], atol=1e-9)
        balance = nts.Diagnostics(stepper).balance()
        assert abs(balance.kinetic_energy - work) < 1e-11 * work
        errors.append(abs(angle(stepper) - 0.5 / INERTIA / 2))
    assert errors[1] < 2e-4 and 3.5 < errors[0] / errors[1] < 4.5


@pytest.mark.serial
def test_pendulum_keeps_its_energy_and_its_hinge():
    stepper, body = hinged(g=10.0)
    omega = 4.0
    stepper.set_velocity(body, spin((0, omega, 0), (0, 0, 0)))
    energy = INERTIA * omega**2 / 2
    height = nts.Diagnostics(stepper).centre_of_mass(body)[2]
    weight = RHO * 0.08 * 10.0
    for _ in stepper.run(until=1.0):
        pass
    diagnostics = nts.Diagnostics(stepper)
    raised = diagnostics.centre_of_mass(body)[2] - height
    assert raised > 0.02
    assert abs(diagnostics.balance().kinetic_energy + weight * raised - energy) < 1e-11 * energy
    X = stepper.u.function_space.tabulate_dof_coordinates()
    axis = np.isclose(X[:, 0], 0) & np.isclose(X[:, 2], 0)
    assert axis.any() and np.abs(stepper.x - X)[axis].max() < 1e-12


@pytest.mark.serial
def test_guide_in_the_plane_slides_and_turns(comm):
    scene = blocks(rigid=True, guide=nts.Guide(slides="y", turns="z"))
    upper = scene.upper
    pair = nts.ContactPair(
        scene.segments,
        scene.nodes,
        friction=STICK,
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    loads = [nts.Force(upper, (0.0, -5e4)), nts.Moment(upper, 2e3)]
    stepper = nts.EnergyMomentum([scene.lower, upper], [pair], dt=2e-3, loads=loads)
    centre = nts.Diagnostics(stepper).centre_of_mass(upper)
    diagnostics = nts.Diagnostics(stepper)
    first, given = diagnostics.balance(), 0.0
    for _ in range(30):
        report = stepper.advance()
        given += sum(report.contact_work) + report.load_work
        assert abs(report.reactions[0].force[1]) < 1e-6 and len(report.reactions[0].moment) == 1
    assert report.num_active > 0
    total = diagnostics.balance().total_energy
    assert abs(total - first.total_energy - given) < 1e-11 * total
    assert abs(diagnostics.centre_of_mass(upper)[0] - centre[0]) < 1e-12


@pytest.mark.at_most_two_ranks
def test_bad_guides_are_refused(comm, refused):
    with refused(ValueError, "expected letters of 'xyz' as slides, each once, given 'zz'"):
        nts.Guide(slides="zz")
    with refused(ValueError, "expected one axis or 'xyz' as turns, given 'xy'"):
        nts.Guide(turns="xy")
    with refused(ValueError, "direction of turns that is not zero"):
        nts.Guide(turns=(0, 0, 0))
    with refused(ValueError, "motion without rotation together with turns='z'"):
        nts.Guide(turns="z", motion=nts.Motion(rotation=lambda t: (0, 0, t)))
    with refused(TypeError, "expected a Motion of a guide, given function"):
        nts.Guide(motion=down)
    with refused(TypeError, "expected a Guide of a rigid body, given str"):
        pressed(comm, nts.QuasiStatic, "z")
    stepper, _ = pressed(comm, nts.QuasiStatic, nts.Guide(slides="z"), (0, 0, 1.0))
    with refused(nts.ConvergenceError, r"no support or contact holds body 1 .* against 1 N"):
        stepper.advance()
    leap = nts.Motion(rotation=lambda t: (0, 0, 20 * t))
    stepper, _ = pressed(comm, nts.QuasiStatic, nts.Guide(motion=leap))
    with refused(nts.ConvergenceError, "body 1 rotates by 115 degrees in it"):
        stepper.advance()
