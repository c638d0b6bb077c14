"""Functions of contact and stress against closed forms and resultants."""

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.diagnostics.functions import nodal_values
from dolfinx_nts.diagnostics.nodal_fields import NodalFields
from dolfinx_nts.fem.components import nodal
from helpers.models import plane
from helpers.scenes import BLOCK_RUBBER, blocks

pytestmark = pytest.mark.at_most_two_ranks

TOLERANCE = 1e-11

# Displacement gradient of a large shear with stretch and rotation.
GRADIENT = np.array([[0.2, 0.3, 0.0], [-0.1, 0.05, 0.2], [0.0, 0.1, -0.1]])


@pytest.mark.parametrize(("cell", "degree"), [("hexahedron", 1), ("tetrahedron", 2)])
def test_stress_of_a_homogeneous_deformation_agrees_with_the_law(comm, agree, cell, degree):
    stepper = blocks(comm, cell=cell, degree=degree).stepper
    for body in stepper.bodies:
        stepper.set_displacement(body, lambda X: GRADIENT @ X)
    E, nu, _ = BLOCK_RUBBER
    lmbda, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    F = np.eye(3) + GRADIENT
    strain = (F.T @ F - np.eye(3)) / 2
    S = lmbda * np.trace(strain) * np.eye(3) + 2 * mu * strain
    sigma = F @ S @ F.T / np.linalg.det(F)
    deviator = sigma - np.trace(sigma) / 3 * np.eye(3)
    fields = nts.Fields(stepper)
    for field, value in (
        (fields.cauchy_stress(), sigma.ravel()),
        (fields.von_mises_stress(), [np.sqrt(1.5 * np.sum(deviator**2))]),
        (fields.strain_energy_density(), [np.sum(S * strain) / 2]),
    ):
        rows = field.x.array.reshape(-1, len(value))
        assert agree(np.allclose(rows, value, rtol=0, atol=TOLERANCE * E))
    assert fields.cauchy_stress() is fields.cauchy_stress()


@pytest.mark.parametrize("dim", [2, 3])
def test_displacement_and_velocity_are_copies_of_the_state(comm, agree, dim):
    if dim == 3:
        stepper = blocks(comm).stepper
    else:
        scene = plane.blocks(comm=comm)
        stepper = nts.EnergyMomentum([scene.lower, scene.upper], [], dt=0.01)
    for body in stepper.bodies:
        stepper.set_displacement(body, lambda X: 0.1 * X[:dim])
        stepper.set_velocity(body, lambda X: 0.2 * X[:dim])
    fields = nts.Fields(stepper)
    for field, state in ((fields.displacement(), stepper.u), (fields.velocity(), stepper.v)):
        owned = len(nodal(state)[: len(stepper.node_ids)].ravel())
        assert field is not state
        assert agree(np.array_equal(field.x.array[:owned], state.x.array[:owned]))
        # Positions of ghosts differ by round-off from those of their owners.
        assert agree(np.allclose(field.x.array, state.x.array, rtol=0, atol=1e-15))
    assert agree(np.abs(stepper.v.x.array).max() > 0)
    assert fields.velocity().name == "velocity" and fields.velocity() is fields.velocity()


def test_stress_in_each_cell_of_degree_two_is_linear(comm, agree):
    stepper = blocks(comm, cell="tetrahedron", degree=2).stepper
    stepper.set_displacement(stepper.bodies[0], lambda X: 0.01 * np.array([X[0] ** 2, X[1], X[2]]))
    density = nts.Fields(stepper).strain_energy_density()
    F = ufl.Identity(3) + ufl.grad(stepper.u)
    psi = stepper.bodies[0].material.psi(F.T * F)
    expected = fem.Function(density.function_space)
    points = density.function_space.element.interpolation_points
    points = points() if callable(points) else points
    expected.interpolate(fem.Expression(psi, points))
    assert agree(np.allclose(density.x.array, expected.x.array, rtol=1e-9, atol=1e-9))


