"""State of the contact nodes and energy by cause."""

from dataclasses import fields

import numpy as np
import pytest

from dolfinx_nts.contact.history import ContactHistory, ContactWork

pytestmark = pytest.mark.serial


def test_no_contact_has_a_value_for_each_node_and_no_force():
    history = ContactHistory.none(3)
    assert {len(getattr(history, f.name)) for f in fields(history)} == {3}
    assert not history.active.any() and not history.lambda_N.any() and not history.force.any()
    assert np.isnan(history.gap).all() and (history.key == -1).all()


def test_work_adds_up_cause_by_cause():
    works = ContactWork(1.0, 2.0, 3.0, 4.0, 5.0) + ContactWork(springs=0.5)
    assert works == ContactWork(1.0, 2.0, 3.0, 4.5, 5.0)
    assert works + ContactWork() == works
