"""Guided rigid bodies: tools led by motions or pushed by forces, in statics and in time."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.rigid import spin
from helpers.scenes import boxes, distribute

STICK = nts.Coulomb(mu=0.3)
RHO = 20.0
DEPTH, TURN = 0.3, 0.8  # speeds of tools [m/s, rad/s]
CENTRE = np.array([0.52, 0.48, 0.651])


def pressed(comm, scheme, guide, force=None, *, friction=None, dt=0.1, dim=3, moment=None):
    """A rigid tool above a block on a clamped foot."""
    cut = slice(0, dim) if dim == 3 else (0, 2)
    data = boxes([(4, 4, 2), (2, 2, 1)], [(1.0, 1.0, 0.5), (0.6, 0.6, 0.3)])
    upper = np.unique(data.cells[data.body == 1])
    data.X[upper] += CENTRE - [0.3, 0.3, 0.15]
    mesh, cells, facets, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(1e3, 0.3, 10.0))
    tool = nts.RigidBody(V, cells, tag["body 1"], RHO, guide)
    surfaces = (nts.Surface(V, facets, tag[name]) for name in ("top 0", "bottom 1"))
    pair = nts.ContactPair(*surfaces, friction=friction)
    foot = fem.locate_dofs_topological(V, 2, facets.find(tag["bottom 0"]))
    clamp = fem.dirichletbc(np.zeros(3), foot, V)
    loads = [] if force is None else [nts.Force(tool, force)]
    if moment is not None:
        loads.append(nts.Moment(tool, moment))
    stepper = scheme([block, tool], [pair], dt=dt, bcs=[clamp], loads=loads)
    return stepper, tool


def down(t):
    return 0.0, 0.0, -0.1 * t


@pytest.mark.parametrize("friction", [None, STICK], ids=["frictionless", "friction"])
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


def check_ledger(stepper, num_steps, tol=1e-11):
    """Energy and momentum change by what the reports tell; return the reports."""
    diagnostics = nts.Diagnostics(stepper)
    first, reports = diagnostics.balance(), []
    for _ in range(num_steps):
        before = diagnostics.balance()
        report = stepper.advance()
        reports.append(report)
        after = diagnostics.balance()
        impulse = stepper.dt * np.sum([r.force for r in report.reactions], axis=0)
        for load in stepper.loads:
            if isinstance(load, nts.Force):
                impulse = impulse + stepper.dt * np.array(load._described())
        change = after.linear_momentum - before.linear_momentum
        scale = stepper.dt * max(np.linalg.norm(r.force) for r in report.reactions) + 1e-3
        assert np.linalg.norm(change - impulse) < tol * scale * 1e2
    last = diagnostics.balance()
    given = sum(
        sum(report.contact_work) + report.load_work + report.support_work for report in reports
    )
    scale = max(last.total_energy, first.total_energy)
    assert abs(last.total_energy - first.total_energy - given) < tol * scale
    return reports


def test_led_tool_presses_and_turns_with_an_exact_ledger(comm):
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
    angle, t = TURN * stepper.t, stepper.t
    Q = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    exact = (X - CENTRE) @ Q.T + CENTRE + [0.05 * t, 0.0, -DEPTH * t]
    assert np.abs(stepper.x[tool.nodes] - exact).max(initial=0.0) < 1e-12


CASES = {
    "slide": (nts.Guide(slides="z"), (0, 0, -40.0), None),
    "spindle": (nts.Guide(slides="z", turns="z"), (0, 0, -40.0), (0, 0, 0.5)),
    "oblique": (nts.Guide(slides=(0.3, 0, 1.0)), (0, 0, -40.0), None),
    "ball": (nts.Guide(turns="xyz", point=CENTRE + [0.2, 0, 0.1]), (0, 3.0, -40.0), None),
    "plane": (nts.Guide(slides="xz", turns="y"), (1.0, 0, -40.0), (0, 0.2, 0)),
}


@pytest.mark.parametrize("case", CASES)
def test_pushed_tool_has_an_exact_ledger(comm, case):
    guide, force, moment = CASES[case]
    stepper, tool = pressed(
        comm, nts.EnergyMomentum, guide, force, friction=STICK, dt=0.01, moment=moment
    )
    reports = check_ledger(stepper, 25)
    print(case, max(report.num_active for report in reports), sum(r.newton_iterations for r in reports), stepper.statistics.solver.num_direct, sum(r.load_work for r in reports), sum(r.reactions[1].work for r in reports))
    assert max(report.num_active for report in reports) > 0
    # A guide at rest does no work.
    assert max(abs(r.reactions[1].work) for r in reports) < 1e-12
