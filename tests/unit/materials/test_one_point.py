"""Terms of the energy that are integrated with one point a cell, so that cells do not lock."""

import re
from functools import partial

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import (
    CellType,
    GhostMode,
    create_unit_cube,
    create_unit_square,
    exterior_facet_indices,
    meshtags,
)

import dolfinx_nts as nts
from dolfinx_nts.fem.jit import compile_quickly
from dolfinx_nts.model.bodies import bulk_form
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.precond.tangent import Tangent
from helpers import scenes
from helpers.models import box_meshes
from helpers.once import once
from helpers.scene import Motion, gathered
from helpers.step_parts import step_forms

pytestmark = pytest.mark.at_most_two_ranks

# Tolerance of the total energy at any step, relative to the start.
ENERGY_TOLERANCE = 1e-10
# Round-off of numbers near 1, in double precision.
ROUNDING = 1e-12

E, NU, RHO = 1.0e5, 0.4, 1.0e3
LMBDA, MU = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))


def beam(comm, one_point, nu=NU, shape=(6, 2, 1)):
    """Stepper of a box from the origin to (3, 1, 0.5), and its body."""
    data = box_meshes.boxes([shape], [(3.0, 1.0, 0.5)])
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.SaintVenantKirchhoff(E, nu, RHO, one_point=one_point)
    body = nts.Body(V, cells, tag["body 0"], material)
    return nts.EnergyMomentum([body], dt=0.01), body


def energy(comm, one_point, displacement, **options):
    """Strain energy of a displacement of the nodes."""
    stepper, body = beam(comm, one_point, **options)
    stepper.set_displacement(body, displacement)
    return nts.Diagnostics(stepper).strain_energy()


@pytest.mark.serial
def test_uniform_strain_has_the_energy_of_the_full_rule(comm):
    A = np.array([[0.1, 0.05, -0.02], [0.0, -0.08, 0.03], [0.04, 0.0, 0.06]])
    C = (np.eye(3) + A).T @ (np.eye(3) + A)
    strain = (C - np.eye(3)) / 2
    exact = 1.5 * (LMBDA / 2 * np.trace(strain) ** 2 + MU * np.sum(strain**2))
    for one_point in ((), ("lmbda",)):
        assert energy(comm, one_point, lambda x: A @ x) == pytest.approx(exact, rel=ROUNDING)


@pytest.mark.serial
def test_rigid_motion_has_no_energy(comm):
    Q = Motion.random(np.random.default_rng(1)).Q
    value = energy(comm, ("lmbda",), lambda x: Q @ x - x + 0.3)
    assert abs(value) < ROUNDING * E


@pytest.mark.serial
def test_bending_does_not_see_the_volumetric_modulus(comm):
    # The dilatation of this mode vanishes in the middle of each cell.
    def bent(x):
        x, z = x[0] - 1.5, x[2] - 0.25
        return 1e-6 * np.array([x * z, 0 * x, -(x**2) / 2])

    # Energy over shear modulus: the same for all Poisson's ratios.
    free = {nu: energy(comm, ("lmbda",), bent, nu=nu) * (1 + nu) for nu in (0.4, 0.499)}
    assert free[0.499] == pytest.approx(free[0.4], rel=1e-6)
    assert energy(comm, (), bent, nu=0.499) * 1.499 > 100 * free[0.499]


@pytest.mark.serial
@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.CentralDifference])
def test_one_point_is_the_full_rule_where_there_is_nothing_to_under_integrate(comm, scheme):
    # lambda = 0: both parts of the energy are there, and one of them vanishes.
    results = []
    for one_point in ((), ("lmbda",)):
        data = box_meshes.boxes([(2, 2, 2)], [(1.0, 1.0, 1.0)])
        mesh, cells, _, tag = box_meshes.distribute(comm, data)
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        material = nts.SaintVenantKirchhoff(E, 0.0, RHO, one_point=one_point)
        body = nts.Body(V, cells, tag["body 0"], material)
        stepper = scheme([body], dt=0.01)
        stepper.set_velocity(body, lambda x: np.array([x[2] ** 2, x[0], 0.5 * x[1]]))
        for _ in range(5):
            stepper.advance()
        results.append(gathered(V, stepper.x))
    np.testing.assert_allclose(*results, rtol=0, atol=ROUNDING)


