"""Nodes with an active constraint stay active under pressure when their segment changes."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

pytestmark = pytest.mark.at_most_two_ranks

GAP, DT, STEPS = 0.008, 0.01, 12  # m, s, -


def test_loaded_nodes_stay_active_on_shorter_segments(comm):
    def build(model):
        parts.add_rectangle(model, "long", corner=(-4, -1), size=(4, 1), cells=(4, 1))
        parts.add_rectangle(model, "short", corner=(0, -1), size=(4, 1), cells=(8, 1))
        parts.add_rectangle(model, "block", corner=(-1.1, GAP), size=(0.6, 0.4), cells=(3, 2))

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    law = nts.SaintVenantKirchhoff(E=1e7, nu=0.3, rho=1e3)
    block, *grounds = (nts.Body(V, cells, tag[name], law) for name in ("block", "long", "short"))
    below = fem.locate_dofs_geometrical(V, lambda x: x[1] < GAP / 2)
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["block_bottom"]),
        nts.boundary_of(*grounds, where=lambda x: x[1] > -GAP / 2),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    # Each node becomes active at its gap in the first step, and stays under pressure.
    speed = 2.1 * GAP / DT
    load = nts.BodyForce(block, (0.0, -4e3 * speed / DT))
    stepper = nts.EnergyMomentum(
        [block, *grounds],
        [pair],
        dt=DT,
        bcs=[fem.dirichletbc(np.zeros(2), below, V)],
        loads=[load],
    )
    stepper.set_velocity(block, (0.15 / DT, -speed))
    for step in stepper.run(until=STEPS * DT):
        history = stepper.contacts[0].history
        held = history.active
        assert step.num_active == 4
        np.testing.assert_allclose(history.gap[held], GAP, rtol=1e-9)
