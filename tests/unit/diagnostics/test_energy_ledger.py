"""Ledger of a run: sums of made-up steps, counted by hand."""

import numpy as np
import pytest

from dolfinx_nts.common.archive import Snapshot
from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.diagnostics.balance import Balance
from dolfinx_nts.diagnostics.energy_ledger import EnergyLedger
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.model.reaction import Reaction

pytestmark = pytest.mark.at_most_two_ranks

CONTACT = ContactWork(
    persistent=1.0,
    activation=-2.0,
    facet_change=4.0,
    springs=4096.0,
    friction=-8.0,
    equilibrium=512.0,
    refund=-1024.0,
    obstacles=8192.0,
)


def balance(t, energy, momentum=(0.0, 0.0, 0.0)):
    """State with some kinetic energy and linear momentum."""
    return Balance(
        time=t,
        kinetic_energy=energy,
        strain_energy=0.0,
        contact_energy=0.0,
        linear_momentum=np.array(momentum),
        angular_momentum=np.zeros(3),
        contact_force=np.zeros(3),
        active_nodes=0,
        min_gap=np.nan,
    )


def report(step, iterations):
    """Report with a power of two as the work of each cause."""
    return StepReport(
        step=step,
        t=0.1 * step,
        dt=0.1,
        newton_iterations=iterations,
        active_set_changes=0,
        residual_norms=(1.0,),
        num_active=0,
        num_segments=0,
        num_sleeping=0,
        contact_work=CONTACT,
        damping_work=-64.0,
        solver_work=128.0,
        load_works=(10.0, 6.0),
        reactions=(Reaction((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 32.0),),
    )


@pytest.fixture
def ledger():
    """Steps 8 and 9 of a run, after which the energy is 300 J larger."""
    ledger = EnergyLedger(7, balance(0.7, 1000.0, (3.0, 4.0, 0.0)), num_loads=2, num_supports=1)
    ledger.add(report(8, 5), 256.0, balance(0.8, 400.0, (3.0, 4.0, -2.0)))
    ledger.add(report(9, 2), 256.0, balance(0.9, 1300.0, (3.0, 5.0, 0.0)))
    return ledger


def test_every_cause_is_summed_on_its_own_and_the_remainder_is_unaccounted(ledger):
    causes = {
        "energy_bulk": 512.0,
        "energy_loads": 32.0,
        "energy_supports": 64.0,
        "energy_obstacles": 16384.0,
        "energy_damping": -128.0,
        "energy_persistent_contact": 2.0,
        "energy_activation": -4.0,
        "energy_facet_change": 8.0,
        "energy_friction": -16.0,
        "energy_solver": 256.0,
        "energy_surface_equilibrium": 1024.0,
        "energy_refund": -2048.0,
    }
    assert ledger.columns() == {
        **causes,
        "energy_unaccounted": 300.0 + 298.0 - 16384.0,
        "external_work": 96.0 + 16384.0,
        "friction_dissipation": 16.0,
    }
    assert list(ledger.columns())[: len(causes)] == list(causes)
    assert [each.tolist() for each in ledger.each.values()] == [[20.0, 12.0], [64.0]]


@pytest.mark.serial
def test_lines_of_the_summary_count_steps_and_largest_drifts(ledger):
    assert (ledger.step, ledger.num_steps) == (9, 2)
    assert ledger.iterations() == "Newton iterations: 7, mean 3.50, max 5"
    assert ledger.drifts() == [
        "total energy: 1000 J, largest change 6.0e+02 J",
        "linear momentum: 5 kg m/s, largest change 2.0e+00 kg m/s",
        "angular momentum: 0 kg m^2/s, largest change 0.0e+00 kg m^2/s",
        "energy unaccounted for: at most 1.6e+04 J",
    ]


@pytest.mark.serial
def test_ledger_without_steps_has_a_mean_of_zero():
    assert EnergyLedger(0, balance(0.0, 1.0)).iterations() == (
        "Newton iterations: 0, mean 0.00, max 0"
    )


def test_a_restored_ledger_continues_equally(ledger):
    archive = Snapshot()
    ledger.serialize(archive)
    other = EnergyLedger(0, balance(0.0, 0.0), num_loads=2, num_supports=1)
    other.serialize(archive.rewind())
    for each in (ledger, other):
        each.add(report(10, 1), 0.1, balance(1.0, 2.0, (1.0, 1.0, 1.0)))
    assert other.columns() == ledger.columns()
    assert other.drifts() == ledger.drifts()
    assert all(np.array_equal(other.each[name], ledger.each[name]) for name in ledger.each)
    assert other.iterations() == ledger.iterations()
    assert (other.step, other.first.time, other.last.time) == (10, 0.7, 1.0)
