"""Materials that vary in space: moduli, default springs and stable steps of each cell."""

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.fem.jit import compile_quickly
from dolfinx_nts.integrators.explicit.stability import Cells
from dolfinx_nts.materials.evaluation import Evaluation
from dolfinx_nts.model.bodies import bulk_form
from dolfinx_nts.model.cell_moduli import CellModuli
from dolfinx_nts.model.layers import nodal_moduli
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.model.moduli import least_modulus
from helpers import scenes
from helpers.models.boxed import Box
from helpers.scene import gathered

pytestmark = pytest.mark.at_most_two_ranks

EPS = np.finfo(float).eps
SOFT, HARD = 1.0e3, 7.0e3
NU, RHO = 0.25, 10.0


def neo_hookean(E, **options):
    """Neo-Hookean energy with Young's modulus E [Pa], a number or UFL."""
    mu, lmbda = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))

    def psi(C):
        ln_J = ufl.ln(ufl.det(C)) / 2
        return mu / 2 * (ufl.tr(C) - 3 - 2 * ln_J) + lmbda / 2 * ln_J**2

    return nts.Hyperelastic(psi, rho=RHO, **options)


def unit_moduli():
    """Isotropic moduli of E = 1 Pa in the basis of `strain_basis`."""
    volume = np.array([1.0, 0, 0, 1, 0, 1])
    return np.eye(6) / (1 + NU) + NU / ((1 + NU) * (1 - 2 * NU)) * np.outer(volume, volume)


def field(mesh, values, element=("DG", 0)):
    """Function of the mesh with values by position."""
    function = fem.Function(fem.functionspace(mesh, element))
    function.interpolate(values)
    return function


def halves(X):
    return np.where(X[0] < 0.5, SOFT, HARD)


def varied(box, material):
    """The body of a box with another material."""
    return scenes.of_material(box.body, material)


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_cells_have_the_moduli_of_their_values(comm, cell):
    box = Box(comm, cell)
    material = neo_hookean(field(box.mesh, halves))
    moduli = CellModuli(box.V, material)(box.body.cells)
    middle = field(box.mesh, lambda X: X[0]).x.array[box.body.cells]
    expected = halves([middle])[:, None, None, None] * unit_moduli()
    np.testing.assert_allclose(moduli, expected, rtol=0, atol=1e3 * EPS * HARD)
    assert least_modulus(varied(box, material)) == pytest.approx(SOFT / (1 + NU))


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("kind", ["coordinate", "nodal"])
def test_values_that_vary_within_cells_are_those_at_points(comm, cell, kind):
    box = Box(comm, cell)
    x = ufl.SpatialCoordinate(box.mesh)
    nodal = field(box.mesh, lambda X: SOFT * (1 + X[0] + X[1]), ("Lagrange", 1))
    E = nodal if kind == "nodal" else SOFT * (1 + x[0] + x[1])
    moduli = CellModuli(box.V, neo_hookean(E))(box.body.cells)
    # Each point has the moduli of a number, and their mean is that at the centre of a cell.
    numbers = moduli[..., 1, 1] * (1 + NU)
    np.testing.assert_allclose(
        moduli, numbers[..., None, None] * unit_moduli(), atol=1e3 * EPS * HARD
    )
    middle = field(box.mesh, lambda X: SOFT * (1 + X[0] + X[1])).x.array[box.body.cells]
    np.testing.assert_allclose(numbers.mean(axis=1), middle)
    assert np.all(np.ptp(numbers, axis=1) > 0.1 * SOFT)


def test_nodes_between_two_values_have_the_stiffer_one(comm):
    box = Box(comm, shape=(4, 2, 2))
    body = varied(box, neo_hookean(field(box.mesh, halves)))
    n = box.V.dofmap.index_map.size_local
    E = np.where(box.V.tabulate_dof_coordinates()[:n, 0] < 0.5 - 1e-9, SOFT, HARD)
    np.testing.assert_allclose(nodal_moduli([body], n), unit_moduli()[0, 0] * E)


@pytest.mark.serial
def test_the_stiffest_axis_counts(comm):
    """Regression: shear moduli stood for those of the second and third axis."""
    box = Box(comm)

    def psi(C):
        E = (C - ufl.Identity(3)) / 2
        return SOFT / 2 * ufl.inner(E, E) + HARD / 2 * E[2, 2] ** 2

    body = varied(box, nts.Hyperelastic(psi, rho=RHO))
    np.testing.assert_allclose(nodal_moduli([body], 27), SOFT + HARD)


def steppers(comm, scheme, *materials, **options):
    """The box falls onto a plane that it touches, once with each material."""
    floor = nts.RigidPlane(point=(0, 0, 0), normal=(0, 0, 1))
    for material in materials:
        box = Box(comm)
        law = material(box.mesh)
        body = varied(box, law)
        pairs = nts.all_pairs([body], obstacles=[floor])
        stepper = scheme([body], pairs, **options)
        stepper.set_velocity(body, (0.1, 0.0, -0.5))
        yield box, stepper


