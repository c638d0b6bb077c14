"""Residual and tangent of the bodies, of which some nodes alone move."""

from mpi4py import MPI

import numpy as np
import pytest

from helpers import scenes


def test_some_nodes_move_as_if_all_others_were_held(comm, rng, agree):
    stepper = scenes.blocks(comm).stepper
    bulk, V = stepper._bulk, stepper.u.function_space
    x = V.tabulate_dof_coordinates()
    stepper.u.x.array[:] = 0.01 * np.sin(7 * np.column_stack([x[:, 1], x[:, 2], x[:, 0]])).ravel()
    nodes = x[:, 2] > comm.allreduce(x[:, 2].max(), op=MPI.MAX) - 1e-6  # those of a face
    own = nodes[: bulk.num_owned // 3]
    y = 1e-3 * rng.standard_normal((len(own), 3))
    forces, of_all = bulk.forces().reshape(-1, 3), bulk.action(y)
    expected, num_cells = bulk.action(np.where(own[:, None], y, 0.0)), bulk.num_cells
    with bulk.only(nodes):
        assert comm.allreduce(bulk.num_cells) < comm.allreduce(num_cells)
        same = bulk.forces().reshape(-1, 3)[own]
        scale = comm.allreduce(np.abs(forces).max(initial=0.0), op=MPI.MAX)
        assert agree(same == pytest.approx(forces[own], abs=1e-14 * scale))
        moved, scale = bulk.action(y), np.abs(of_all).max(initial=0.0)
        assert agree(moved[own] == pytest.approx(expected[own], abs=1e-13 * scale))
        assert agree(np.array_equal(moved[~own], y[~own]))
    assert bulk.num_cells == num_cells
    assert agree(np.array_equal(bulk.action(y), of_all))


def test_cells_that_are_left_out_stay_so(comm, agree):
    stepper = scenes.blocks(comm).stepper
    bulk, (sleeping, moving) = stepper._bulk, stepper.bodies
    left_out = [some[some < end] for some, end in _owned(bulk, sleeping)]
    bulk.leave_out(*left_out)
    num_cells, given = bulk.num_cells, bulk.given.copy()
    nodes = np.ones(len(stepper.u.x.array) // 3, dtype=bool)
    with bulk.only(nodes):
        assert agree(bulk.num_cells == num_cells and np.array_equal(bulk.given, given))
    assert agree(bulk.num_cells == num_cells and np.array_equal(bulk.given, given))
    assert comm.allreduce(num_cells) == comm.allreduce(len(_owned(bulk, moving)[0][0]))


def _owned(bulk, body):
    """Cells and nodes of a body, and the numbers of those that this rank owns."""
    cells = bulk.u.function_space.mesh.topology.index_map(3).size_local
    return (body.cells, cells), (body.nodes, bulk.num_owned // 3)