def test_energy_is_conserved_through_an_impact(comm):
    mesh, cells, facets, tag = nts.read_mesh(scenes.BALL_PLATE, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(E, NU, RHO, one_point=("lmbda",))
    ball, plate = (nts.Body(V, cells, tag[name], rubber) for name in ("ball", "plate"))
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["ball_outer"]),
        nts.Surface(V, facets, tag["plate_top"]),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    stepper = nts.EnergyMomentum([ball, plate], [pair], dt=0.01)
    stepper.set_velocity(ball, (0.0, 1.0, -1.0))
    diagnostics = nts.Diagnostics(stepper)
    start, drift, active = diagnostics.balance().total_energy, 0.0, 0
    for step in stepper.run(until=0.3):
        drift = max(drift, abs(diagnostics.balance().total_energy / start - 1))
        active = max(active, step.num_active)
    assert active > 5
    assert drift < ENERGY_TOLERANCE


@pytest.mark.serial
@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.Midpoint])
def test_defect_of_the_bulk_takes_the_same_points(comm, scheme):
    # A neo-Hookean energy: with other points it would differ by its own size.
    data = box_meshes.boxes([(2, 2, 2)], [(1.0, 1.0, 1.0)])
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.NeoHookean(E, NU, RHO, one_point=["lmbda"])
    body = nts.Body(V, cells, tag["body 0"], material)
    stepper = scheme([body], dt=0.01)
    stepper.set_velocity(body, lambda x: np.array([10 * x[2] ** 2, 5 * x[0], -8 * x[1]]))
    diagnostics = nts.Diagnostics(stepper)
    for _ in range(3):
        before = diagnostics.balance().total_energy
        report = stepper.advance()
        change = diagnostics.balance().total_energy - before
        explained = diagnostics.bulk_defect() + report.solver_work
        assert change == pytest.approx(explained, abs=1e-11 * before)


@pytest.mark.serial
def test_unknown_names_of_one_point_are_refused(refused):
    for names in (["kappa"], ["lmbda", "mu"]):
        with refused(ValueError, re.escape("some but not all of ['lmbda', 'mu']")):
            nts.SaintVenantKirchhoff(E, NU, RHO, one_point=names)


@pytest.mark.serial
def test_energy_nonlinear_in_its_parameters_is_refused(refused):
    def psi(C, a, b):
        return a * b * (C[0, 0] - 1) ** 2 + a * (C[1, 1] - 1) ** 2

    with refused(ValueError, "linear in its parameters"):
        nts.Hyperelastic(psi, rho=1.0, one_point=["b"], a=1.0, b=2.0)


def test_body_force_acts_once(comm):
    """Its form has no parameter that a rule could leave out."""
    found = []
    for one_point in ((), ("lmbda",)):
        _, body = beam(comm, one_point)
        loaded = nts.EnergyMomentum([body], dt=0.01, loads=[nts.BodyForce(body, (0.0, 0.0, 7.0))])
        loaded.advance()
        found.append(nts.Diagnostics(loaded).linear_momentum())
    np.testing.assert_allclose(found, [[0, 0, 7.0 * 1.5 * 0.01]] * 2, atol=1e-9)


def not_linear(C, c, b, kappa):
    """Energy of Fung type: not linear in its parameters, so it has no volumetric parameter."""
    J2 = ufl.det(C)
    isochoric = c / b * (ufl.exp(b * (J2 ** (-1 / 3) * ufl.tr(C) - 3)) - 1)
    return isochoric + kappa / 2 * (ufl.sqrt(J2) - 1) ** 2


def fung(kappa):
    """Material of Fung type with the shear modulus 2 c."""
    numbers = {"c": 0.5 * MU, "b": 2.0, "kappa": kappa}
    return nts.Hyperelastic(not_linear, rho=RHO, one_point="volumetric", **numbers)


def stored(comm, material, displacement, degree=1, cell="hexahedron"):
    """Strain energy of a displacement of the box."""
    data = box_meshes.boxes([(6, 2, 1)], [(3.0, 1.0, 0.5)], cell=cell)
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    body = nts.Body(V, cells, tag["body 0"], material)
    stepper = nts.EnergyMomentum([body], dt=0.01)
    stepper.set_displacement(body, displacement)
    return nts.Diagnostics(stepper).strain_energy()


def bent(x):
    """Bending of the box, which changes the volume of no cell in its middle."""
    x, z = x[0] - 1.5, x[2] - 0.25
    return 1e-6 * np.array([x * z, 0 * x, -(x**2) / 2])