def constant_field(mesh, element=("DG", 0)):
    return neo_hookean(field(mesh, lambda X: np.full(X.shape[1], SOFT), element))


@pytest.mark.parametrize("element", [("DG", 0), ("Lagrange", 1)])
@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.CentralDifference])
def test_a_field_with_one_value_acts_as_the_number(comm, scheme, element):
    options = {"dt": 0.01} if scheme is nts.EnergyMomentum else {}
    materials = (lambda mesh: neo_hookean(SOFT), lambda mesh: constant_field(mesh, element))
    found = []
    for box, stepper in steppers(comm, scheme, *materials, **options):
        for _ in range(5):
            stepper.advance()
        found.append(gathered(box.V, stepper.x))
        if scheme is nts.CentralDifference:
            found[-1] = np.append(found[-1], stepper.stable_step)
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-10)


def test_the_stiffest_cell_limits_the_step(comm):
    materials = (lambda mesh: neo_hookean(field(mesh, halves)), lambda mesh: neo_hookean(HARD))
    steps = [s.stable_step for _, s in steppers(comm, nts.CentralDifference, *materials)]
    assert steps[0] == pytest.approx(steps[1])


@pytest.mark.serial
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("element", [("DG", 0), ("Lagrange", 1)])
def test_estimate_is_on_the_safe_side_and_not_far_from_the_limit(comm, element, cell, degree):
    box = Box(comm, cell)
    V = fem.functionspace(box.mesh, ("Lagrange", degree, (3,)))
    values = field(box.mesh, lambda X: SOFT * (1 + 5 * X[0] + X[1]), element)
    body = nts.Body(V, box.cells, box.tag["body 0"], neo_hookean(values))
    du, eta = ufl.TrialFunction(V), ufl.TestFunction(V)

    def stiffness(material, parameters, rho):
        stress = material.linear_stress(ufl.sym(ufl.grad(du)), **parameters)
        return ufl.inner(stress, ufl.grad(eta))

    K = fem.assemble_matrix(compile_quickly(bulk_form([body], stiffness))).to_dense()
    scale = 1 / np.sqrt(np.repeat(lumped_mass([body]), 3))
    highest = np.linalg.eigvalsh(scale[:, None] * K * scale)[-1]
    bound, _ = Cells([body]).limits(V.tabulate_dof_coordinates())
    assert highest <= bound <= 4 * highest


@pytest.mark.parametrize("lower", [SOFT, 10 * SOFT])
def test_all_pairs_give_the_nodes_to_the_body_that_has_them_with_numbers(comm, lower):
    one, other = scenes.blocks(comm).stepper.bodies
    found = []
    for of in (lambda E: E, lambda E: field(one.V.mesh, lambda X: np.full(X.shape[1], E))):
        bodies = [
            scenes.of_material(body, neo_hookean(of(E)))
            for body, E in ((one, lower), (other, 2 * SOFT))
        ]
        (pair,) = nts.all_pairs(bodies)
        found.append(pair.nodes.name)
    assert found[0] == found[1]


@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.CentralDifference])
def test_fibres_along_a_function_act_as_those_along_its_value(comm, scheme):
    options = {"dt": 0.01} if scheme is nts.EnergyMomentum else {}
    direction = np.array([1.0, 1.0, 0.0])

    def law(fibre):
        return nts.HolzapfelGasserOgden(300.0, 2e3, 200.0, 2.0, RHO, fibres=[fibre])

    def along_field(mesh):
        return law(field(mesh, lambda X: np.outer(direction, X[0] ** 0), ("DG", 0, (3,))))

    found = []
    materials = (lambda mesh: law(tuple(direction)), along_field)
    for box, stepper in steppers(comm, scheme, *materials, **options):
        for _ in range(5):
            stepper.advance()
        found.append(gathered(box.V, stepper.x))
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-10)


@pytest.mark.serial
@pytest.mark.parametrize("kind", ["function", "coordinate"])
def test_numerical_values_of_fields_are_refused(comm, kind):
    mesh = Box(comm).mesh
    E = field(mesh, halves)
    if kind == "coordinate":
        E = 1 + ufl.SpatialCoordinate(mesh)[0]
    with pytest.raises(ValueError, match="expected an expression without fields, given one with"):
        Evaluation(2 * E)
    material = neo_hookean(E)
    assert material.has_fields
    with pytest.raises(ValueError, match="without fields"):
        _ = material.moduli
    assert neo_hookean(E, one_point="volumetric").one_point == frozenset()


@pytest.mark.serial
def test_a_field_of_shear_alone_is_a_field(comm):
    E = field(Box(comm).mesh, halves)

    def psi(C):
        strain = (C - ufl.Identity(3)) / 2
        return SOFT / 2 * ufl.inner(strain, strain) + E * C[0, 1] ** 2

    assert nts.Hyperelastic(psi, rho=RHO).has_fields
