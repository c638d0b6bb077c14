"""Integrals of shape functions over facets, compared with forms of DOLFINx."""

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, la
from dolfinx.mesh import (
    CellType,
    create_mesh,
    create_unit_cube,
    create_unit_square,
    locate_entities_boundary,
    meshtags,
)

import dolfinx_nts as nts
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.facet_integrals import shape_integrals
from dolfinx_nts.fem.few_nodes import sums_at

# Dimension of the facets of each cell.
DIMENSIONS = {"triangle": 1, "quadrilateral": 1, "tetrahedron": 2, "hexahedron": 2}
cells_ = pytest.mark.parametrize("cell", DIMENSIONS)


def straight(comm, cell):
    """A sheared mesh with plane facets."""
    dim = DIMENSIONS[cell]
    create = create_unit_square if dim == 1 else create_unit_cube
    mesh = create(comm, *(3, 2, 2)[: dim + 1], CellType[cell])
    mesh.geometry.x[:, 0] += 0.2 + 0.3 * mesh.geometry.x[:, 1]
    return mesh


def curved(comm, cell):
    """A mesh with cells of second order, on one rank."""
    dim = DIMENSIONS[cell] + 1
    V = fem.functionspace(straight(comm, cell), ("Lagrange", 2))
    x = V.tabulate_dof_coordinates()[:, :dim]
    x += 0.1 * np.sin(2 * x[:, ::-1])
    element = basix.ufl.element("Lagrange", cell, 2, shape=(dim,))
    return create_mesh(comm, V.dofmap.list.astype(np.int64), x, element)


def difference(V):
    """Largest deviation from a form over the facets above y = 0.5, relative to its maximum."""
    mesh, dim = V.mesh, V.mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    mesh.topology.create_connectivity(dim, dim - 1)
    facets = locate_entities_boundary(mesh, dim - 1, lambda x: x[1] > 0.5)
    tags = meshtags(mesh, dim - 1, facets, np.ones_like(facets))
    radius = 2 * np.pi * ufl.SpatialCoordinate(mesh)[0] if is_axisymmetric(mesh) else 1.0
    ds = ufl.Measure("ds", mesh, subdomain_data=tags, metadata={"quadrature_degree": 10})
    vector = fem.assemble_vector(fem.form(radius * ufl.TestFunction(V)[0] * ds(1)))
    vector.scatter_reverse(la.InsertMode.add)
    nodes, values = shape_integrals(V, facets)
    wanted = np.arange(V.dofmap.index_map.size_local, dtype=np.int32)
    found = sums_at(V, wanted, nodes.ravel(), values.reshape(-1, 1))[:, 0]
    expected = vector.array.reshape(-1, dim)[: len(wanted), 0]
    largest = V.mesh.comm.allreduce(float(np.abs(expected).max(initial=0.0)), max)
    return float(np.abs(found - expected).max(initial=0.0)) / largest


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(
    ("cell", "revolved"),
    [*((cell, False) for cell in DIMENSIONS), ("triangle", True), ("quadrilateral", True)],
)
def test_integrals_over_plane_facets_are_exact(comm, agree, cell, degree, revolved):
    mesh = straight(comm, cell)
    if revolved:
        nts.axisymmetric(mesh)
    V = fem.functionspace(mesh, ("Lagrange", degree, (mesh.topology.dim,)))
    assert agree(difference(V) < 1e-12)


@pytest.mark.serial
@cells_
def test_integrals_over_curved_facets_are_accurate(comm, cell):
    mesh = curved(comm, cell)
    V = fem.functionspace(mesh, ("Lagrange", 2, (mesh.topology.dim,)))
    assert difference(V) < 1e-4