@pytest.mark.serial
@pytest.mark.parametrize("law", [nts.SaintVenantKirchhoff, nts.NeoHookean])
def test_volumetric_terms_have_one_point_where_cells_would_lock(comm, law):
    full, named, value = (
        stored(comm, law(E, 0.49, RHO, one_point=one_point), bent)
        for one_point in ((), ["lmbda"], "volumetric")
    )
    assert value == pytest.approx(named, rel=ROUNDING)
    assert value < 0.1 * full


@pytest.mark.serial
def test_cells_do_not_lock_by_default_from_a_ratio_of_three_tenths_on(comm):
    for nu, chosen in ((0.29, ()), (0.3, "volumetric"), (0.49, "volumetric")):
        expected, value = (
            stored(comm, nts.NeoHookean(E, nu, RHO, **option), bent)
            for option in ({"one_point": chosen}, {})
        )
        assert value == pytest.approx(expected, rel=ROUNDING)


@pytest.mark.serial
def test_the_ratio_of_an_own_energy_is_measured():
    def rubber(kappa):
        return nts.Hyperelastic(not_linear, rho=RHO, c=0.5 * MU, b=2.0, kappa=kappa)

    # K = 13/6 mu at a ratio of 0.3.
    assert [rubber(ratio * MU).splits_volume for ratio in (2.1, 2.2)] == [False, True]
    # Only the volume has stiffness: with one point cells would have no energy of their own.
    fluid = nts.Hyperelastic(lambda C, k: k / 2 * (ufl.sqrt(ufl.det(C)) - 1) ** 2, rho=RHO, k=MU)
    assert not fluid.splits_volume and fluid.one_point == frozenset()


