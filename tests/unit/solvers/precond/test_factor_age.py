"""Age of factors, by the iterations of a solver that only counts."""

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_nts.solvers.precond.factor_age import FactorAge

pytestmark = pytest.mark.serial

DECADES = 12.0  # of a step
FEW, MORE, MANY = 24, 36, 90  # iterations in them


class Factors:
    """Factors whose quality a test sets."""

    point, is_strong, is_ilu0, is_complete, may_be_strengthened = None, True, False, False, True

    def __init__(self):
        """Begin without any."""
        self.num_builds = self.num_strengthened = 0

    def build(self):
        self.point = ()
        self.num_builds += 1

    def strengthen(self):
        self.num_strengthened += 1


def made():
    """Return the age of new factors, and these."""
    tangent = SimpleNamespace(nodal_stiffness=lambda: np.ones(1), comm=MPI.COMM_SELF)
    rigid = SimpleNamespace(dim=3)
    operator = SimpleNamespace(forget=lambda: None, bulk=SimpleNamespace(rigid=rigid))
    factors = Factors()
    age = FactorAge(tangent, factors, operator, lambda: np.ones(3))
    assert age.renew()
    return age, factors


def is_due(age, steps):
    """Whether factors are recomputed when each step takes more iterations."""
    return any(age.count(MORE, DECADES) or age.renew() for _ in range(steps))


def test_factors_that_need_more_iterations_are_recomputed_after_some_steps():
    age, _ = made()
    age.count(FEW, DECADES)
    assert not is_due(age, 3)
    assert is_due(age, 4)


def test_a_hard_first_step_does_not_excuse_later_costs_of_age():
    """As where a flat face lands: iterations of that step do not depend on the factors."""
    age, _ = made()
    for iterations in (MANY, FEW):
        age.count(iterations, DECADES)
    assert is_due(age, 7)


def test_solves_without_contact_say_nothing_of_an_impact():
    age, factors = made()
    factors.is_ilu0 = True
    for _ in range(2):
        age.count(FEW, DECADES)
    assert np.isnan(age.one_application_reduction)
    age.count(MANY, DECADES, in_contact=True)
    slow = age.one_application_reduction
    for _ in range(3):
        age.count(FEW, DECADES)
    assert age.one_application_reduction == slow == pytest.approx(10 ** (-DECADES / MANY))


def test_factors_that_are_slow_from_the_start_are_replaced_in_their_first_step():
    age, factors = made()
    for _ in range(3):
        age.count(MANY, DECADES / 4)
        age.strengthen_if_slow(is_new=False)
    assert factors.num_strengthened > 0
