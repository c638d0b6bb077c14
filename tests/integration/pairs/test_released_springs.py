"""Loaded springs whose nodes leave all segments give their energy back."""

from functools import partial
from itertools import product

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers.once import once, once_except

E, RHO, DT = 1e5, 1e3, 2e-3  # Pa, kg/m^3, s


def add_blocks(model, dim):
    middle = (0.2,) * (dim - 2)
    add = parts.add_box if dim == 3 else parts.add_rectangle
    upper, lower = (0.5, *middle, 0.25), (1.0, *(2 * m for m in middle), 0.5)
    start, cells = (0.6, *(0.11 for _ in middle), 0.001), (4, *(1 for _ in middle), 2)
    add(model, "upper", corner=start, size=upper, cells=cells)
    add(model, "lower", corner=(0.0, *(0.0 for _ in middle), -0.5), size=lower, cells=cells)


def slide_over_a_rim(
    comm, dim, method, *, rigid="", degree=1, held=False, scheme=nts.EnergyMomentum
):
    """A block strikes the end of a lower one and slides over its rim; returns the stepper."""
    mesh, cells, facets, tag = nts.read_mesh(partial(add_blocks, dim=dim), comm)
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
    stepper = scheme([upper, lower], [pair], dt=DT, bcs=bcs)
    stepper.set_velocity(upper, (6.0, *(0.0,) * (dim - 2), -1.0))
    return stepper


OPTIONS = {
    "": {},
    "rigid upper": {"rigid": "upper"},
    "rigid lower": {"rigid": "lower"},
    "degree 2": {"degree": 2},
    "held": {"held": True},
}
CASES = {
    f"{name or 'plain'}, {method}, {dim}-D": (OPTIONS[name], method, dim)
    for name, method, dim in product(OPTIONS, ("node-to-segment", "mortar"), (2, 3))
}
# With ranks each option, method and dimension occurs, but not each two of them: what is summed over
# ranks is the same in all.
ON_SEVERAL_RANKS = (
    "plain, mortar, 3-D",
    "rigid upper, node-to-segment, 3-D",
    "rigid lower, mortar, 2-D",
    "degree 2, node-to-segment, 2-D",
    "held, mortar, 2-D",
)


@pytest.mark.parametrize(
    ("method", "dim"),
    [("node-to-segment", 2), once("node-to-segment", 3), once("mortar", 2), ("mortar", 3)],
)
def test_generalized_alpha_gives_energy_of_released_springs_back(comm, method, dim):
    stepper = slide_over_a_rim(comm, dim, method, scheme=nts.GeneralizedAlpha)
    diagnostics = nts.Diagnostics(stepper)
    start = diagnostics.balance()
    given = sum(report.contact_work.facet_change for report in stepper.run(until=130 * DT))
    last = diagnostics.balance()
    # The scheme itself conserves energy to 3e-4 in this run; 1e-3 to 5e-3 were lost at the rim.
    assert abs(given) < 1e-5 * start.total_energy
    assert last.total_energy == pytest.approx(start.total_energy, rel=5e-4)
    scale = np.linalg.norm(start.linear_momentum)
    np.testing.assert_allclose(last.linear_momentum, start.linear_momentum, atol=1e-11 * scale)


@pytest.mark.parametrize("case", once_except(CASES, *ON_SEVERAL_RANKS))
def test_energy_and_momenta_stay_when_loaded_springs_lose_their_segments(comm, case):
    options, method, dim = case
    stepper = slide_over_a_rim(comm, dim, method, **options)
    contact, diagnostics = stepper.contacts[0], nts.Diagnostics(stepper)
    start, lost = diagnostics.balance(), 0.0
    old = contact.history
    for _ in stepper.run(until=0.15):
        new = contact.history
        lost += old.energy[(old.energy > 0) & (new.key < 0)].sum()
        old = new
    # A check of the scene: without an impulse this energy would be lost.
    assert comm.allreduce(lost) > 1e-4 * start.total_energy
    end = diagnostics.balance()
    assert end.total_energy == pytest.approx(start.total_energy, rel=1e-12)
    if "held" in options:
        return
    for quantity in ("linear_momentum", "angular_momentum"):
        before, after = (np.asarray(getattr(each, quantity)) for each in (start, end))
        assert np.abs(after - before).max() < 1e-12 * np.abs(before).max()


def losses(caplog):
    """Lost energies that warnings name [J]."""
    warnings = [each.getMessage() for each in caplog.records if "have lost" in each.getMessage()]
    return [float(text.split("energy of ")[1].split()[0]) for text in warnings]


@pytest.mark.serial
def test_warning_names_the_energy_of_springs_between_bodies_that_cannot_move(comm, caplog):
    mesh, cells, facets, tag = nts.read_mesh(partial(add_blocks, dim=2), comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    upper, lower = (
        nts.Body(V, cells, tag[name], nts.NeoHookean(E=E, nu=0.3, rho=RHO))
        for name in ("upper", "lower")
    )
    nodes, segments = (nts.Surface(V, facets, tag[n]) for n in ("upper_bottom", "lower_top"))
    moved = fem.Function(V)
    dofs = fem.locate_dofs_topological(V, 2, cells.indices)
    stepper = nts.EnergyMomentum(
        [upper, lower],
        [nts.ContactPair(nodes, segments, nts.Penalty(1e5))],
        dt=DT,
        bcs=[fem.dirichletbc(moved, dofs)],
        update=lambda t: moved.interpolate(
            lambda x: np.outer([6 * t, -min(t, 0.005)], x[1] > 1e-6)
        ),
    )
    while not losses(caplog) and stepper.t < 0.15:
        report = stepper.advance()
    # One node is beyond the end of the lower block at x = 1 m now. It was 3 mm deep.
    assert stepper.t == pytest.approx(0.006)
    assert report.contact_work.facet_change == pytest.approx(-0.5 * 1e5 * 0.003**2, rel=1e-9)
    assert losses(caplog) == [pytest.approx(0.45, rel=5e-3)]


@pytest.mark.serial
@pytest.mark.parametrize(("fall", "is_reported"), [(6.0, True), (1.0, False)])
def test_explicit_steps_warn_of_energy_that_springs_lose_at_a_rim(comm, caplog, fall, is_reported):
    """Beyond a twentieth of the energy: 8 % and 0.4 % are lost."""
    stepper = slide_over_a_rim(comm, 2, "node-to-segment", scheme=nts.CentralDifference)
    stepper.set_velocity(stepper.bodies[0], (6.0, -fall))
    diagnostics = nts.Diagnostics(stepper)
    start = diagnostics.balance().total_energy
    list(stepper.run(until=0.1))
    lost = start - diagnostics.balance().total_energy
    assert (lost > 0.05 * start) == is_reported
    reported = losses(caplog)
    assert len(reported) == is_reported
    if is_reported:
        assert 0.05 * start < reported[0] < 1.1 * lost
