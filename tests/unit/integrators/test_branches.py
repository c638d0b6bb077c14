"""Viscous branches: ledger, momenta, relaxation and cyclic loss in closed form, cut steps."""

from functools import partial

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.common.archive import Snapshot
from helpers.interrupted import SCHEMES, scene
from helpers.models.boxed import CLOSED, RHO, VOLUME, Box, Ledger, check_dissipation, swirl
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

YOUNG, NU = 1.0e3, 0.3
SHEAR = YOUNG / (2 * (1 + NU))
BRANCHES = [(0.8, 0.03), (0.5, 0.4)]
alpha = partial(nts.GeneralizedAlpha, rho_inf=0.5)


def rubber(rho=RHO, branches=BRANCHES):
    return nts.SaintVenantKirchhoff(YOUNG, NU, rho, branches=branches)


def percent(error):
    return f"{100 * error:.2g} %"


def held(scheme, box, shear, dt):
    """Stepper of a box that is sheared by given displacements of all nodes, by time."""
    given, dofs = fem.Function(box.V), np.arange(len(box.V.tabulate_dof_coordinates()))

    def update(t):
        given.interpolate(lambda X: np.vstack([shear(t) * X[2], 0 * X[0], 0 * X[0]]))

    bcs = [fem.dirichletbc(given, dofs.astype(np.int32))]
    return scheme([box.body], dt=dt, bcs=bcs, update=update)


@pytest.mark.parametrize(
    ("cell", "scheme"),
    [
        ("hexahedron", nts.EnergyMomentum),
        once("tetrahedron", nts.Midpoint),
        once("tetrahedron", alpha),
    ],
)
def test_branches_only_take_energy_and_all_of_it_is_accounted_for(comm, cell, scheme):
    check_dissipation(comm, cell, rubber(), scheme)


def test_the_defect_of_a_step_agrees_with_its_own_length(comm):
    box = Box(comm, material=rubber())
    stepper = nts.EnergyMomentum([box.body], dt=0.02)
    stepper.set_velocity(box.body, swirl)
    diagnostics = nts.Diagnostics(stepper)
    energy, tiny = diagnostics.balance().kinetic_energy, 1e-12
    for step in stepper.run(until=0.05):  # the last one is half as long
        assert abs(diagnostics.bulk_defect()) <= tiny * energy, step
    stepper.dt = 0.01  # of the next one
    assert abs(diagnostics.bulk_defect()) <= tiny * energy
    saved = Snapshot()
    stepper.serialize(saved)
    stepper.dt = 0.03
    stepper.advance()
    stepper.serialize(saved.rewind())
    assert abs(diagnostics.bulk_defect()) <= tiny * energy


def test_impacts_of_viscous_blocks_lose_the_viscous_dissipation(comm):
    stepper = scene(comm, SCHEMES["branches"]).stepper
    ledger = Ledger(stepper)
    ledger.run(12)
    lost, taken = -ledger.gained, -ledger.total("damping_work")
    assert max(report.num_active for report in ledger.reports) > 0
    assert taken > 1e-3 * ledger.scale
    error = abs(lost - taken) / ledger.scale
    start, end = ledger.start, ledger.diagnostics.balance()
    drift = max(
        np.linalg.norm(getattr(end, name) - getattr(start, name))
        / np.linalg.norm(getattr(start, name))
        for name in ("linear_momentum", "angular_momentum")
    )
    assert error <= 1e-10
    assert drift <= 1e-11


