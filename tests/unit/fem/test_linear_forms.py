"""Forms over cells against the assembly of DOLFINx."""

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import cpp, fem
from ufl.algorithms import expand_derivatives

import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.fem.components import deformation_gradient
from dolfinx_nts.fem.jit import compile_form
from dolfinx_nts.fem.linear_forms import CellForm, PackedForm
from dolfinx_nts.materials.hyperelastic import right_cauchy_green
from dolfinx_nts.model.bodies import bulk_form
from helpers.models import box_meshes

ROUNDING = 1e-14
SPACES = [("hexahedron", 1), ("tetrahedron", 1), ("hexahedron", 2), ("tetrahedron", 2)]


class Case:
    """Two bodies of two materials, one with fibres; their virtual work."""

    def __init__(self, comm, cell="hexahedron", degree=1):
        """Build both bodies and fill the functions."""
        data = box_meshes.boxes(
            [(3, 2, 2), (2, 2, 3)], [(1.2, 1.0, 0.5), (1.0, 1.0, 1.0)], cell=cell
        )
        mesh, cells, _, tag = box_meshes.distribute(comm, data)
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
        """Derivative of the virtual work with a mass term, along the direction."""
        F = ufl.Identity(3) + ufl.grad((self.u + self.u_n) / 2)
        eta = ufl.TestFunction(self.V)

        def work(material, parameters, rho):
            P = F * material.stress(F.T * F, **parameters)
            return ufl.inner(P, ufl.grad(eta)) + rho * ufl.dot(self.u, eta)

        form = bulk_form(self.bodies, work)
        return expand_derivatives(ufl.derivative(form, self.u, self.direction))


@pytest.fixture
def packings(monkeypatch):
    """Forms whose functions DOLFINx has packed for the package."""
    pack, forms = cpp.fem.pack_coefficients, []

    def counted(form):
        forms.append(form)
        return pack(form)

    monkeypatch.setattr(cpp.fem, "pack_coefficients", counted)
    return forms


def assert_same(form, reference, rounding=ROUNDING):
    """Both add the same to a vector, up to rounding."""
    given = np.ones(len(fem.assemble_vector(reference).array))
    expected = given.copy()
    form.assemble(given)
    fem.assemble_vector(expected, reference)
    assert abs(given - expected).max() <= rounding * abs(expected).max()


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(("cell", "degree"), SPACES)
def test_values_of_functions_are_read_at_assembly(comm, cell, degree):
    case = Case(comm, cell, degree)
    work = case.action()
    form, reference = CellForm(work), compile_form(work)
    assert_same(form, reference)
    for function in case.functions:
        case.change(function)
        assert_same(form, reference)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(("cell", "degree"), [("hexahedron", 1), ("tetrahedron", 2)])
def test_an_argument_constant_in_cells_gives_cell_integrals(comm, cell, degree):
    case = Case(comm, cell, degree)
    W = fem.functionspace(case.V.mesh, ("Discontinuous Lagrange", 0, (2,)))
    first, second = ufl.TestFunction(W)
    F, F_n = (ufl.Identity(3) + ufl.grad(f) for f in (case.u, case.u_n))

    def energies(material, parameters, rho):
        psi, psi_n = (material.psi(G.T * G, **parameters) for G in (F, F_n))
        return first * psi + second * (psi - psi_n)

    form = bulk_form(case.bodies, energies)
    assert_same(CellForm(form, V=case.V), compile_form(form), rounding=10 * ROUNDING)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(("cell", "degree"), SPACES)
def test_single_precision_where_it_is_enough(comm, cell, degree):
    work = Case(comm, cell, degree).action()
    single, double = CellForm(work, "single"), CellForm(work)
    assert_same(single, compile_form(work), rounding=1e-5)
    given, expected = np.zeros((2, len(fem.Function(Case(comm, cell, degree).V).x.array)))
    single.assemble(given)
    double.assemble(expected)
    assert not np.array_equal(given, expected)


@pytest.mark.at_most_two_ranks
def test_values_of_constants_are_read_at_assembly(comm):
    case = Case(comm)
    work = case.action()
    form, reference = CellForm(work), compile_form(work)
    for constant in work.constants():
        constant.value *= 1.5
        assert_same(form, reference)


@pytest.mark.at_most_two_ranks
def test_only_functions_of_other_spaces_are_packed_and_only_if_they_changed(comm, packings):
    case = Case(comm)
    form = CellForm(case.action())
    b = np.zeros(3 * len(case.V.tabulate_dof_coordinates()))
    for function, count in ((case.u, 1), (case.fibre, 2), (case.direction, 2), (case.fibre, 3)):
        case.change(function)
        form.assemble(b)
        assert len(packings) == count


@pytest.mark.at_most_two_ranks
def test_parts_of_the_cells_add_up(comm):
    case = Case(comm)
    form = CellForm(case.action())
    cells = np.concatenate([body.cells for body in case.bodies])
    parts = np.zeros((3, 3 * len(case.V.tabulate_dof_coordinates())))
    for part, left_out in zip(parts, (cells[::2], cells[1::2], cells[:0]), strict=True):
        form.leave_out(left_out)
        form.assemble(part)
    np.testing.assert_allclose(parts[0] + parts[1], parts[2], rtol=1e-12, atol=1e-12)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(("cell", "degree"), SPACES)
