"""Lumped mass: positive, with the mass and the centre of mass of the cells."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, la

import dolfinx_nts as nts
from dolfinx_nts.model.bodies import bulk_form
from dolfinx_nts.model.lumped_mass import lumped_mass
from helpers.models import box_meshes

ROUNDING = 1e-12

cells_ = pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])


def distorted(comm, rng, cell, degree):
    """Two bodies of distorted cells and of several densities."""
    data = box_meshes.boxes([(3, 2, 2), (1, 2, 1)], [(1.0, 0.8, 0.5), (0.4, 0.5, 0.3)], cell)
    data.X[:] += rng.uniform(-0.03, 0.03, size=data.X.shape)
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    laws = [nts.SaintVenantKirchhoff(10.0, 0.3, rho) for rho in (2.0, 5.0)]
    return V, [nts.Body(V, cells, tag[f"body {i}"], law) for i, law in enumerate(laws)]


@cells_
@pytest.mark.parametrize("degree", [1, 2])
def test_mass_and_centre_agree_with_all_bodies(comm, rng, cell, degree):
    V, bodies = distorted(comm, rng, cell, degree)
    mass = lumped_mass(bodies)
    assert comm.allreduce(int((mass <= 0).sum())) == 0
    x = ufl.SpatialCoordinate(V.mesh)
    X = V.tabulate_dof_coordinates()[: len(mass)]
    for weight, nodal in ((1.0, mass), *((x[i], mass * X[:, i]) for i in range(3))):
        form = fem.form(bulk_form(bodies, lambda m, p, rho, w=weight: rho * w))
        expected = comm.allreduce(fem.assemble_scalar(form))
        assert comm.allreduce(nodal.sum()) == pytest.approx(expected, rel=ROUNDING)


@pytest.mark.at_most_two_ranks
@cells_
def test_mass_of_degree_1_is_the_sum_of_the_rows(comm, rng, cell):
    V, bodies = distorted(comm, rng, cell, 1)
    eta = ufl.TestFunction(V)
    rows = fem.assemble_vector(fem.form(bulk_form(bodies, lambda m, p, rho: rho * sum(eta))))
    rows.scatter_reverse(la.InsertMode.add)
    mass = lumped_mass(bodies)
    np.testing.assert_allclose(rows.array.reshape(-1, 3)[: len(mass), 0], mass, rtol=ROUNDING)
