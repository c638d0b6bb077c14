"""Contact of surfaces of curved cells by curved facets."""

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.laws import NODAL
from helpers.models.boxed import Ledger
from helpers.once import once

pytest.importorskip("gmsh")
pytestmark = pytest.mark.at_most_two_ranks

ENERGY_TOLERANCE, MOMENTUM_TOLERANCE, POSITION_TOLERANCE = 1e-10, 1e-11, 1e-9
RUBBER = nts.NeoHookean(E=1e5, nu=0.3, rho=1e3)
RADII, TRAVEL = (0.5, 0.4), np.array([0.55, 0.72, 0.0])  # m
kinds = pytest.mark.parametrize("cell", ["triangle", "quadrilateral", once("tetrahedron")])


def balls(model: Any, cell: str) -> None:
    """Add two balls, or discs, side by side, with cells of second order."""
    dim = 3 if cell == "tetrahedron" else 2
    for number, (radius, at) in enumerate(zip(RADII, (0 * TRAVEL, TRAVEL), strict=True)):
        if dim == 3:
            body = model.occ.addSphere(*at, radius)
        else:
            body = model.occ.addDisk(*at, radius, radius)
        model.occ.synchronize()
        model.addPhysicalGroup(dim, [body], name=f"ball {number}")
        if cell == "quadrilateral":
            model.mesh.setRecombine(2, body)
    model.mesh.setSize(model.getEntities(0), 0.4 if dim == 3 else 0.25)
    model.mesh.generate(dim)
    model.mesh.setOrder(2)


def collision(comm: Any, cell: str, scheme: Any = nts.EnergyMomentum, **how: Any) -> Any:
    """Oblique collision of two spinning balls. Collective."""
    mesh, cells, _, tag = nts.read_mesh(lambda model: balls(model, cell), comm)
    dim = mesh.topology.dim
    V = fem.functionspace(mesh, ("Lagrange", 2, (dim,)))
    bodies = [nts.Body(V, cells, tag[f"ball {i}"], RUBBER) for i in range(2)]
    surfaces = [nts.boundary_of(body) for body in bodies]
    pair = nts.ContactPair(surfaces[1], surfaces[0], **(NODAL | {"method": "mortar"} | how))
    stepper = scheme(bodies, [pair], dt=5e-3)
    for body, v in zip(bodies, ((1.0, 0.5, 0.2), (-1.0, -1.5, 0.1)), strict=True):
        stepper.set_velocity(body, v[:dim])
    return stepper


@kinds
@pytest.mark.parametrize(
    ("enforcement", "friction"),
    [
        once(nts.LagrangeMultiplier(), None),
        once(nts.LagrangeMultiplier(), nts.Coulomb(0.1)),
        once(nts.LagrangeMultiplier("plastic"), nts.Coulomb(0.3, eps_T=1e5)),
        (nts.Penalty(), nts.Coulomb(0.3)),
    ],
)
def test_collision_conserves_energy_and_momenta(comm, cell, enforcement, friction):
    stepper = collision(comm, cell, enforcement=enforcement, friction=friction)
    ledger = Ledger(stepper)
    ledger.run(12)
    assert max(report.num_active for report in ledger.reports) >= 2
    assert ledger.error <= ENERGY_TOLERANCE
    taken = sum(report.contact_work.friction for report in ledger.reports)
    assert (taken < -1e-4 * ledger.start.kinetic_energy) if friction else taken == 0
    after = ledger.diagnostics.balance()
    for name in ("linear", "angular"):
        a, b = (getattr(s, f"{name}_momentum") for s in (ledger.start, after))
        assert np.linalg.norm(b - a) <= MOMENTUM_TOLERANCE * np.linalg.norm(a)


@kinds
def test_all_ranks_and_each_alone_agree(comm, cell):
    results = []
    for some in (comm, MPI.COMM_SELF):
        stepper = collision(some, cell, friction=nts.Coulomb(0.3))
        reports = [stepper.advance() for _ in range(8)]
        diagnostics = nts.Diagnostics(stepper)
        energies = diagnostics.balance()
        results.append(
            (
                max(report.num_active for report in reports),
                energies.kinetic_energy,
                energies.strain_energy,
                sum(report.contact_work.friction for report in reports),
                *diagnostics.contact_force(),
            )
        )
    together, alone = map(np.array, results)
    assert together[0] >= 2
    scale = np.array([1, *[alone[1]] * 3, *[np.abs(alone[4:]).max()] * (len(alone) - 4)])
    assert (np.abs(together - alone) <= POSITION_TOLERANCE * scale).all(), (together, alone)
