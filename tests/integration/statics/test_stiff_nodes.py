"""Contact of bodies of very different stiffness: which of them gives the nodes."""

import logging

from mpi4py import MPI

import gmsh
import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import locate_entities_boundary

import dolfinx_nts as nts

SIDE, DEPTH = 12.0, 0.002  # of the block, whose half is meshed, and of the dent [m]
WARNING = "let the softer body provide the nodes"


class Punch:
    """Half of a punch of 2 m by 1 m above a block with cells that grow away from it.

    Both have cells of the same size near contact, and the punch is 1e4 times as stiff.
    """

    def __init__(self, cells=20):
        def fill(model):
            occ = model.occ
            block = occ.addRectangle(0, -SIDE, 0, SIDE, SIDE)
            punch = occ.addRectangle(0, 0, 0, 1, 1)
            occ.synchronize()
            model.addPhysicalGroup(2, [block], name="block")
            model.addPhysicalGroup(2, [punch], name="punch")
            near = f"{1 / cells} + 0.25 * Max(0, Sqrt(x*x + y*y) - 1.3)"
            corner = f"{1 / (3 * cells)} + 0.15 * Sqrt((x-1)*(x-1) + y*y)"
            field = model.mesh.field.add("MathEval")
            model.mesh.field.setString(field, "F", f"Min(1, Min({near}, {corner}))")
            model.mesh.field.setAsBackgroundMesh(field)
            for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
                gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)
            for surface in (block, punch):
                model.mesh.setRecombine(2, surface)
            model.mesh.generate(2)

        mesh, cells_of, _, tag = nts.read_mesh(fill, MPI.COMM_WORLD)
        self.V = V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        self.block, self.punch = (
            nts.Body(V, cells_of, tag[name], nts.SaintVenantKirchhoff(modulus, 0.3, 1.0))
            for name, modulus in (("block", 1.0), ("punch", 1e4))
        )
        self.moved = fem.Constant(mesh, 0.0)
        self.bcs = [
            self.held(1, lambda x: x[1] < 1e-9 - SIDE),
            self.held(0, lambda x: x[0] < 1e-9),
            self.held(1, lambda x: x[1] > 1 - 1e-9, self.moved),
        ]

    def held(self, axis, where, value=None):
        value = np.float64(0) if value is None else value
        facets = locate_entities_boundary(self.V.mesh, 1, where)
        part = self.V.sub(axis)
        return fem.dirichletbc(value, fem.locate_dofs_topological(part, 1, facets), part)

    def stepper(self, pairs):
        def update(t):
            self.moved.value = -DEPTH * t

        bodies = [self.block, self.punch]
        return nts.QuasiStatic(bodies, pairs, dt=0.5, bcs=self.bcs, update=update)


@pytest.mark.serial
def test_a_flat_punch_has_the_pressure_of_the_closed_form_by_default():
    """Sadowsky (1928): F / (pi sqrt(a^2 - x^2)) below the middle of a rigid punch of 2 a."""
    scene = Punch()
    (pair,) = nts.all_pairs([scene.block, scene.punch])
    stepper = scene.stepper([pair])
    for _ in stepper.run(until=1.0):
        pass
    force = 2 * abs(nts.Diagnostics(stepper).contact_force()[1])
    x, pressure = stepper.x[pair.nodes.nodes, 0], pair.pressure
    inner = (x < 0.85) & (pressure > 0)
    assert np.count_nonzero(inner) > 15
    np.testing.assert_allclose(
        pressure[inner] * np.pi * np.sqrt(1 - x[inner] ** 2), force, rtol=0.03
    )


@pytest.mark.parametrize("gives", ["block", "punch"])
def test_nodes_on_the_stiffer_body_are_reported_in_statics(gives, caplog):
    scene = Punch(cells=5)
    surfaces = [nts.boundary_of(scene.block), nts.boundary_of(scene.punch)]
    pair = nts.ContactPair(*surfaces[:: 1 if gives == "block" else -1])
    with caplog.at_level(logging.WARNING, logger="dolfinx_nts"):
        scene.stepper([pair])
    first = gives == "punch" and scene.V.mesh.comm.rank == 0
    assert (WARNING in caplog.text) == first


@pytest.mark.parametrize("first", ["block", "punch"])
def test_large_facets_far_from_contact_do_not_choose_the_nodes(first):
    scene = Punch()
    bodies = [scene.block, scene.punch]
    (pair,) = nts.all_pairs(bodies[:: 1 if first == "block" else -1])
    assert pair.nodes.name == "the boundary of block"
