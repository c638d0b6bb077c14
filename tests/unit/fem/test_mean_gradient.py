"""Mean gradients in cells against their integrals with many points."""

import gc
import weakref

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, create_unit_square

from dolfinx_nts.fem.mean_gradient import with_mean_gradients
from helpers.models import box_meshes

pytestmark = pytest.mark.at_most_two_ranks

ROUNDING = 1e-13
# Exact for all products of gradients and volumes below.
MANY = {"quadrature_degree": 6}
ONE = {"quadrature_degree": 1}


def distorted(comm, cell, seed=2):
    """Space on cells with random vertices, numbered in any order, and random functions."""
    rng = np.random.default_rng(seed)
    if cell == "quadrilateral":
        mesh = create_unit_square(comm, 3, 4, CellType.quadrilateral)
    else:
        data = box_meshes.boxes([(3, 2, 2)], [(3.0, 2.0, 2.0)], cell).permuted(rng)
        mesh = box_meshes.distribute(comm, data)[0]
    dim = mesh.geometry.dim
    # By a wave, which does not depend on the partition.
    X = mesh.geometry.x
    X[:, :dim] += 0.2 * np.sin(3 * X[:, [1, 2, 0][:dim]] + 2 * X[:, :dim])
    V = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
    u, v = fem.Function(V), fem.Function(V)
    for number, f in enumerate((u, v)):
        f.interpolate(lambda x, k=number + 1: np.cos(k * x[:dim] + x[[1, 0, 2][:dim]] ** 2))
    return V, u, v


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron", "quadrilateral"])
def test_the_integral_of_a_gradient_is_exact(comm, cell):
    V, u, _ = distorted(comm, cell)
    dim = V.mesh.geometry.dim
    T = ufl.as_matrix(np.random.default_rng(5).normal(size=(dim, dim)).tolist())
    eta = ufl.TestFunction(V)
    for f in (u, eta):
        flux = ufl.inner(ufl.grad(f), T)
        given = with_mean_gradients(flux, V) * ufl.dx(V.mesh, metadata=ONE)
        exact = flux * ufl.dx(V.mesh, metadata=MANY)
        assemble = fem.assemble_scalar if f is u else lambda form: fem.assemble_vector(form).array
        values, expected = (assemble(fem.form(form)) for form in (given, exact))
        np.testing.assert_allclose(values, expected, atol=ROUNDING)


def test_a_function_of_the_gradient_sees_its_mean(comm):
    V, u, v = distorted(comm, "hexahedron")
    mesh = V.mesh
    # By cell, with a test function that is constant in each.
    cellwise = ufl.TestFunction(fem.functionspace(mesh, ("Discontinuous Lagrange", 0)))

    def by_cell(value, metadata):
        form = fem.form(value * cellwise * ufl.dx(mesh, metadata=metadata))
        return fem.assemble_vector(form).array

    volume = by_cell(ufl.as_ufl(1.0), MANY)
    entries = [ufl.grad(u - 2 * v)[i, j] for i in range(3) for j in range(3)]
    expected = sum((by_cell(entry, MANY) / volume) ** 3 for entry in entries) * volume
    cubes = sum(entry**3 for entry in entries)
    given = by_cell(with_mean_gradients(cubes, V), ONE)
    np.testing.assert_allclose(given, expected, rtol=1e-11)


def test_gradients_of_other_spaces_stay(comm):
    V, *_ = distorted(comm, "hexahedron")
    other = fem.Function(fem.functionspace(V.mesh, ("Lagrange", 1)))
    other.interpolate(lambda x: x[0] * x[1])
    value = other.dx(0)
    weight = with_mean_gradients(ufl.as_ufl(1.0), V)
    given, expected = (
        fem.assemble_scalar(fem.form(value * ufl.dx(V.mesh, metadata=ONE)))
        for value in (with_mean_gradients(value, V), weight * value)
    )
    assert given == pytest.approx(expected, rel=ROUNDING)


@pytest.mark.serial
def test_a_moved_mesh_is_evaluated_again_and_none_is_kept(comm):
    V, *_ = distorted(comm, "hexahedron")
    volumes = []
    for _ in range(2):
        one = with_mean_gradients(ufl.as_ufl(1.0), V) * ufl.dx(V.mesh, metadata=ONE)
        volumes.append(fem.assemble_scalar(fem.form(one)))
        V.mesh.geometry.x[:, 2] *= 1 + V.mesh.geometry.x[:, 0]
    assert volumes[1] > 1.5 * volumes[0]
    mesh = weakref.ref(V.mesh)
    del V, one, _
    gc.collect()
    assert mesh() is None
