"""Bilinear forms over cells against the assembly of DOLFINx with FFCx's kernels."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

import dolfinx_nts as nts
from dolfinx_nts.fem.bilinear_forms import CellMatrix
from dolfinx_nts.fem.jit import compile_bilinear_form
from dolfinx_nts.model.bodies import bulk_form
from helpers.models import box_meshes

pytestmark = pytest.mark.at_most_two_ranks

SPACES = [("hexahedron", 1), ("tetrahedron", 1), ("hexahedron", 2), ("tetrahedron", 2)]


def tangent(comm, cell, degree):
    """Functions, and a form with them of two laws, one with fibres, that is not symmetric."""
    data = box_meshes.boxes([(3, 2, 2), (2, 1, 3)], [(1.2, 1.0, 0.5), (1.0, 1.0, 1.0)], cell=cell)
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    u = fem.Function(V)
    fibre = fem.Function(fem.functionspace(mesh, ("Discontinuous Lagrange", 0, (3,))))
    for number, function in enumerate((u, fibre)):
        random = np.random.default_rng(comm.rank + 10 * number)
        function.x.array[:] = 0.1 * random.normal(size=len(function.x.array))
        function.x.scatter_forward()

    def psi(C, mu):
        return mu * (ufl.tr(C) + ufl.inner(fibre, C * fibre) ** 2)

    one_point = {"one_point": ["lmbda"]} if degree == 1 else {}
    laws = (
        nts.SaintVenantKirchhoff(E=2.0, nu=0.3, rho=1.0, **one_point),
        nts.Hyperelastic(psi, rho=2.0, mu=3.0),
    )
    bodies = [nts.Body(V, cells, tag[f"body {i}"], law) for i, law in enumerate(laws)]
    F, eta = ufl.Identity(3) + ufl.grad(u), ufl.TestFunction(V)

    def work(material, parameters, rho):
        P = F * material.stress(F.T * F, **parameters)
        return ufl.inner(P, ufl.grad(eta)) + rho * u[0] * ufl.dot(u, eta)

    form = ufl.derivative(bulk_form(bodies, work), u, ufl.TrialFunction(V))
    return (u, fibre), expand_derivatives(form)


def assembled(form):
    matrix = fem.assemble_matrix(form)
    matrix.scatter_reverse()
    return matrix.data


def assert_same(matrix, reference):
    """Entries are the same up to rounding."""
    given, expected = assembled(matrix.compiled), assembled(reference)
    np.testing.assert_allclose(given, expected, rtol=0, atol=1e-13 * abs(expected).max())
    return expected


@pytest.mark.parametrize(("cell", "degree"), SPACES)
def test_values_of_functions_and_constants_are_read_at_assembly(comm, cell, degree):
    functions, form = tangent(comm, cell, degree)
    matrix, reference = CellMatrix(form), compile_bilinear_form(form)
    before = assert_same(matrix, reference)
    for value in [*(f.x.array for f in functions), *(c.value for c in form.constants())]:
        value *= 1.5
        after = assert_same(matrix, reference)
        assert comm.allreduce(abs(after - before).max()) > 0
        before = after


def test_without_a_compiler_of_vectors_kernels_agree_with_ffcx(comm, monkeypatch):
    _, form = tangent(comm, "hexahedron", 1)
    monkeypatch.setenv("CXX", "no-such-compiler")
    given = assembled(CellMatrix(form).compiled)
    np.testing.assert_array_equal(given, assembled(compile_bilinear_form(form)))
