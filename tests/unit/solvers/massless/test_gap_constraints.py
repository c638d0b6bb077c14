"""Projection of nodal vectors on active gap and slip constraints, by dense least squares."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem, mesh

from dolfinx_nts.search.scatter import NodalScatter
from dolfinx_nts.solvers.massless.gap_constraints import GapConstraints, PairConstraints

pytestmark = pytest.mark.serial

NUM_ROWS, NODES_A_ROW = 7, 3


@pytest.fixture
def rows(rng):
    """Scatter, stiffness, free dofs, and gradients by nodes, of which a third is fixed."""
    V = fem.functionspace(mesh.create_unit_cube(MPI.COMM_SELF, 2, 2, 2), ("Lagrange", 1, (3,)))
    scatter = NodalScatter(V.dofmap.index_map)
    n = scatter.num_local
    free = (rng.random((n, 3)) < 0.8).astype(float)
    free[rng.choice(n, n // 3, replace=False)] = 0
    dofs = np.array([rng.choice(n, NODES_A_ROW, replace=False) for _ in range(NUM_ROWS)])
    dofs = dofs.astype(np.int32)
    gradient = rng.standard_normal((NUM_ROWS, NODES_A_ROW, 3))
    return scatter, rng.uniform(1, 9, (n, 1)), free, dofs, gradient


def dense(dofs, gradient, free):
    """Rows over all dofs, zero where these are not free."""
    G = np.zeros((len(dofs), *free.shape))
    for row, nodes, part in zip(G, dofs, gradient, strict=True):
        np.add.at(row, nodes, part)
    return (G * free).reshape(len(dofs), -1)


def moving(free):
    """Free nodes, in the order of the projected nodal vectors."""
    return np.flatnonzero(free.any(axis=1)).astype(np.int32)


def held(rows, travel, friction=0.0, repeat=1):
    """Make the constraints with given multiplicities, half of them in another pair."""
    scatter, stiffness, free, dofs, gradient = rows
    order = np.tile(np.arange(NUM_ROWS), repeat)
    force = (gradient + friction).reshape(NUM_ROWS, -1)
    holds = [
        PairConstraints(scatter, dofs[i], gradient.reshape(NUM_ROWS, -1)[i], force[i], travel[i])
        for i in np.split(order, [3])
    ]
    nodes = moving(free)
    return GapConstraints(MPI.COMM_SELF, holds, nodes, free[nodes], stiffness[nodes])


@pytest.mark.parametrize("repeat", [1, 2])
def test_shortest_increments_close_gaps_that_may_come_twice(rows, rng, repeat):
    _, stiffness, free, dofs, gradient = rows
    travel = rng.standard_normal(NUM_ROWS)
    x = held(rows, travel, repeat=repeat).shortest()
    root = np.sqrt(np.broadcast_to(stiffness, free.shape)).ravel()
    exact = np.linalg.pinv(dense(dofs, gradient, free) / root) @ travel / root
    exact = exact.reshape(-1, 3)
    assert x == pytest.approx(exact[moving(free)], abs=1e-10 * np.abs(exact).max())


@pytest.mark.parametrize("friction", [0.0, 0.02])
def test_projected_forces_keep_gaps(rows, rng, friction):
    _, stiffness, free, dofs, gradient = rows
    constraints = held(rows, np.zeros(NUM_ROWS), friction)
    nodes = moving(free)
    forces = rng.standard_normal((len(nodes), 3))
    left = constraints.project(forces.copy())
    of_nodes = (dense(dofs, part, free) for part in (gradient, gradient + friction))
    G, C = (part.reshape(NUM_ROWS, -1, 3)[:, nodes].reshape(NUM_ROWS, -1) for part in of_nodes)
    size = np.abs(forces).max()
    assert np.abs(G @ (left / stiffness[nodes]).ravel()).max() <= 1e-6 * size
    # The removed part of the forces is constraint forces.
    taken = (forces - left).ravel()
    assert C.T @ np.linalg.lstsq(C.T, taken)[0] == pytest.approx(taken, abs=1e-10 * size)
    assert constraints.slides == (friction != 0)