def test_numbers_behind_a_vector_are_summed_in_the_same_pass(comm, cell, degree):
    case = Case(comm, cell, degree)
    V, C = case.V, right_cauchy_green(deformation_gradient(case.u))
    number = basix.ufl.element("DG", V.mesh.basix_cell(), 0)
    W = fem.functionspace(V.mesh, basix.ufl.mixed_element([V.ufl_element(), number]))
    eta, of_energy = ufl.TestFunctions(W)

    def force(eta, material, parameters):
        return ufl.inner(material.stress(C, **parameters), ufl.grad(eta))

    def energy(material, parameters, rho):
        return material.psi(C, **parameters)

    def both(material, parameters, rho):
        return force(eta, material, parameters) + of_energy * energy(material, parameters, rho)

    test_function = ufl.TestFunction(V)
    forces = bulk_form(case.bodies, lambda law, some, rho: force(test_function, law, some))
    form, alone = CellForm(bulk_form(case.bodies, both), V=V, num_sums=1), CellForm(forces)
    energies = compile_form(bulk_form(case.bodies, energy))
    for _ in range(2):  # sums belong to the last assembly
        values, expected = np.zeros((2, len(case.u.x.array)))
        form.assemble(values)
        alone.assemble(expected)
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-13 * abs(expected).max())
        np.testing.assert_allclose(form.sums, fem.assemble_scalar(energies), rtol=1e-13)


@pytest.mark.at_most_two_ranks
def test_functions_on_facets_are_packed_if_one_changed(comm, packings):
    case = Case(comm)
    work = ufl.inner(case.u, ufl.TestFunction(case.V)) * ufl.ds
    form, reference = PackedForm(work), compile_form(work)
    assert_same(form, reference)
    assert_same(form, reference)
    assert len(packings) == 1
    case.change(case.u)
    assert_same(form, reference)
    assert len(packings) == 2


@pytest.mark.at_most_two_ranks
def test_form_without_functions(comm):
    case = Case(comm)
    work = ufl.TestFunction(case.V)[0] * ufl.dx(domain=case.V.mesh)
    assert_same(PackedForm(work), compile_form(work))


@pytest.mark.serial
def test_kernel_refuses_arrays_of_wrong_shape():
    nodes = np.array([[0, 1, 2, 3]], dtype=np.int32)
    X, values = np.zeros((4, 3)), np.zeros(12)
    for kernel in (_kernels.ElementKernel, _kernels.BatchKernel):
        with pytest.raises(ValueError, match="expected a function, given 0"):
            kernel(0, *([False] if kernel is _kernels.ElementKernel else [8, False]))
    with pytest.raises(ValueError, match="expected 2, 4, 8 or 16"):
        _kernels.BatchKernel(1, 3, False)
    good = {
        "kernels": [_kernels.ElementKernel(1, False)],
        "X": X,
        "vertices": nodes,
        "nodes": nodes,
        "functions": [values],
        "first": [0],
        "constants": [],
        "places": np.empty(0, dtype=np.int32),
        "width": 12,
        "components": 3,
        "rows": nodes,
        "length": 3,
    }
    integral = _kernels.CellIntegral(**good)
    for wrong, message in (
        ({"kernels": []}, "at least one"),
        ({"kernels": [_kernels.BatchKernel(1, n, False) for n in (4, 8)]}, "equal lanes"),
        ({"places": np.array([12], dtype=np.int32)}, "less than width"),
        ({"X": X[:3]}, "row numbers of X"),
        ({"nodes": np.repeat(nodes, 2, axis=0)}, "nodes: expected shape"),
        ({"nodes": nodes - 1}, "nodes: expected no negative entry"),
        ({"rows": nodes - 1}, "rows: expected no negative entry"),
        ({"rows": np.repeat(nodes, 2, axis=0)}, "rows: expected shape"),
        ({"functions": [values[:9]]}, "the values of all nodes"),
        ({"first": [1]}, "values of each function within width"),
        ({"first": []}, "one index for each function"),
    ):
        with pytest.raises(ValueError, match=message):
            _kernels.CellIntegral(**good | wrong)
    # A copy would keep the former values.
    for name in ("functions", "constants"):
        with pytest.raises(TypeError):
            _kernels.CellIntegral(**good | {name: [values[::-1]]})
    none, nothing = np.empty(0, dtype=np.int32), np.empty((1, 0))
    with pytest.raises(ValueError, match="numbers of cells"):
        integral.add(np.array([1], dtype=np.int32), nothing, values, np.empty(0))
    with pytest.raises(ValueError, match="packed: expected shape"):
        integral.add(none, np.zeros((1, 12)), values, np.empty(0))
    with pytest.raises(ValueError, match="the values of all nodes"):
        integral.add(none, nothing, values[:9], np.empty(0))
