"""Packed forms against the assembly of DOLFINx, which packs all functions anew."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

import dolfinx_nts as nts
import scenes
from dolfinx_nts.bodies import bulk_form
from dolfinx_nts.forms import CellForm, packed

SPACES = [("hexahedron", 1), ("tetrahedron", 1), ("hexahedron", 2), ("tetrahedron", 2)]


class Case:
    """Two bodies of two materials, one with fibres; their virtual work."""

    def __init__(self, comm, cell="hexahedron", degree=1):
        """Build both bodies and fill the functions."""
        data = scenes.boxes([(3, 2, 2), (2, 2, 3)], [(1.2, 1.0, 0.5), (1.0, 1.0, 1.0)], cell=cell)
        mesh, cells, _, tag = scenes.distribute(comm, data)
        self.V = V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        self.u, self.u_n, self.direction = (fem.Function(V) for _ in range(3))
        self.fibre = fem.Function(fem.functionspace(mesh, ("Discontinuous Lagrange", 0, (3,))))
        self.fill = np.random.default_rng(comm.rank).normal

        def psi(C, mu):
            return mu * (ufl.tr(C) + ufl.inner(self.fibre, C * self.fibre) ** 2)

        one_point = {"one_point": ["lmbda"]} if degree == 1 else {}
        materials = [
            nts.SaintVenantKirchhoff(E=2.0, nu=0.3, rho=1.0, **one_point),
            nts.Hyperelastic(psi, rho=2.0, mu=3.0),
        ]
        self.bodies = [nts.Body(V, cells, tag[f"body {i}"], law) for i, law in enumerate(materials)]
        for function in self.functions:
            self.change(function)

    @property
    def functions(self):
        return [self.u, self.u_n, self.direction, self.fibre]

    def change(self, function):
        function.x.array[:] = self.fill(size=len(function.x.array))

    def action(self):
        """Derivative of a work that the mass shares, along the direction."""
        F = ufl.Identity(3) + ufl.grad((self.u + self.u_n) / 2)
        eta = ufl.TestFunction(self.V)

        def work(material, parameters, rho):
            P = F * material.stress(F.T * F, **parameters)
            return ufl.inner(P, ufl.grad(eta)) + rho * ufl.dot(self.u, eta)

        form = bulk_form(self.bodies, work)
        return expand_derivatives(ufl.derivative(form, self.u, self.direction))


def assert_same(form, reference):
    """Both add the same to a vector, to the last bit."""
    given = np.ones(len(fem.assemble_vector(reference).array))
    expected = given.copy()
    form.assemble(given)
    fem.assemble_vector(expected, reference)
    np.testing.assert_array_equal(given, expected)


@pytest.mark.parametrize(("cell", "degree"), SPACES)
def test_changed_functions_are_seen_and_only_those_of_other_spaces_cost(comm, cell, degree):
    case = Case(comm, cell, degree)
    form = CellForm(case.action()).everywhere
    assert_same(form, form._form)
    for function in (*case.functions[:3], None, case.direction):
        if function is not None:
            case.change(function)
        assert_same(form, form._form)
    assert form.num_packed == 1
    case.change(case.fibre)
    case.change(case.u)
    assert_same(form, form._form)
    assert form.num_packed == 2


def test_on_a_part_of_the_cells(comm):
    case = Case(comm)
    cell_form = CellForm(case.action())
    for left_out in (case.bodies[0].cells, case.bodies[1].cells[::2]):
        form = cell_form.without(left_out)
        for function in case.functions:
            assert_same(form, form._form)
            case.change(function)
        assert_same(form, form._form)


def test_form_over_facets_is_packed_by_dolfinx(comm):
    case = Case(comm)
    form = packed(ufl.inner(case.u, ufl.TestFunction(case.V)) * ufl.ds)
    for count in (1, 1, 2):
        if count == 2:
            case.change(case.u)
        assert_same(form, form._form)
        assert form.num_packed == count


def test_form_without_functions(comm):
    case = Case(comm)
    form = packed(ufl.TestFunction(case.V)[0] * ufl.dx(domain=case.V.mesh))
    assert_same(form, form._form)
