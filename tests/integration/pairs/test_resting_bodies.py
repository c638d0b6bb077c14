"""Bodies that rest on springs keep the force that carries them, and do not sink in."""

from mpi4py import MPI

import gmsh
import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts

RADIUS, DROP, THICK = 0.11, 0.02, 0.05  # m
GRAVITY, DT, END = 30.0, 4e-3, 0.6  # m/s^2, s, s


def disc_above_floor(comm, method):
    """A soft, damped disc of degree 2 that falls on an elastic floor and comes to rest."""

    def build(model):
        disc = model.occ.addDisk(0.0, RADIUS + DROP, 0, RADIUS, RADIUS)
        floor = model.occ.addRectangle(-0.3, -THICK, 0, 0.6, THICK)
        model.occ.synchronize()
        model.addPhysicalGroup(2, [disc], name="disc")
        model.addPhysicalGroup(2, [floor], name="floor")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.07)
        model.mesh.generate(2)
        model.mesh.setOrder(2)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    soft = nts.NeoHookean(E=1e6, nu=0.45, rho=1e3, mass_damping=8.0)
    disc = nts.Body(V, cells, tag["disc"], soft)
    floor = nts.Body(V, cells, tag["floor"], nts.NeoHookean(E=1e8, nu=0.3, rho=1e3))
    bottom = fem.locate_dofs_geometrical(V, lambda x: x[1] < -THICK + 1e-9)
    bodies = [disc, floor]
    return nts.EnergyMomentum(
        bodies,
        nts.all_pairs(bodies, method=method),
        dt=DT,
        bcs=[fem.dirichletbc(np.zeros(2), bottom, V)],
        loads=[nts.Gravity(bodies, (0.0, -GRAVITY))],
    )


@pytest.mark.parametrize("method", ["mortar", "node-to-segment"])
def test_disc_that_comes_to_rest_is_carried_and_does_not_sink_in(comm, method, caplog):
    stepper = disc_above_floor(comm, method)
    diagnostics = nts.Diagnostics(stepper)
    weight, (contact,) = diagnostics.bodies()["disc"].mass * GRAVITY, stepper.contacts
    forces, depths, begins, old = [], [], [], contact.history
    for _ in stepper.run(until=END):
        forces.append(diagnostics.between()["disc_floor"][1])
        depths.append(max((each.depth for each in diagnostics.overlaps()), default=0.0))
        offset = contact.history.offset.min(initial=0.0)
        begins.append(comm.allreduce(float(offset), op=MPI.MIN))
        # Mean gaps of loaded nodes do not decrease by a change of their functions alone.
        held = old.active & (contact.history.area > 0)
        assert np.all(contact.history.dual_fraction[held] <= old.dual_fraction[held])
        old = contact.history
    # The disc still vibrates.
    assert np.mean(forces[-50:]) == pytest.approx(weight, rel=0.05)
    # It was 34 mm deep in mortar contact. Facets bulge by 5.6 mm beyond their vertices.
    assert max(depths) < 0.005
    # Springs begin at the surface of the floor: they are compressed by 0.5 mm below the weight.
    assert min(begins[-50:]) > -1e-3
    # Facets overlap between nodes by more than springs are compressed.
    assert "compressed that much" not in caplog.text
