"""Bodies thinner than half a facet: the far side of a wall is no contact partner."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("thickness", "gap", "dt"), [(0.1, 0.05, 0.01), (0.1, 0.5, 0.1), (0.02, 0.05, 0.01)]
)
def test_whole_boundaries_of_thin_plates_bounce_by_the_default(comm, thickness, gap, dt):
    """Facets of 1 m: with deep facets as partners, plates repelled each other at a distance."""

    def build(model):
        size = (4, 4, thickness)
        parts.add_box(model, "lower", corner=(-2, -2, -thickness), size=size, cells=(4, 4, 1))
        parts.add_box(model, "upper", corner=(-1.9, -1.8, gap), size=size, cells=(5, 5, 1))

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.NeoHookean(E=1e5, nu=0.3, rho=1e3)
    bodies = [nts.Body(V, cells, tag[name], rubber) for name in ("lower", "upper")]
    pair = nts.ContactPair(nts.boundary_of(bodies[1]), nts.boundary_of(bodies[0]))
    stepper = nts.EnergyMomentum(bodies, [pair], dt=dt)
    stepper.set_velocity(bodies[1], (0, 0, -1.0))
    diagnostics = nts.Diagnostics(stepper)
    before = diagnostics.balance()
    for report in stepper.run(until=1.5 * gap + 3 * dt):
        # No force acts before they touch.
        assert report.num_active == 0 or report.t >= gap - dt / 2
    after = diagnostics.balance()
    assert abs(after.total_energy / before.total_energy - 1) < 1e-9
    assert diagnostics.body_velocity(bodies[0])[2] < -0.5
    change = after.linear_momentum - before.linear_momentum
    assert np.abs(change).max() < 1e-9 * np.abs(before.linear_momentum).max()
