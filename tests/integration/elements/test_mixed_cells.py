"""Bodies of different cells in one scene: tetrahedra strike prisms strike hexahedra."""

from typing import Any

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

BLOCK = {"corner": (0.0, 0.0, -0.21), "size": (1.0, 1.0, 0.2), "cells": (3, 3, 1)}
BALL = {"centre": (0.45, 0.5, 0.52), "radius": 0.3, "cells_per_edge": 2, "layers": 1}


def build(model: Any) -> None:
    """Add a slab of prisms, a block of hexahedra below and a ball of tetrahedra above."""
    bottom = model.occ.addRectangle(0, 0, 0, 1, 1)
    slab = model.occ.extrude([(2, bottom)], 0, 0, 0.2, numElements=[1], recombine=True)
    model.occ.synchronize()
    model.mesh.setSize(model.getEntities(0), 0.5)
    model.mesh.generate(3)
    model.addPhysicalGroup(3, [slab[1][1]], name="slab")
    nts.parts.add_box(model, "block", **BLOCK, cell="hexahedron")
    nts.parts.add_solid_ball(model, "ball", **BALL, cell="tetrahedron")


@pytest.mark.parametrize("friction", [once(None), nts.Coulomb(0.3)])
def test_an_impact_through_three_kinds_of_cells_conserves_everything(comm, friction):
    data = nts.read_mesh(build, comm)
    V = fem.functionspace(data.mesh, ("Lagrange", 1, (3,)))
    rubber = nts.NeoHookean(E=1e5, nu=0.3, rho=1e3)
    ball, slab, block = (
        nts.Body(V, data.cells, data.tag[name], rubber) for name in ("ball", "slab", "block")
    )
    slab_skin = nts.boundary_of(slab)
    pairs = [
        nts.ContactPair(
            nts.boundary_of(ball),
            slab_skin,
            friction=friction,
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        ),
        nts.ContactPair(
            slab_skin,
            nts.boundary_of(block),
            friction=friction,
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        ),
    ]
    stepper = nts.EnergyMomentum([ball, slab, block], pairs, dt=0.002)
    stepper.set_velocity(ball, (0.5, 0.0, -3.0))
    diagnostics = nts.Diagnostics(stepper)

    def totals() -> tuple[float, Any]:
        balance = diagnostics.balance()
        return balance.total_energy, np.append(balance.linear_momentum, balance.angular_momentum)

    energy, momenta = totals()
    dissipated, touched = 0.0, set()
    for _ in range(25):
        report = stepper.advance()
        dissipated -= report.contact_work.friction
        touched |= {i for i, pair in enumerate(pairs) if comm.allreduce(pair.history.active.sum())}
    after, momenta_after = totals()
    assert touched == {0, 1}
    assert (dissipated > 0) == (friction is not None)
    assert after + dissipated == pytest.approx(energy, rel=1e-10)
    np.testing.assert_allclose(momenta_after, momenta, atol=1e-11 * np.abs(momenta).max())
