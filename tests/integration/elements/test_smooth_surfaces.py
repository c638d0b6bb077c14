"""Contact with smooth surfaces: round bodies that collide, roll and are pressed together."""

import logging

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.integrators.implicit import implicit_stepper
from helpers.collision import check_balances, collide
from helpers.models.round import balls, marble, rings, throw
from helpers.once import once
from helpers.scene import gathered


def run(stepper, num_steps):
    """Throw the bodies, and collide."""
    throw(stepper)
    return collide(stepper, num_steps)


LAWS = {
    "elastic": {},
    "triangles": {"cell": "triangle"},
    "plastic": {"enforcement": nts.LagrangeMultiplier("plastic")},
    "restitution": {"enforcement": nts.LagrangeMultiplier("restitution", e=0.5)},
    "rigid restitution": {
        "enforcement": nts.LagrangeMultiplier("restitution", e=0.5),
        "rigid": True,
    },
    "springs": {"enforcement": nts.Penalty()},
    "friction": {"friction": nts.Coulomb(0.3)},
    "springs and friction": {"enforcement": nts.Penalty(), "friction": nts.Coulomb(0.3)},
    "rigid": {"rigid": True},
}


METHODS = pytest.mark.parametrize("method", ["node-to-segment", "mortar"])


@pytest.mark.serial
@METHODS
@pytest.mark.parametrize("law", LAWS)
def test_axisymmetric_bodies_bounce_with_exact_energy_and_momenta(comm, law, method):
    first, last, given, active = run(rings(comm, angle=0.4, method=method, **LAWS[law]), 30)
    check_balances(first, last, given)
    assert active > 0
    if law in ("elastic", "triangles", "rigid"):
        assert abs(given) < 1e-10 * first.total_energy
    if "friction" in law or "restitution" in law:
        assert given < -1e-4 * first.total_energy


@pytest.mark.serial
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@METHODS
def test_balls_bounce_with_exact_energy_and_momenta(comm, cell, method):
    first, last, given, active = run(balls(comm, cell=cell, method=method), 8)
    check_balances(first, last, given)
    assert active > 0
    assert abs(given) < 1e-10 * first.total_energy


@pytest.mark.serial
@METHODS
def test_friction_of_balls_dissipates_and_keeps_momenta(comm, method):
    first, last, given, active = run(balls(comm, friction=nts.Coulomb(0.3), method=method), 8)
    check_balances(first, last, given)
    assert active > 0
    assert given < -1e-4 * first.total_energy


@METHODS
def test_any_number_of_ranks_finds_the_same(comm, method):
    how = {"friction": nts.Coulomb(0.3), "method": method}
    steppers = [rings(c, **how) for c in (comm, MPI.COMM_SELF)]
    for stepper in steppers:
        throw(stepper)
        for _ in range(10):
            report = stepper.advance()
        assert report.num_active > 0
    places = [gathered(s.u.function_space, s.x) for s in steppers]
    assert np.abs(places[0] - places[1]).max() < 1e-9


@pytest.mark.serial
@pytest.mark.parametrize("scheme", [nts.Midpoint, nts.GeneralizedAlpha])
def test_other_schemes_keep_linear_momentum_and_nearly_the_energy(comm, scheme):
    stepper = rings(comm, scheme=scheme, enforcement=nts.Penalty())
    first, last, given, active = run(stepper, 20)
    check_balances(first, last, given, tol=1e-3)
    assert active > 0
    change = last.linear_momentum - first.linear_momentum
    assert np.linalg.norm(change) < 1e-11 * np.linalg.norm(first.linear_momentum)


