"""A block slides over a flat floor: its leading edge pushes no node of the floor ahead of it."""

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import entities_to_geometry

import dolfinx_nts as nts

PRESS, SLIDE, EDGE = 0.005, 0.24, 1.12  # m
ANGLES = [75, 90, 95, 105, 120, 135, 150]

pytestmark = pytest.mark.serial


NODES = nts.LagrangeMultiplier("plastic"), "node-to-segment"
MORTAR = nts.LagrangeMultiplier("elastic"), "mortar"
DEFAULT = None, None  # springs, surface-to-surface


def scene(comm, angle, dim, friction, contact=NODES):
    """Floor, block with a leading edge of this interior angle [degrees], and their pair."""
    law, method = contact

    def fill(model):
        if dim == 2:
            parts = nts.parts.add_rectangle
            low, up = ((0, 0), (2.5, 1), (10, 4)), ((EDGE - 0.6, 1), (1, 1), (4, 4))
        else:
            parts = nts.parts.add_box
            low = ((0, 0, 0), (2.5, 0.75, 1), (10, 3, 2))
            up = ((EDGE - 0.6, 0.1, 1), (1, 0.5, 1), (4, 2, 2))
        for name, (corner, size, cells) in {"low": low, "up": up}.items():
            parts(model, name, corner=corner, size=size, cells=cells)

    mesh, cells, _, tag = nts.read_mesh(fill, comm)
    X = mesh.geometry.x
    block = np.unique(entities_to_geometry(mesh, dim, cells.find(tag["up"])))
    block = block[X[block, 0] > EDGE]
    X[block, 0] += np.tan(np.radians(angle - 90)) * (X[block, dim - 1] - 1)
    V = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
    material = nts.NeoHookean(E=2e5, nu=0.3, rho=1e3)
    low, up = (nts.Body(V, cells, tag[name], material) for name in ("low", "up"))
    pair = nts.ContactPair(
        nts.boundary_of(low),
        nts.boundary_of(up),
        law,
        nts.Coulomb(friction) if friction else None,
        method,
    )
    bottom, top = (
        fem.locate_dofs_geometrical(V, lambda x, z=z: np.isclose(x[dim - 1], z)) for z in (0, 2)
    )
    return V, [low, up], [pair], bottom, top


def drag(comm, angle, dim, friction):
    """Ratio of the tangential to the normal force on the block in each step of sliding."""
    V, bodies, pairs, bottom, top = scene(comm, angle, dim, friction)
    drive, zero = fem.Constant(V.mesh, np.zeros(dim)), np.zeros(dim)

    def update(t):
        drive.value[0] = SLIDE * max(t - 0.2, 0) / 0.8
        drive.value[dim - 1] = -PRESS * min(t, 0.2) / 0.2

    bcs = [fem.dirichletbc(zero, bottom, V), fem.dirichletbc(drive, top, V)]
    stepper = nts.QuasiStatic(bodies, pairs, dt=0.1, bcs=bcs, update=update)
    forces = np.array([report.reactions[1].force for report in stepper.run(until=0.8)])[2:]
    return forces[:, 0] / -forces[:, dim - 1]


@pytest.mark.parametrize("friction", [0.5, 0.0])
@pytest.mark.parametrize("angle", ANGLES)
def test_friction_of_a_dragged_block_agrees_with_coulomb(comm, angle, friction):
    # The block leans and the nodes pass one by one: the ratio varies by 0.02.
    np.testing.assert_allclose(drag(comm, angle, 2, friction), friction, atol=0.02)


@pytest.mark.parametrize("angle", [75, 105, 135])
def test_friction_of_a_dragged_block_in_space_agrees_with_coulomb(comm, angle):
    np.testing.assert_allclose(drag(comm, angle, 3, 0.5), 0.5, atol=0.02)


def throw(comm, angle, dim, friction, contact, until):
    """Throw the block along the floor at 1 m/s.

    Returns its velocity [m/s], the error of energy, and the number of rejected attempts [-].
    """
    V, bodies, pairs, bottom, _ = scene(comm, angle, dim, friction, contact)
    fall = np.zeros(dim)
    fall[dim - 1] = -2.0
    bcs = [fem.dirichletbc(np.zeros(dim), bottom, V)]
    loads = [nts.Gravity([bodies[1]], fall)]
    stepper = nts.EnergyMomentum(bodies, pairs, dt=4e-3, bcs=bcs, loads=loads)
    stepper.set_velocity(bodies[1], np.eye(dim)[0])
    diagnostics = nts.Diagnostics(stepper)
    start = diagnostics.balance().total_energy
    reports = list(stepper.run(until=until))
    work = sum(report.load_work for report in reports)
    error = (diagnostics.balance().total_energy - work) / start - 1
    return diagnostics.body_velocity(bodies[1]), error, sum(each.rejected for each in reports)


@pytest.mark.parametrize(("angle", "dim"), [*((angle, 2) for angle in ANGLES), (105, 3), (150, 3)])
def test_block_thrown_along_a_floor_keeps_its_velocity_without_friction(comm, angle, dim):
    # The surface of the floor is wavy, with slopes of about a hundredth.
    velocity, *_ = throw(comm, angle, dim, 0.0, NODES, until=0.2)
    assert abs(velocity[0] - 1) < 0.02


@pytest.mark.parametrize("contact", [MORTAR, DEFAULT], ids=["mortar", "default"])
@pytest.mark.parametrize(
    ("angle", "dim", "friction"),
    [(95, 2, 0.5), (105, 2, 0.5), (120, 2, 0.0), (135, 2, 0.5), (150, 2, 0.0), (95, 3, 0.5)],
)
def test_facets_below_the_edge_of_a_thrown_block_agree_with_coulomb(
    comm, angle, dim, friction, contact
):
    velocity, error, rejected = throw(comm, angle, dim, friction, contact, until=0.3)
    assert rejected == 0
    # Gravity of 2 m/s^2 acts for 0.3 s.
    of_friction, of_contact = 1 - velocity[0], velocity[dim - 1] + 0.6
    # Impulses of released springs press without friction.
    assert of_friction / of_contact == pytest.approx(friction, abs=0.06)
    # Changes of contact points give back what they take from springs.
    assert friction or abs(error) < 1e-11
