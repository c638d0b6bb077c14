"""Warning of energy that constraints give to bodies."""

import logging

import pytest

import dolfinx_nts as nts
from dolfinx_nts.contact.checks.watch import EnergyGain
from dolfinx_nts.contact.history import ContactWork
from helpers import scenes

pytestmark = pytest.mark.serial


@pytest.mark.parametrize(
    ("law", "gain", "warns"),
    [
        (nts.LagrangeMultiplier("plastic"), 3.0, True),
        (nts.LagrangeMultiplier("plastic"), 1.0, False),
        (nts.Penalty(), 3.0, False),
    ],
)
def test_only_work_of_constraints_beyond_the_kinetic_energy_is_reported(
    comm, caplog, law, gain, warns
):
    (contact,) = scenes.blocks(comm, enforcement=law).stepper.contacts
    with caplog.at_level(logging.WARNING, "dolfinx_nts"):
        check = EnergyGain(comm)
        check.check({contact: ContactWork(persistent=gain)}, (2.0, 5.0), 0.5, 0.0)
    found = [r.message for r in caplog.records if "in one step, more" in r.message]
    assert len(found) == warns
    assert all("has given the bodies 3 J" in text and "of 2 J" in text for text in found)
