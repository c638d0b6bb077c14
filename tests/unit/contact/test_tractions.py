"""Tractions of nodes on edges and corners of their surface."""

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models.box_meshes import boxes, distribute
from helpers.once import once

E, STRAIN = 1e6, 1e-3


def pressed(comm, cell="hexahedron", degree=1, law=None, turn=None):
    """Stepper and pair of a unit cube whose whole boundary may touch a plane, under pressure."""
    turn = np.eye(3) if turn is None else turn
    data = boxes([(3, 2, 2)], [(1.0, 1.0, 1.0)], cell)
    data.X[:, 0] **= 1.5  # cells of several sizes
    mesh, cells, _, tag = distribute(comm, data)
    mesh.geometry.x[:] = mesh.geometry.x @ turn.T
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    cube = nts.Body(V, cells, tag["body 0"], nts.SaintVenantKirchhoff(E, 0.0, 1e3))
    plane = nts.RigidPlane((0, 0, 0), tuple(turn[:, 2]))
    pair = nts.ContactPair(nts.boundary_of(cube), plane, law, method="node-to-segment")
    top = fem.locate_dofs_geometrical(V, lambda x: np.isclose(turn[:, 2] @ x, 1.0))
    bcs = [fem.dirichletbc(-STRAIN * turn[:, 2], top, V)]
    stepper = nts.QuasiStatic([cube], [pair], dt=1.0, bcs=bcs)
    stepper.advance()
    return stepper, pair


TURN = np.linalg.qr(np.array([[1.0, 0.3, 0.2], [-0.3, 1.0, 0.5], [0.1, -0.4, 1.0]]))[0]
# First Piola-Kirchhoff stress of the uniaxial strain.
PRESSURE = E * STRAIN * (1 - STRAIN) * (1 - STRAIN / 2)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("cell", "degree"),
    [("hexahedron", 1), once("tetrahedron", 1), once("hexahedron", 2), once("tetrahedron", 2)],
)
@pytest.mark.parametrize("law", [None, once(nts.Penalty(1e9))])
def test_uniform_pressure_is_uniform_at_edges_and_corners_of_a_whole_boundary(
    comm, agree, cell, degree, law
):
    stepper, pair = pressed(comm, cell, degree, law, TURN if degree == 1 else None)
    contact = stepper.contacts[0]
    x = stepper.x[pair.nodes.nodes]
    axis = TURN[:, 2] if degree == 1 else np.array([0.0, 0.0, 1.0])
    touches = x @ axis < 1e-3
    tolerance = {"rel": 1e-6 if law is None else 0.02}
    assert agree(contact.pressure[touches] == pytest.approx(PRESSURE, **tolerance))
    tractions = contact.traction[touches] @ axis
    assert agree(tractions == pytest.approx(PRESSURE, **tolerance))
    assert agree(not contact.pressure[~touches].any())
    (of_pair,) = nts.Diagnostics(stepper).pairs().values()
    assert agree(of_pair.contact_area == pytest.approx(1.0, rel=1e-3))


@pytest.mark.serial
def test_half_passes_share_the_areas_at_edges_and_corners(comm):
    data = boxes([(2, 2, 1), (2, 2, 1)], [(1.0, 1.0, 0.5), (1.0, 1.0, 0.5)])
    data.X[np.unique(data.cells[data.body == 1])] += [0.0, 0.0, 0.5]
    mesh, cells, _, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.SaintVenantKirchhoff(E, 0.0, 1e3)
    bodies = [nts.Body(V, cells, tag[f"body {i}"], material) for i in (0, 1)]
    pairs = nts.two_half_passes(*(nts.boundary_of(body) for body in bodies), nts.Penalty(1e9))
    ends = [fem.locate_dofs_geometrical(V, lambda x, z=z: np.isclose(x[2], z)) for z in (0.0, 1.0)]
    travels = np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, -STRAIN])
    bcs = [fem.dirichletbc(travel, dofs, V) for travel, dofs in zip(travels, ends, strict=True)]
    stepper = nts.QuasiStatic(bodies, pairs, dt=1.0, bcs=bcs)
    stepper.advance()
    for contact in stepper.contacts:
        touches = np.isclose(stepper.x[contact.nodes.nodes, 2], 0.5, atol=1e-2)
        assert contact.pressure[touches] == pytest.approx(PRESSURE, rel=0.02)
        assert contact.traction[touches, :2] == pytest.approx(0.0, abs=1e-3 * PRESSURE)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("dim", [2, once(3)])
