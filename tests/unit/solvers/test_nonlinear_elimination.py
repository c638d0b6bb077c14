"""Nonlinear elimination in the contact subdomain: fewer Newton iterations, the same solution."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_nts as nts
from benchmarks.scenes import ball_on_plate
from dolfinx_nts.solvers import nonlinear_elimination
from helpers import scenes
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

STEP, FIRST, LAST = 0.02, 0.05, 0.15  # [s]: contact begins in the fourth step


def impact(comm, scheme="EM elastic", mu=0.0):
    """A ball and a plate, whose nodes move up to a sixth of a cell in a step."""
    friction = nts.Coulomb(mu) if mu else None
    scene = ball_on_plate(comm, scheme, STEP, n=12, friction=friction, element="full")
    return scene.stepper


def run(stepper, until=LAST):
    """Iterations of the steps after the first."""
    reports = list(stepper.run(until))
    return [report.newton_iterations for report in reports if report.t > FIRST]


@pytest.mark.parametrize("mu", [once(0.0), 0.3])
@pytest.mark.parametrize("scheme", ["EM elastic", "EM mortar"])
def test_impact_nodes_converge_without_global_iterations(comm, agree, scheme, mu):
    stepper, usual = (impact(comm, scheme, mu) for _ in range(2))
    solver = usual._step_solver
    solver._system = replace(solver._system, elimination=None)
    iterations, without = run(stepper), run(usual)
    assert agree(sum(iterations) <= sum(without) - len(without) // 2)
    work, usual_work = (some.statistics.solver for some in (stepper, usual))
    assert work.num_local_iterations > usual_work.num_local_iterations == 0
    assert work.num_iterations < usual_work.num_iterations
    assert _squares(stepper) == pytest.approx(_squares(usual), rel=1e-10)


def _squares(stepper):
    """Squares of the displacements, the velocities and the momenta of all nodes."""
    comm, n = stepper.u.function_space.mesh.comm, 3 * len(stepper.node_ids)
    fields = stepper.u.x.array[:n], stepper.v.x.array[:n], stepper.nodal_momentum().ravel()
    return [comm.allreduce(float(values @ values)) for values in fields]


@pytest.mark.serial  # The partition of the mesh varies.
def test_a_resumed_run_has_the_same_digits(comm, agree, folder):
    whole, *parts = (impact(comm) for _ in range(3))
    run(whole)
    for stepper, until in zip(parts, (0.1, LAST), strict=True):
        options = {"checkpoint_every": 1, "resume": True}
        with nts.Recorder(folder / "impact", stepper, **options) as recorder:
            for step in stepper.run(until):
                recorder.write(step)
    assert agree(np.array_equal(stepper.u.x.array, whole.u.x.array))
    assert whole.statistics.solver.num_local_iterations > 0


def test_bodies_that_rest_on_each_other_do_not_move_first(comm):
    """Nor do those whose contact reaches a good part of all nodes."""
    scene = ball_on_plate(comm, "EM elastic", 0.005, n=6, E=1e7, element="full")
    list(scene.stepper.run(0.1))
    assert scene.stepper.statistics.solver.num_local_iterations == 0


def test_some_nodes_are_solved_with_all_others_clamped(comm, rng, agree):
    stepper = scenes.blocks(comm).stepper
    bulk, V = stepper._bulk, stepper.u.function_space
    x = V.tabulate_dof_coordinates()
    stepper.u.x.array[:] = 0.01 * np.sin(7 * np.column_stack([x[:, 1], x[:, 2], x[:, 0]])).ravel()
    nodes = x[:, 2] > comm.allreduce(x[:, 2].max(), op=MPI.MAX) - 1e-6  # nodes of a face
    own = nodes[: bulk.num_owned // 3]
    y = 1e-3 * rng.standard_normal((len(own), 3))
    forces, of_all = bulk.forces().reshape(-1, 3), bulk.action(y)
    expected, num_cells = bulk.action(np.where(own[:, None], y, 0.0)), bulk.num_cells
    with nonlinear_elimination._others_clamped(bulk, nodes):
        assert comm.allreduce(bulk.num_cells) < comm.allreduce(num_cells)
        same = bulk.forces().reshape(-1, 3)[own]
        scale = comm.allreduce(np.abs(forces).max(initial=0.0), op=MPI.MAX)
        assert agree(same == pytest.approx(forces[own], abs=1e-14 * scale))
        moved, scale = bulk.action(y), np.abs(of_all).max(initial=0.0)
        assert agree(moved[own] == pytest.approx(expected[own], abs=1e-13 * scale))
        assert agree(np.array_equal(moved[~own], y[~own]))
    assert bulk.num_cells == num_cells
    assert agree(np.array_equal(bulk.action(y), of_all))
    assert agree(np.array_equal(bulk.forces().reshape(-1, 3), forces))
