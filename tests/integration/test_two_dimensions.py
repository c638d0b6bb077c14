"""Plane strain in two dimensions: the same scripts, with vectors of two components."""

import dolfinx_nts as nts
import numpy as np
import pytest
from dolfinx import fem
from helpers.plane import blocks, throw

STEPS = 12


def run(scene, stepper, steps=STEPS):
    """Balances of all states of a run, and the reports of its steps."""
    throw(scene, stepper)
    diagnostics = nts.Diagnostics(stepper)
    balances, reports = [diagnostics.balance()], []
    for _ in range(steps):
        reports.append(stepper.advance())
        balances.append(diagnostics.balance())
    return balances, reports


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_oblique_impact_conserves_energy_and_momenta(cell):
    scene = blocks(cell, angle=0.4)
    pair = nts.ContactPair(scene.nodes, scene.segments)
    stepper = nts.EnergyMomentum([scene.lower, scene.upper], [pair], dt=0.01)
    (first, *others), reports = run(scene, stepper)
    assert max(report.num_active for report in reports) > 0
    assert first.linear_momentum.shape == (2,) and first.angular_momentum.shape == (1,)
    for balance in others:
        assert abs(balance.total_energy - first.total_energy) < 1e-10 * first.total_energy
        for name, scale in (("linear_momentum", 1e3), ("angular_momentum", 1e3)):
            change = getattr(balance, name) - getattr(first, name)
            assert np.abs(change).max() < 1e-10 * scale


def test_motion_is_that_of_one_layer_in_space_in_plane_strain():
    # The layer cannot move along z, and is so thin that its forces are a tenth.
    states = []
    for depth in (0.0, 0.1):
        scene = blocks(angle=0.3, depth=depth)
        bcs = []
        if depth:
            z, _ = scene.V.sub(2).collapse()
            dofs = fem.locate_dofs_geometrical((scene.V.sub(2), z), lambda x: np.full(x.shape[1], True))
            bcs = [fem.dirichletbc(fem.Function(z), dofs, scene.V.sub(2))]
        pair = nts.ContactPair(scene.nodes, scene.segments)
        stepper = nts.EnergyMomentum([scene.lower, scene.upper], [pair], dt=0.01, bcs=bcs)
        throw(scene, stepper)
        reports = [stepper.advance() for _ in range(STEPS)]
        assert max(report.num_active for report in reports) > 0
        diagnostics = nts.Diagnostics(stepper)
        balance = diagnostics.balance()
        per_thickness = 1 / (depth or 1.0)
        states.append(
            np.concatenate(
                [
                    diagnostics.centre_of_mass(scene.upper)[:2],
                    diagnostics.body_velocity(scene.lower)[:2],
                    per_thickness * balance.linear_momentum[:2],
                    per_thickness * balance.angular_momentum[-1:],
                    [per_thickness * balance.strain_energy],
                ]
            )
        )
    plane, layer = states
    assert np.abs(plane - layer).max() < 1e-7 * np.abs(plane).max()


@pytest.mark.parametrize(
    ("enforcement", "eps_T"),
    [(nts.LagrangeMultiplier(), None), (nts.LagrangeMultiplier("plastic"), 1e5), (nts.Penalty(), None)],
    ids=["exact stick", "tangential springs", "penalty"],
)
def test_ledger_of_friction_closes(enforcement, eps_T):
    scene = blocks("triangle", angle=-0.7)
    friction = nts.Coulomb(mu=0.3, eps_T=eps_T)
    pair = nts.ContactPair(scene.nodes, scene.segments, enforcement, friction)
    stepper = nts.EnergyMomentum([scene.lower, scene.upper], [pair], dt=0.01)
    balances, reports = run(scene, stepper)
    first, last = balances[0], balances[-1]
    given = sum(sum(report.contact_work) for report in reports)
    size = 1e-10 * first.total_energy
    springs = sum(report.contact_work.springs for report in reports)
    change = last.total_energy - last.contact_energy - first.total_energy
    assert abs(change - given) < size
    assert abs(last.contact_energy + springs) < size
    assert all(report.contact_work.friction <= size for report in reports)
    assert sum(report.contact_work.friction for report in reports) < -1e-3 * first.total_energy
    for name in ("linear_momentum", "angular_momentum"):
        assert np.abs(getattr(last, name) - getattr(first, name)).max() < 1e-7