@pytest.mark.parametrize("offset", [0.23, once(0.26), once(0.305)])
def test_pressure_below_an_edge_that_covers_a_sliver_of_a_facet_is_not_too_large(comm, dim, offset):
    """A block rests on a plate by its weight. The edge of the block is next to nodes of the plate.

    The force on a sliver divided by its area exceeded the mean pressure up to 60 times.
    """
    middle, across, one = ((0.13,), (0.7,), (1.0,)) if dim == 3 else ((), (), ())
    counts = (8, 8, 3) if dim == 3 else (13, 5)

    def build(model):
        add = nts.parts.add_box if dim == 3 else nts.parts.add_rectangle
        add(model, "plate", corner=(0,) * dim, size=(1, *one, 0.5), cells=counts)
        corner, size = (offset, *middle, 0.5), (0.6, *across, 0.5)
        add(model, "block", corner=corner, size=size, cells=(3,) * dim)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
    material = nts.NeoHookean(1e6, 0.3, 1e3)
    plate, block = (nts.Body(V, cells, tag[name], material) for name in ("plate", "block"))
    bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[dim - 1], 0))
    bcs = [fem.dirichletbc(np.zeros(dim), bottom, V)]
    weight = nts.Gravity([block], (0,) * (dim - 1) + (-9.81,))
    pairs = nts.all_pairs([plate, block], friction=0.3)
    stepper = nts.QuasiStatic([plate, block], pairs, dt=1.0, bcs=bcs, loads=[weight])
    stepper.advance()
    (pair,) = nts.Diagnostics(stepper).pairs().values()
    mean = 0.5 * 1e3 * 9.81
    assert abs(pair.force[dim - 1]) == pytest.approx(mean * 0.6 * (across or one or (1.0,))[0])
    assert mean < pair.largest_pressure < 2.2 * mean
    pressure = nts.Fields(stepper).contact_pressure()
    integral = comm.allreduce(fem.assemble_scalar(fem.form(pressure * ufl.ds)))
    # Nodes outside the edge have a pressure, too, and their whole facets count here.
    assert integral < 1.8 * abs(pair.force[dim - 1])


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("method", ["mortar", once("node-to-segment")])
@pytest.mark.parametrize("degree", [1, once(2)])
def test_nodes_pressed_by_a_vertex_are_in_contact(comm, agree, method, degree):
    """The corner of a turned square presses into the middle of a facet of a plate.

    The nodes around receive the force. At degree 1 each has the area of a facet.
    """

    def build(model):
        nts.parts.add_rectangle(model, "plate", corner=(-3.5, -1), size=(7, 1), cells=(7, 1))
        nts.parts.add_rectangle(model, "square", corner=(9, 9), size=(2, 2), cells=(2, 2))

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    x = mesh.geometry.x
    of_square = x[:, 0] > 8
    across, up = x[of_square, :2].T - 9
    x[of_square, :2] = np.column_stack([across - up, across + up]) / np.sqrt(2)
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    material = nts.NeoHookean(1e6, 0.3, 1e3)
    plate, square = (nts.Body(V, cells, tag[name], material) for name in ("plate", "square"))
    pairs = [nts.ContactPair(nts.boundary_of(plate), nts.boundary_of(square), method=method)]
    ends = [
        fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], -1.0)),
        fem.locate_dofs_geometrical(V, lambda x: x[1] > 1.2),
    ]
    travels = np.zeros(2), np.array([0.0, -0.05])
    bcs = [fem.dirichletbc(travel, dofs, V) for travel, dofs in zip(travels, ends, strict=True)]
    stepper = nts.QuasiStatic([plate, square], pairs, dt=0.5, bcs=bcs)
    stepper.advance()
    (pair,) = nts.Diagnostics(stepper).pairs().values()
    assert pair.force[1] < 0 < pair.largest_pressure
    presses = stepper.contacts[0].pressure > 0
    if degree == 1:
        assert pair.contact_area == pytest.approx(comm.allreduce(np.count_nonzero(presses)))
    assert 1.0 <= pair.contact_area <= 4.0001
    x = stepper.x[pairs[0].nodes.nodes[presses]]
    assert agree(np.all(np.abs(x[:, 0]) < 1.6) and np.all(np.abs(x[:, 1]) < 0.06))