@pytest.mark.parametrize(("nu", "splits"), [(0.2, False), (0.35, True)])
def test_an_energy_with_fields_does_not_lock_where_a_cell_has_a_ratio_of_three_tenths(
    comm, nu, splits
):
    mesh, cells, _, tag = box_meshes.distribute(
        comm, box_meshes.boxes([(6, 2, 1)], [(3.0, 1.0, 0.5)])
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    ratio = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    ratio.interpolate(lambda x: np.where(x[0] < 0.5, nu, 0.2))

    def psi(C, stiffness, fibres):
        lmbda, ln_J = 2 * ratio / (1 - 2 * ratio), ufl.ln(ufl.det(C)) / 2
        isotropic = (ufl.tr(C) - 3) / 2 - ln_J + lmbda / 2 * ln_J**2
        return stiffness * isotropic + fibres * (C[0, 0] - 1) ** 2

    def body(**parameters):
        return nts.Body(V, cells, tag["body 0"], nts.Hyperelastic(psi, rho=RHO, **parameters))

    assert body(stiffness=MU, fibres=0.0).splits_volume == splits
    assert not body(stiffness=MU, fibres=MU).splits_volume
    assert not body(stiffness=MU, fibres=0.0, one_point=()).splits_volume


@pytest.mark.serial
@pytest.mark.parametrize(("cell", "degree"), [("hexahedron", 2), ("tetrahedron", 1)])
def test_other_elements_have_all_points(comm, cell, degree):
    expected, value = (
        stored(comm, nts.NeoHookean(E, 0.49, RHO, one_point=one_point), bent, degree, cell)
        for one_point in ((), "volumetric")
    )
    assert value == pytest.approx(expected, rel=ROUNDING)


@pytest.mark.serial
def test_parameters_of_the_volume_alone_are_found():
    rubber = nts.Hyperelastic(
        lambda C, mu, kappa: (
            mu / 2 * (ufl.tr(C) - 3 - ufl.ln(ufl.det(C))) + kappa / 8 * ufl.ln(ufl.det(C)) ** 2
        ),
        **{"rho": RHO, "mu": MU, "kappa": LMBDA, "one_point": "volumetric"},
    )
    assert rubber.one_point == {"kappa"}
    assert fung(1e6).one_point == frozenset()


@pytest.mark.serial
def test_any_energy_is_divided_into_change_of_shape_and_of_volume(comm):
    # The whole energy where cells deform uniformly, and no resistance to bending by kappa.
    A = np.array([[0.1, 0.05, -0.02], [0.0, -0.08, 0.03], [0.04, 0.0, 0.06]])
    C = ufl.as_matrix(((np.eye(3) + A).T @ (np.eye(3) + A)).tolist())
    exact = 1.5 * float(fung(1e6).psi(C)(()))
    assert stored(comm, fung(1e6), lambda x: A @ x) == pytest.approx(exact, rel=1e-10)
    bending = [stored(comm, fung(kappa), bent) for kappa in (1e6, 1e8)]
    assert bending[1] == pytest.approx(bending[0], rel=1e-5)


@pytest.mark.serial
def test_energy_of_a_divided_material_is_conserved(comm):
    data = box_meshes.boxes([(2, 2, 2)], [(1.0, 1.0, 1.0)])
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    body = nts.Body(V, cells, tag["body 0"], fung(1e6))
    stepper = nts.EnergyMomentum([body], dt=0.01)
    stepper.set_velocity(body, lambda x: np.array([10 * x[2] ** 2, 5 * x[0], -8 * x[1]]))
    diagnostics = nts.Diagnostics(stepper)
    energies = [diagnostics.balance().total_energy]
    for _ in stepper.run(until=0.1):
        energies.append(diagnostics.balance().total_energy)
    np.testing.assert_allclose(energies, energies[0], rtol=ENERGY_TOLERANCE)


def eigenvalues(material, motion):
    """Eigenvalues of the stiffness of a distorted cell after a motion, ascending [N/m]."""
    rng = np.random.default_rng(3)
    data = box_meshes.boxes([(1, 1, 1)], [(1.0, 1.2, 0.8)])
    data.X[:] += 0.1 * rng.uniform(-1, 1, data.X.shape)
    mesh, cells, _, tag = box_meshes.distribute(MPI.COMM_SELF, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    body = nts.Body(V, cells, tag["body 0"], material)
    u, eta = fem.Function(V), ufl.TestFunction(V)
    F = ufl.Identity(3) + ufl.grad(u)

    def work(material, parameters, rho):
        return ufl.inner(F * material.stress(F.T * F, **parameters), ufl.grad(eta))

    u.interpolate(lambda x: motion @ x - x)
    form = compile_quickly(ufl.derivative(bulk_form([body], work), u))
    K = fem.assemble_matrix(form).to_dense()
    return np.linalg.eigvalsh((K + K.T) / 2)


@pytest.mark.serial
@pytest.mark.parametrize("nu", [0.3, 0.499])
@pytest.mark.parametrize("turned", [0.0, 2.0])
def test_no_deformation_of_a_cell_is_without_energy(nu, turned):
    """Of the 24 motions of a distorted cell, six are rigid; hourglasses would be more."""
    material = nts.NeoHookean(E, nu, RHO, one_point="volumetric")
    values = eigenvalues(material, scenes.rotation((1, 2, 3), turned))
    assert np.abs(values[:6]).max() < 1e-9 * MU
    assert values[6] > 0.05 * MU


def swirled(comm, cell):
    """Space and cells of a body whose inner nodes are moved by up to a fifth of an edge."""
    if cell == "hexahedron":
        mesh = create_unit_cube(comm, 4, 4, 4, CellType.hexahedron, ghost_mode=GhostMode.none)
    else:
        mesh = create_unit_square(comm, 4, 4, CellType.quadrilateral, ghost_mode=GhostMode.none)
    X, dim = mesh.geometry.x, mesh.geometry.dim
    bubble = np.prod(np.sin(np.pi * X[:, :dim]), axis=1)[:, None]
    X[:, :dim] += 0.05 * np.sin(40 * X[:, :dim] + 17 * X[:, [1, 2, 0][:dim]]) * (bubble > 1e-9)
    local = mesh.topology.index_map(dim).size_local
    cells = meshtags(mesh, dim, np.arange(local), np.ones(local, dtype=np.int32))
    return fem.functionspace(mesh, ("Lagrange", 1, (dim,))), cells


@pytest.mark.parametrize("cell", ["hexahedron", "quadrilateral"])
@pytest.mark.parametrize(
    "law", [once(partial(nts.SaintVenantKirchhoff, nu=0.45)), partial(nts.NeoHookean, nu=0.3)]
)
def test_uniform_strain_is_in_balance_on_distorted_cells(comm, cell, law):
    """The patch test: inner nodes follow the boundary."""
    V, cells = swirled(comm, cell)
    dim = V.mesh.geometry.dim
    A = np.array([[0.02, 0.05, -0.02], [0.0, -0.08, 0.03], [0.04, 0.0, 0.06]])[:dim, :dim]
    whole = fem.Function(V)
    whole.interpolate(lambda x: A @ x[:dim])
    V.mesh.topology.create_connectivity(dim - 1, dim)
    sides = exterior_facet_indices(V.mesh.topology)
    boundary = fem.dirichletbc(whole, fem.locate_dofs_topological(V, dim - 1, sides))
    stepper = nts.QuasiStatic([nts.Body(V, cells, 1, law(E=E, rho=RHO))], dt=1.0, bcs=[boundary])
    stepper.advance()
    error = np.abs(stepper.u.x.array - whole.x.array).max(initial=0.0)
    assert comm.allreduce(error, op=MPI.MAX) < 1e-10


@pytest.mark.parametrize("law", [nts.SaintVenantKirchhoff, once(nts.NeoHookean)])
def test_distorted_cells_conserve_energy_and_momenta_while_they_turn(comm, law):
    V, cells = swirled(comm, "hexahedron")
    body = nts.Body(V, cells, 1, law(1e3, 0.45, 1.0))
    stepper = nts.EnergyMomentum([body], dt=0.01)

    def spin(x):
        away = x - 0.5
        return np.cross([5.0, 10.0, 20.0], away.T).T + 2 * away[[2, 0, 1]] ** 2

    stepper.set_velocity(body, spin)
    diagnostics = nts.Diagnostics(stepper)
    states, X = [], stepper.x.copy()
    for _ in range(21):
        balance = diagnostics.balance()
        p, L = balance.linear_momentum, balance.angular_momentum
        states.append([balance.total_energy, *p, *L])
        stepper.advance()
    sizes = np.abs(states[0])
    sizes[1:4], sizes[4:] = sizes[1:4].max(), sizes[4:].max()
    assert np.abs((np.array(states) - states[0]) / sizes).max() < 1e-12
    # By three quarters of a turn, and strained.
    assert comm.allreduce(np.abs(stepper.x - X).max(), op=MPI.MAX) > 1
    assert diagnostics.strain_energy() > 0.02 * states[0][0]


@pytest.mark.serial
def test_the_tangent_of_distorted_cells_is_the_derivative(comm):
    V, cells = swirled(comm, "hexahedron")
    body = nts.Body(V, cells, 1, nts.SaintVenantKirchhoff(1e3, 0.45, 1.0))
    stepper = nts.EnergyMomentum([body], dt=0.1)
    form = step_forms(stepper).residual()
    bulk, tangent = Bulk(form, stepper.u, []), Tangent(form, stepper.u, [])
    rng = np.random.default_rng(4)
    stepper.u_n.x.array[:], u, d = rng.normal(scale=0.02, size=(3, len(stepper.u.x.array)))

    def residual(x):
        stepper.u.x.array[:] = x
        return bulk.forces()

    K_d = (residual(u), bulk.action(d.reshape(-1, 3)).ravel())[1]
    tangent.assemble_exact()
    matrix = tangent.matrix(scalar=True)
    product = matrix.createVecLeft()
    matrix.mult(PETSc.Vec().createWithArray(d), product)
    np.testing.assert_allclose(product.array, K_d, rtol=0, atol=1e-11 * np.abs(K_d).max())
    R = residual(u)
    sizes = [np.abs(residual(u + h * d) - R - h * K_d).max() for h in (1e-1, 1e-2)]
    assert np.log10(sizes[0] / sizes[1]) > 1.9


def with_fibres(C, mu, kappa, k, b, stretch):
    """Energy of rubber with fibres along the first axis, with a given stretch."""
    J2 = ufl.det(C)
    rubber = mu / 2 * (J2 ** (-1 / 3) * ufl.tr(C) - 3) + kappa / 2 * (ufl.sqrt(J2) - 1) ** 2
    return rubber + k / (2 * b) * (ufl.exp(b * stretch(C) ** 2) - 1)


@pytest.mark.serial
def test_fibres_that_resist_a_change_of_volume_keep_all_points(refused):
    """With one point for what they resist, hourglasses would release energy."""

    def tissue(stretch, **option):
        def psi(C, **numbers):
            return with_fibres(C, stretch=stretch, **numbers)

        numbers = {"mu": MU, "kappa": 10 * MU, "k": 10 * MU, "b": 1.0}
        return nts.Hyperelastic(psi, rho=RHO, **numbers, **option)

    def stretch(C):
        return C[0, 0] - 1

    assert eigenvalues(tissue(stretch), np.eye(3))[6] > 0.05 * MU
    with refused(ValueError, re.escape("(det C)^(-1/3) C")):
        tissue(stretch, one_point="volumetric")
    isochoric = tissue(lambda C: stretch(ufl.det(C) ** (-1 / 3) * C))
    assert isochoric.splits_volume
    assert eigenvalues(isochoric, np.eye(3))[6] > 0.05 * MU