@pytest.mark.serial
@METHODS
def test_a_resumed_run_is_the_whole_one_and_needs_smooth_segments(comm, tmp_path, method):
    whole, part, rest, flat = (
        rings(comm, friction=nts.Coulomb(0.3), smooth=smooth, method=method)
        for smooth in (True, True, True, False)
    )
    for stepper in (whole, part):
        throw(stepper)
    for stepper, num_steps in ((part, 5), (rest, 9)):
        with nts.Recorder(
            tmp_path / "run", stepper, checkpoint_every=1, resume=True, fields="xdmf"
        ) as recorder:
            for step in stepper.run(until=num_steps * stepper.dt):
                recorder.write(step)
        assert stepper.contacts[0].history.active.any()
    for _ in whole.run(until=9 * whole.dt):
        pass
    assert np.array_equal(rest.x, whole.x)
    with pytest.raises(ValueError, match="pair 1"):
        nts.Recorder(tmp_path / "run", flat, resume=True, fields="xdmf").__enter__()


@pytest.fixture
def warned(comm, caplog):
    """Number of warnings so far on rank 0, returned on all ranks. Collective."""
    caplog.set_level(logging.WARNING, "dolfinx_nts")
    return lambda: comm.bcast(sum("inside" in message for message in caplog.messages))


@pytest.mark.at_most_two_ranks
def test_contact_with_a_smooth_concave_surface_is_no_overlap(comm, warned):
    stepper = marble(comm)
    stepper.set_velocity(stepper.bodies[1], (1.0, -0.5))
    diagnostics = nts.Diagnostics(stepper)
    before, active = diagnostics.balance(), 0
    deepest = 0.0
    for report in stepper.run(until=0.8):
        active += report.num_active > 0
        depths = [overlap.depth for overlap in diagnostics.overlaps()]
        deepest = max([deepest, *depths])
    assert active > 30 and deepest > 0.012  # 0.12 facets of the small ring
    after = diagnostics.balance()
    assert after.total_energy == pytest.approx(before.total_energy, rel=1e-11)
    assert warned() == 0


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("smooth", "depth", "warnings"), [once(True, 0.005, 0), (True, 0.03, 1), once(False, 0.005, 1)]
)
def test_initial_overlaps_with_a_concave_surface_are_reported(
    comm, warned, smooth, depth, warnings
):
    marble(comm, smooth=smooth, depth=depth).advance()
    assert warned() == warnings


@pytest.mark.serial
@pytest.mark.parametrize(("depth", "warnings"), [(0.0, 0), (0.06, 1)])
def test_overlaps_of_round_bodies_are_reported_but_not_contact(comm, warned, depth, warnings):
    stepper = rings(comm)
    # The circles are 0.01 m apart, and their facets up to 0.04 m further.
    stepper.set_displacement(stepper.bodies[1], (0.0, -0.01 - depth))
    throw(stepper)
    active = sum(report.num_active > 0 for report in stepper.run(until=0.2))
    assert warned() == warnings
    assert active or depth


@pytest.mark.serial
def test_nodes_are_put_onto_the_smooth_surface(comm):
    (pair,) = rings(comm).pairs
    pair = nts.ContactPair(
        pair.nodes, pair.segments, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    moved, farthest = nts.close_gaps(pair, within=0.06)
    assert moved > 0 and farthest > 0.01
    X = pair.nodes.V.mesh.geometry.x
    on_circle = np.abs(np.linalg.norm(X, axis=1) - 1) < 1e-6
    assert np.count_nonzero(on_circle) == 16 + moved


@pytest.mark.parametrize("smooth", [False, once(True)])
def test_nodes_between_flat_facets_cause_advice_on_smooth_segments(
    comm, agree, monkeypatch, smooth
):
    text = "nodes that sank into a surface between two segments: 1"
    monkeypatch.setattr(implicit_stepper, "check_penetration", lambda step, dt: text)
    stepper = rings(comm, smooth=smooth)
    throw(stepper)
    with pytest.raises(nts.ConvergenceError, match=text) as raised:
        list(stepper.run(0.1, nts.StepControl(smallest=stepper.dt)))
    assert agree(("smooth=True" in str(raised.value)) != smooth)
