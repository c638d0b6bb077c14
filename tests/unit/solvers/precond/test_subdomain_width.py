"""Width of the contact subdomain."""

from types import SimpleNamespace

import pytest

from dolfinx_nts.solvers.precond.contact_schwarz import SubdomainWidth

pytestmark = pytest.mark.serial

SOLVES = 12  # each of two decades: more than any decision needs


def changes(width, iterations, part=0.0):
    """Record solves with new factors each; return the number of changes of the width."""
    count = 0
    for _ in range(SOLVES):
        width.count_factors(part)
        count += width.count(iterations, 2.0)
    return count


def test_few_iterations_leave_it_narrow_whatever_factors_cost():
    width = SubdomainWidth()
    assert changes(width, 3, part=1.0) == 0
    assert not width.is_wide
    assert not width.is_final


@pytest.mark.parametrize(("iterations", "part", "pays"), [(4, 0.02, True), (8, 0.0, False)])
def test_many_iterations_start_a_trial_and_the_cheaper_width_wins(iterations, part, pays):
    width = SubdomainWidth()
    while not width.is_wide:
        width.count(8, 2.0)
    assert changes(width, iterations, part) == (not pays)
    assert (width.is_wide, width.is_final) == (pays, True)
    assert changes(width, 50) == 0  # there is one trial


def test_factors_may_cost_more_than_they_save():
    width = SubdomainWidth()
    while not width.is_wide:
        width.count(8, 2.0)
    assert changes(width, 4, part=0.5) == 1
    assert not width.is_wide


def test_a_trial_goes_on_after_it_has_been_serialized():
    width, resumed = SubdomainWidth(), SubdomainWidth()
    while not width.is_wide:
        width.count(8, 2.0)
    width.count(4, 2.0)
    kept = {}
    width.serialize(SimpleNamespace(restores=False, same=lambda *item: kept.update([item])))
    resumed.serialize(SimpleNamespace(restores=True, same=lambda name, _: kept[name]))
    assert resumed == width
    assert changes(resumed, 4) == changes(width, 4) == 0
    assert resumed == width
    assert resumed.is_final and resumed.is_wide is True
