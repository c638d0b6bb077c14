"""Fixtures of the tests of solvers."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc

from dolfinx_nts.solvers.linear.block_csr import BlockCSR
from helpers.models import box_meshes


@pytest.fixture
def matrices(comm):
    """Rows of a matrix that is not symmetric, and all of it, dense."""
    data = box_meshes.boxes([(2, 3, 2)], [(1.2, 1.0, 0.5)], "tetrahedron")
    mesh, *_ = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
    form = fem.form(
        (ufl.inner(ufl.grad(u) * x, v) + (1 + x[0]) * ufl.inner(ufl.grad(u), ufl.grad(v))) * ufl.dx
    )
    csr = fem.create_matrix(form)
    fem.assemble_matrix(csr, form)
    csr.scatter_reverse()
    A = fem_petsc.assemble_matrix(form)
    A.assemble()
    indptr, columns, values = A.getValuesCSR()
    size = A.getSize()[0]
    mine = np.zeros((len(indptr) - 1, size))
    mine[np.repeat(np.arange(len(mine)), np.diff(indptr)), columns] = values
    A.destroy()
    return BlockCSR(csr), np.concatenate(comm.allgather(mine)), form
