"""Forces at some nodes, and their derivative, against the sums over all cells."""

import numpy as np

from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.massless.surface_forces import SurfaceForces
from helpers import scenes
from helpers.step_parts import step_forms


def test_cells_at_the_nodes_give_forces_and_products_of_all_cells(comm, agree):
    stepper = scenes.blocks(comm).stepper
    u, residual = stepper.u, step_forms(stepper).residual()
    u.x.array[:] = 0.01 * np.sin(7 * np.arange(len(u.x.array)))
    u.x.scatter_forward()
    n = u.function_space.dofmap.index_map.size_local
    z = u.function_space.tabulate_dof_coordinates()[:n, 2]
    nodes = np.flatnonzero(np.abs(z - z.max(initial=0.0)) < 0.1).astype(np.int32)
    fixed = 3 * nodes[::2]
    surface, bulk = SurfaceForces(residual, u, nodes, fixed), Bulk(residual, u, [])
    free = np.ones((n, 3))
    free.ravel()[fixed] = 0
    x = np.zeros((n, 3))
    x[nodes] = np.cos(np.arange(3 * len(nodes))).reshape(-1, 3)
    pairs = (
        (surface.at_nodes(), free * bulk.forces().reshape(-1, 3)),
        (surface.along(x[nodes]), free * bulk.action(free * x)),
    )
    for given, everywhere in pairs:
        size = np.abs(everywhere).max(initial=0.0)
        assert agree(np.abs(given - everywhere[nodes]).max(initial=0.0) <= 1e-12 * size)
    assert agree(np.array_equal(surface.free, free[nodes]))
