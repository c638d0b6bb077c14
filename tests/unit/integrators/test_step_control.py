"""Lengths of steps: equal ones, and ones that are cut and grow."""

import pytest

from dolfinx_nts.common.archive import Snapshot
from dolfinx_nts.integrators.step_control import EvenSteps, StepControl, StepLength

pytestmark = pytest.mark.serial

SLIVER = 1e-12


def ends(control, t, dt, until):
    """Ends of the steps of a run in which no step fails."""
    found = []
    while until - t > SLIVER:
        length, end = control.next_step(t, dt, until)
        assert end - t == pytest.approx(length, abs=SLIVER)
        # None is longer than it may be.
        assert 0 < length <= dt * (1 + 1e-6)
        t = end
        found.append(end)
    return found


def test_equal_steps_gather_no_round_off():
    even, t, added = EvenSteps(), 0.0, 0.0
    for step in range(1, 11):
        t = even.next(t, step - 1, 0.1)
        added += 0.1
    assert t == 1.0 != added


def test_another_time_or_length_begins_a_new_count():
    even = EvenSteps()
    assert even.next(0.7, 3, 0.1) == 0.7 + 0.1
    t = even.next(0.7 + 0.1, 4, 0.1)
    assert t == 0.7 + 2 * 0.1
    assert even.next(t, 5, 0.25) == t + 0.25
    assert even.next(t + 0.25, 6, 0.25) == t + 2 * 0.25


def test_equal_steps_go_on_alike_from_an_archive():
    even, archive = EvenSteps(), Snapshot()
    t = even.next(0.7, 3, 0.1)
    even.serialize(archive)
    other = EvenSteps()
    other.serialize(archive.rewind())
    assert other.target == t
    assert other.next(t, 4, 0.1) == even.next(t, 4, 0.1) == 0.7 + 2 * 0.1


def test_the_rest_of_a_halved_step_ends_where_the_step_ends():
    even = EvenSteps()
    even.next(0.5, 0, 0.1)
    assert not even.goes_on(0.5, 0.1)
    assert even.goes_on(0.55, 0.1)
    assert not even.goes_on(even.target, 0.1)
    # A time that the user sets is not part of a step.
    assert not even.goes_on(0.2, 0.1)


def test_given_times_are_met_exactly_by_halved_steps():
    control = StepControl(times=[1.0, 0.5])
    assert ends(control, 0.0, 0.3, 1.2) == pytest.approx([0.25, 0.5, 0.75, 1.0, 1.2])
    assert {0.5, 1.0, 1.2} <= set(ends(control, 0.0, 0.3, 1.2))
    # Times at or before the start do not count.
    assert ends(control, 0.5, 0.5, 1.0) == [1.0]


def test_steps_that_fit_are_not_cut():
    assert ends(StepControl(), 0.0, 0.25, 1.0) == [0.25, 0.5, 0.75, 1.0]
    # Nor do times that round-off separates from it.
    assert ends(StepControl(), 0.0, 0.1, 0.3) == pytest.approx([0.1, 0.2, 0.3])


def test_length_is_halved_at_once_and_doubled_after_three_steps():
    length = StepLength()
    length.cut()
    length.cut()
    cuts = []
    for _ in range(9):
        length.accept()
        cuts.append(length.cuts)
    assert cuts == [2, 2, 1, 1, 1, 0, 0, 0, 0]


def test_a_cut_starts_the_count_of_good_steps_again():
    length, archive = StepLength(), Snapshot()
    length.cut()
    length.accept()
    length.accept()
    length.serialize(archive)
    length.cut()
    length.accept()
    assert length.cuts == 2
    length.serialize(archive.rewind())
    length.accept()
    assert length.cuts == 0


def test_control_prints_its_arguments():
    control = StepControl(smallest=1e-5, times=[0.2, 0.1])
    assert repr(control) == "StepControl(smallest=1e-05, gap_tol=None, times=(0.1, 0.2))"


def test_step_may_be_cut_twenty_times_unless_the_user_says_otherwise():
    assert StepControl().shortest(1.0) == 0.5**20
    assert StepControl(smallest=0.1).shortest(1.0) == 0.1
