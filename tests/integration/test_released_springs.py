"""Loaded springs whose nodes leave all segments give their energy back."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

E, RHO, DT = 1e5, 1e3, 2e-3  # Pa, kg/m^3, s


def slide_over_a_rim(comm, dim, method, *, rigid="", degree=1, held=False):
    """A block strikes the end of a lower one and slides over its rim; returns the stepper."""
    middle = (0.2,) * (dim - 2)
    add = parts.add_box if dim == 3 else parts.add_rectangle

    def build(model):
        upper, lower = (0.5, *middle, 0.25), (1.0, *(2 * m for m in middle), 0.5)
        start, cells = (0.6, *(0.11 for _ in middle), 0.001), (4, *(1 for _ in middle), 2)
        add(model, "upper", corner=start, size=upper, cells=cells)
        add(model, "lower", corner=(0.0, *(0.0 for _ in middle), -0.5), size=lower, cells=cells)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    soft = nts.NeoHookean(E=E, nu=0.3, rho=RHO)

    def body(name):
        if name == rigid:
            return nts.RigidBody(V, cells, tag[name], RHO)
        return nts.Body(V, cells, tag[name], soft)

    upper, lower = body("upper"), body("lower")
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["upper_bottom"]),
        nts.Surface(V, facets, tag["lower_top"]),
        nts.Penalty(),
        method=method,
    )
    bcs = []
    if held:
        bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[dim - 1], -0.5))
        bcs = [fem.dirichletbc(np.zeros(dim), bottom, V)]
    stepper = nts.EnergyMomentum([upper, lower], [pair], dt=DT, bcs=bcs)
    stepper.set_velocity(upper, (6.0, *(0.0 for _ in middle), -1.0))
    return stepper


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
@pytest.mark.parametrize(
    "options",
    [{}, {"rigid": "upper"}, {"rigid": "lower"}, {"degree": 2}, {"held": True}],
    ids=["", "rigid upper", "rigid lower", "degree 2", "held"],
)
def test_energy_and_momenta_stay_when_loaded_springs_lose_their_segments(
    comm, dim, method, options
):
    stepper = slide_over_a_rim(comm, dim, method, **options)
    contact, diagnostics = stepper.contacts[0], nts.Diagnostics(stepper)
    start, lost = diagnostics.balance(), 0.0
    old = contact.history
    for _ in stepper.run(until=0.15):
        new = contact.history
        lost += old.energy[(old.energy > 0) & (new.key < 0)].sum()
        old = new
    # The scene is what it should be: without an impulse this energy would be missing.
    assert comm.allreduce(lost) > 1e-4 * start.total_energy
    end = diagnostics.balance()
    assert end.total_energy == pytest.approx(start.total_energy, rel=1e-12)
    if "held" in options:
        return
    for quantity in ("linear_momentum", "angular_momentum"):
        before, after = (np.asarray(getattr(each, quantity)) for each in (start, end))
        assert np.abs(after - before).max() < 1e-12 * np.abs(before).max()
