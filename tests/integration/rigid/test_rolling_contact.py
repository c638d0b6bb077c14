"""A rigid disc that rolls between two elastic layers, in statics, held by friction alone."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

pytestmark = pytest.mark.serial

RADIUS, DEPTH, TRAVEL, STEPS = 0.25, 0.3, 0.02, 14  # m, m, m, -


def rolling(cells: int, mu: float, squeeze: float) -> tuple[nts.QuasiStatic, nts.RigidBody]:
    """Squeeze a disc between two layers by a distance [m] in a step, then shift the upper one.

    The lower layer has so many cells along its length of 1 m, the upper one more.
    """

    def build(model):
        disc = model.occ.addDisk(0, 0, 0, RADIUS, RADIUS)
        model.occ.synchronize()
        model.addPhysicalGroup(2, [disc], name="disc")
        model.mesh.setSize(model.getEntities(0), 0.15)
        model.mesh.setRecombine(2, disc)
        model.mesh.generate(2)
        for name, y, number in (("lower", -RADIUS - DEPTH, cells), ("upper", RADIUS, cells + 1)):
            size = (1.0, DEPTH)
            parts.add_rectangle(model, name, corner=(-0.5, y), size=size, cells=(number, 3))

    mesh, found, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    rubber = nts.SaintVenantKirchhoff(1e6, 0.3, 1e3)
    lower, upper = (nts.Body(V, found, tag[name], rubber) for name in ("lower", "upper"))
    disc = nts.RigidBody(V, found, tag["disc"], rho=1e3)
    rim = nts.boundary_of(disc, smooth=nts.RigidSphere((0.0, 0.0), RADIUS))
    pairs = [
        nts.ContactPair(
            nts.Surface(V, facets, tag[side]),
            rim,
            friction=nts.Coulomb(mu),
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
        for side in ("lower_top", "upper_bottom")
    ]
    shift = fem.Constant(mesh, (0.0, 0.0))

    def update(t):
        shift.value[:] = TRAVEL * max(t - 1, 0), -squeeze * min(t, 1)

    below, above = (
        fem.locate_dofs_topological(V, 1, facets.find(tag[side]))
        for side in ("lower_bottom", "upper_top")
    )
    bcs = [fem.dirichletbc(np.zeros(2), below, V), fem.dirichletbc(shift, above, V)]
    return nts.QuasiStatic([lower, upper, disc], pairs, dt=1.0, bcs=bcs, update=update), disc


@pytest.mark.parametrize(
    ("cells", "mu", "squeeze"),
    [
        (10, 0.15, 0.008),
        (10, 0.15, 0.012),
        (12, 0.1, 0.01),
        (13, 0.15, 0.008),
        (16, 0.1, 0.01),
    ],
)
def test_a_disc_rolls_on_from_node_to_node(cells, mu, squeeze, caplog):
    """It sticks to both layers, though single nodes slide: an equilibrium is near each last one."""
    stepper, disc = rolling(cells, mu, squeeze)
    for step in stepper.run(until=STEPS):
        lower, upper, *_ = (np.array(reaction.force) for reaction in step.reactions)
        size = np.linalg.norm(lower)
        assert size > 1.0
        assert lower + upper == pytest.approx(0, abs=1e-9 * size)
    assert not [text for text in caplog.messages if "no equilibrium near" in text]
    x, _ = nts.Diagnostics(stepper).centre_of_mass(disc)[:2]
    assert x == pytest.approx(TRAVEL * (STEPS - 1) / 2, rel=0.1)
