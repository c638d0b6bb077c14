"""Friction of nodes on planes of symmetry: supports carry the force across these."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

pytestmark = pytest.mark.at_most_two_ranks

MU = 0.3  # -
WIDTH, HEIGHT, GAP, RADIUS = 0.05, 0.5, 1e-4, 1.0  # m


@pytest.mark.parametrize("method", ["mortar", "node-to-segment"])
def test_no_friction_acts_across_a_plane_of_symmetry(comm, method):
    """A slice of a round block is pressed down, and then pushed aside until it slides."""

    def build(model):
        for name, cells, z in (("lower", 15, -HEIGHT), ("upper", 20, GAP)):
            corner, size = (-0.5, 0, z), (1, WIDTH, HEIGHT)
            parts.add_box(model, name, corner=corner, size=size, cells=(cells, 1, 4))

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    x, _, z = mesh.geometry.x.T
    z += np.where(z > GAP / 2, (GAP + HEIGHT - z) * x**2 / RADIUS, 0.0)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(E=1e5, nu=0.3, rho=1e3)
    bodies = [nts.Body(V, cells, tag[name], rubber) for name in ("lower", "upper")]
    bottom, top = (nts.Surface(V, facets, tag[name]) for name in ("upper_bottom", "lower_top"))
    pair = nts.ContactPair(
        bottom, top, friction=nts.Coulomb(MU), method=method, enforcement=nts.LagrangeMultiplier()
    )
    travel, still, across = fem.Constant(mesh, np.zeros(3)), np.zeros(3), V.sub(1).collapse()[0]
    everywhere = fem.locate_dofs_geometrical((V.sub(1), across), lambda x: x[0] > -1.0)
    bcs = [fem.dirichletbc(fem.Function(across), everywhere, V.sub(1))]
    for name, value in (("upper_top", travel), ("lower_bottom", still)):
        dofs = fem.locate_dofs_topological(V, 2, facets.find(tag[name]))
        bcs.append(fem.dirichletbc(value, dofs, V))

    def update(t):
        travel.value = [0.004 * max(t - 1.0, 0.0), 0.0, -0.003 * min(t, 1.0)]

    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, update=update)
    for _ in stepper.run(until=2.0):
        history = pair.history
        sideways = np.abs(history.traction[:, 1]).max(initial=0.0)
        pressing = np.abs(history.lambda_N).max(initial=0.0)
        sideways, pressing = np.max(comm.allgather([sideways, pressing]), axis=0)
        assert sideways <= 1e-12 * MU * pressing