def test_functions_of_contact_have_the_resultants_of_the_pair(comm, agree):
    old = blocks(comm).stepper
    pairs = [
        nts.ContactPair(
            p.nodes,
            p.segments,
            friction=nts.Coulomb(0.3),
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
        for p in old.pairs
    ]
    stepper = nts.EnergyMomentum(old.bodies, pairs, dt=old.dt)
    stepper.v.x.array[:] = old.v.x.array
    fields, diagnostics = nts.Fields(stepper), nts.Diagnostics(stepper)
    ds = pairs[0].nodes.measure()
    traction, pressure = fields.contact_traction(), fields.contact_pressure()
    forms = [fem.form(traction[i] * ds) for i in range(3)] + [fem.form(pressure * ds)]
    touched = False
    for _ in range(6):
        stepper.advance()
        fields.contact_traction()
        fields.contact_pressure()
        *force, normal = comm.allreduce(np.array([fem.assemble_scalar(form) for form in forms]))
        expected = diagnostics.contact_force()
        assert np.allclose(force, expected, rtol=0, atol=TOLERANCE * np.linalg.norm(expected))
        total = -comm.allreduce(pairs[0].history.lambda_N.sum())
        assert normal == pytest.approx(total, rel=TOLERANCE)
        touched |= normal > 0
    assert touched
    gap = nodal_values(stepper.u.function_space, fields.gap())
    assert agree(np.array_equal(gap[pairs[0].nodes.nodes], pairs[0].gap(stepper.x), equal_nan=True))
    others = np.setdiff1d(np.arange(len(gap)), pairs[0].nodes.nodes)
    assert agree(np.isnan(gap[others]).all() and not np.isfinite(gap[others]).any())


@pytest.mark.parametrize("field", ["contact_traction", "friction_traction"])
def test_tractions_of_half_passes_have_the_forces_of_both(comm, field):
    """What one surface feels, the other feels in the opposite direction."""
    old = blocks(comm).stepper
    (pair,) = old.pairs
    pairs = nts.two_half_passes(pair.nodes, pair.segments, nts.Penalty(5e3), nts.Coulomb(0.3))
    stepper = nts.EnergyMomentum(old.bodies, pairs, dt=old.dt)
    stepper.v.x.array[:] = old.v.x.array
    for _ in range(6):
        stepper.advance()
    nodes, values = NodalFields(stepper).contact(CurrentState(stepper), field)[:2]
    parts = {"contact_traction": "force", "friction_traction": "traction"}
    sign = 1 if field == "contact_traction" else -1
    given = [sign * getattr(p.history, parts[field]).sum(axis=0) for p in pairs]
    first, second = comm.allreduce(np.array(given))
    assert min(map(np.linalg.norm, (first, second))) > 0
    for p, expected in zip(pairs, (first - second, second - first), strict=True):
        tractions = values[np.searchsorted(nodes, p.nodes.nodes)]
        force = comm.allreduce(p.nodes.area @ tractions)
        assert np.allclose(force, expected, rtol=0, atol=TOLERANCE * np.linalg.norm(expected))


def test_values_at_nodes_are_found_in_functions_of_spaces_with_the_same_nodes(comm, agree, refused):
    V = blocks(comm).stepper.u.function_space
    X = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]
    scalar, vector = (fem.functionspace(V.mesh, ("Lagrange", 1, *s)) for s in ((), ((3,),)))
    for space, value in ((scalar, X[:, 0] - X[:, 2]), (vector, X), (V, X)):
        f = fem.Function(space)
        f.interpolate((lambda x: x[0] - x[2]) if value.ndim == 1 else (lambda x: x))
        assert agree(np.allclose(nodal_values(V, f), value, rtol=0, atol=1e-14))
    for element in (("DG", 1), ("Lagrange", 2), ("Lagrange", 1, (2,))):
        with refused(ValueError, "expected a Lagrange Function of degree 1"):
            nodal_values(V, fem.Function(fem.functionspace(V.mesh, element)))


def test_fields_of_something_else_are_refused(comm, refused):
    with refused(TypeError, "expected a stepper, given str"):
        nts.Fields("stepper")
    assert repr(nts.Fields(blocks(comm).stepper)) == "Fields(stepper=EnergyMomentum)"