@pytest.mark.serial
def test_stress_of_held_shear_relaxes_as_in_closed_form(comm, table_row):
    shear, time, num_steps = 0.4, 0.4, 300
    box = Box(comm, material=rubber(), shape=(1, 1, 1))
    stepper = held(nts.QuasiStatic, box, lambda t: shear, time / num_steps)
    F = np.eye(3) + shear * np.outer([1, 0, 0], [0, 0, 1])
    E = (F.T @ F - np.eye(3)) / 2
    # All nodes are prescribed, so branches dissipate the energy of their springs.
    deviator = E - np.trace(E) / 3 * np.eye(3)
    ledger, errors = Ledger(stepper), []
    elastic = VOLUME * (SHEAR * np.vdot(E, E) + YOUNG * NU / (1 + NU) / (1 - 2 * NU) / 2
                        * np.trace(E) ** 2)  # fmt: skip
    for _ in range(num_steps):
        ledger.run(1)
        stored = sum(s * np.exp(-2 * stepper.t / tau) for s, tau in BRANCHES)
        exact = elastic + stored * VOLUME * SHEAR * np.vdot(deviator, deviator)
        errors.append(abs(ledger.diagnostics.strain_energy() / exact - 1))
    # Fields contain the stress including the branches.
    over = sum(s * np.exp(-stepper.t / tau) for s, tau in BRANCHES)
    S = 2 * SHEAR * (E + over * deviator) + YOUNG * NU / 1.3 / 0.4 * np.trace(E) * np.eye(3)
    found = nts.Fields(stepper).cauchy_stress().x.array.reshape(-1, 3, 3)
    assert np.abs(found - F @ S @ F.T).max(initial=0) <= 5e-3 * np.abs(S).max()
    table_row("energy at constant shear", "closed form", percent(max(errors)))
    assert max(errors) <= 5e-3
    assert ledger.error <= CLOSED


@pytest.mark.serial
@pytest.mark.parametrize(
    ("scheme", "num_steps"), [(nts.EnergyMomentum, 60), (nts.Midpoint, 60), (nts.QuasiStatic, 800)]
)
def test_cyclic_loss_agrees_with_the_loss_modulus(comm, table_row, scheme, num_steps):
    period, shear, branches = 1.0, 1e-3, [(0.8, 0.1), (0.3, 0.2)]
    omega = 2 * np.pi / period
    box = Box(comm, material=rubber(1e-6, branches), shape=(1, 1, 1))
    stepper = held(scheme, box, lambda t: shear * np.sin(omega * t), period / num_steps)
    works = [step.damping_work for step in stepper.run(until=2 * period)]
    loss = SHEAR * sum(s * omega * tau / (1 + (omega * tau) ** 2) for s, tau in branches)
    exact = np.pi * shear**2 * loss * VOLUME
    error = abs(-sum(works[num_steps:]) / exact - 1)
    table_row(
        f"{scheme.__name__}: loss in a cycle of shear, {num_steps} steps",
        "loss modulus",
        percent(error),
    )
    assert error <= 5e-3


def test_a_cut_step_discards_its_attempt(comm):
    box = Box(comm, material=rubber())
    stepper = nts.EnergyMomentum([box.body], dt=0.02)
    stepper.set_velocity(box.body, swirl)
    stepper.advance()
    before = Snapshot()
    stepper.serialize(before)
    once = [stepper.advance().damping_work for _ in range(2)]
    stepper.serialize(before.rewind())
    # But for the order in which solvers of several ranks sum.
    again = [stepper.advance().damping_work for _ in range(2)]
    assert again == (once if comm.size == 1 else pytest.approx(once, rel=1e-12))


@pytest.mark.serial
def test_a_spinning_body_does_not_relax_by_its_rotation(comm):
    # Dashpots live in the reference frame.
    box = Box(comm, material=rubber())
    stepper = nts.EnergyMomentum([box.body], dt=0.05)
    given = fem.Function(box.V)
    for angle in (0.0, 1.0, 2.5):
        c, s = np.cos(angle), np.sin(angle)
        Q = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        given.interpolate(lambda X, Q=Q: Q @ X - X)
        stepper.set_displacement(box.body, given)
        assert nts.Diagnostics(stepper).strain_energy() <= 1e-12 * YOUNG


@pytest.mark.serial
def test_refused_branches_and_their_messages(comm):
    law = rubber()
    assert "branches=[(0.8, 0.03), (0.5, 0.4)]" in repr(law)
    for wrong in ([(0.0, 1.0)], [(0.5, -1.0)], [(np.inf, 1.0)]):
        with pytest.raises(ValueError, match="of a branch > 0, given"):
            rubber(branches=wrong)
    for wrong in (0.5, [0.5], [(1.0, 2.0, 3.0)], "ab"):
        with pytest.raises(TypeError, match=r"\(share, relaxation time \[s\]\), given"):
            rubber(branches=wrong)
    with pytest.raises(ValueError, match="without branches in PlaneStress"):
        nts.PlaneStress(law)
    box = Box(comm, material=law)
    with pytest.raises(ValueError, match="without branches or plasticity with CentralDifference"):
        nts.CentralDifference([box.body])
