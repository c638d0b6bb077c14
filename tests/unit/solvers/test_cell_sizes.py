"""Sizes of cells, against a box whose cells have known edges."""

import numpy as np
import pytest
from dolfinx import fem

from dolfinx_nts.solvers.cell_sizes import cell_sizes
from helpers.models import box_meshes

pytestmark = pytest.mark.at_most_two_ranks


@pytest.mark.parametrize("degree", [1, 2])
def test_nodes_have_the_size_of_their_largest_cell(comm, agree, degree):
    data = box_meshes.boxes([(3, 1, 1)], [(3.0, 1.0, 1.0)])
    data.X[data.X[:, 0] == 3.0, 0] = 5.0  # the last cell has an edge of 3
    mesh, *_ = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    sizes = cell_sizes(V)
    x = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local, 0]
    assert np.isclose(sizes.smallest, np.sqrt(3))
    assert agree(np.allclose(sizes.nodal, np.where(x > 1.99, np.sqrt(11), np.sqrt(3))))
