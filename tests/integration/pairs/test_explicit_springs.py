"""Default springs of explicit steps under loads above those of plane waves."""

import logging

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import meshing

E, DENSITY = 1e6, 1e3


def block(comm, plates, num_cells=4):
    """A block of unit size without lateral strain, and default pairs with plates."""

    def build(model):
        cells = (num_cells, num_cells)
        meshing.add_rectangle(model, "block", corner=(0.0, 0.0), size=(1.0, 1.0), cells=cells)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    body = nts.Body(V, cells, tag["block"], nts.NeoHookean(E, 0.0, DENSITY))
    return body, nts.all_pairs([body], obstacles=plates)


def pressed(comm, part):
    """Relative error of the force on a block that two plates press in 60 transit times."""
    strain, until = 0.05, 60 / np.sqrt(E / DENSITY)
    top = nts.RigidPlane((0.0, 1.0), (0.0, -1.0), name="top")
    top = top.moving(nts.Motion(translation=lambda t: (0.0, -strain * t / until)))
    floor = nts.RigidPlane((0.0, 0.0), (0.0, 1.0), name="floor")
    body, pairs = block(comm, [top, floor])
    stable = nts.CentralDifference([body], pairs).stable_step
    stepper = nts.CentralDifference([body], pairs, dt=part * stable)
    diagnostics, errors = nts.Diagnostics(stepper), []
    for step in stepper.run(until=until):
        if step.t > 0.75 * until:
            stretch = 1 - strain * step.t / until
            exact = E / 2 * (1 / stretch - stretch)
            errors.append(diagnostics.obstacles()["top"].force[1] / exact - 1)
    return np.mean(errors)


def test_slowly_pressed_blocks_are_reported_and_stiffer_in_shorter_steps(comm, caplog):
    with caplog.at_level(logging.WARNING, "dolfinx_nts"):
        default, shorter = (pressed(comm, part) for part in (0.77, 0.4))
    assert -0.38 < default < shorter < -0.1
    if comm.rank == 0:
        fractions = [int(r.args[0]) for r in caplog.records if "elastic energy" in r.msg]
        np.testing.assert_allclose(fractions, [-100 * default, -100 * shorter], atol=4)


def test_energy_of_springs_of_two_stiffnesses_returns(comm):
    floor = nts.RigidPlane((0.0, -1e-3), (0.0, 1.0), name="floor")
    body, pairs = block(comm, [floor])
    weight = nts.Gravity(body, (0.0, -9.81))
    stepper = nts.CentralDifference([body], pairs, loads=[weight])
    stepper.dt = 0.25 * stepper.stable_step
    diagnostics = nts.Diagnostics(stepper)
    totals, works, depths, compressions = [], [], [], []
    for step in stepper.run(until=0.3):
        balance, history = diagnostics.balance(), stepper.contacts[0].history
        works.append(sum(step.load_works))
        totals.append(balance.total_energy)
        known = history.active & np.isfinite(history.soft_depth)
        depths.append(history.soft_depth[known].max(initial=0.0))
        compressions.append(-history.gap[known].min(initial=0.0))
    if comm.size == 1:
        assert max(compressions) > 1.2 * max(depths) > 0
    works = np.cumsum(works)
    np.testing.assert_allclose(totals, works, atol=5e-3 * max(works))


def test_small_cells_of_a_rigid_body_do_not_limit_the_motion_in_a_step(comm):
    def build(model):
        size, cells = (1.0, 1.0), (4, 4)
        meshing.add_rectangle(model, "block", corner=(0.0, 0.1), size=size, cells=cells)
        size, cells = (1.0, 0.02), (50, 1)
        meshing.add_rectangle(model, "sheet", corner=(3.0, 0.0), size=size, cells=cells)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    fast = nts.Body(V, cells, tag["block"], nts.NeoHookean(E, 0.0, DENSITY))
    sheet = nts.RigidBody(V, cells, tag["sheet"], 7.8e3, guide=nts.Guide())
    stepper = nts.CentralDifference([fast, sheet], [])
    speed = 0.04 / stepper.dt
    stepper.set_velocity(fast, (0.0, speed))
    stepper.advance()
    height = nts.Diagnostics(stepper).centre_of_mass(fast)[1]
    assert height == pytest.approx(0.6 + speed * stepper.dt)
