"""Increments for which the plastic tangent is wrong are cut, all others are kept."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers import newton
from dolfinx_nts.solvers.line_search import LineSearch
from helpers.models.boxed import Box

pytestmark = pytest.mark.at_most_two_ranks


STRETCH = np.array([[0.1], [-0.05], [-0.05]])  # to twenty strains of yield


@pytest.fixture(params=[20.0, 1.0], ids=["much hardening", "little hardening"])
def stepper(comm, request):
    """Stepper of a metal box of negligible mass that is stretched until it yields everywhere."""
    metal = nts.J2Plasticity(1.0e3, 0.3, 1e-9, yield_stress=5.0, hardening=request.param)
    box = Box(comm, material=metal)
    stepper = nts.EnergyMomentum([box.body], dt=0.02)
    stepper.u.interpolate(lambda X: STRETCH * X)
    return stepper


def increment(stepper, part):
    """Increment parallel to the last one, and the residual that it balances."""
    bulk = stepper._bulk
    du = -part * stepper.u.x.array[: bulk.num_owned]
    return du, -bulk.action(du.reshape(-1, 3)).ravel()


def move(stepper, start, du):
    """Move the owned nodes to displacements after an increment, and return the residual."""
    bulk = stepper._bulk
    stepper.u.x.array[: bulk.num_owned] = start + du
    stepper.u.x.scatter_forward()
    return bulk.forces()


def test_an_increment_into_reverse_flow_ends_at_zero_work(comm, stepper):
    bulk = stepper._bulk
    start = stepper.u.x.array[: bulk.num_owned].copy()
    du, R = increment(stepper, 2.0)
    work, search = reductions.total(comm, float(-du @ R)), LineSearch(bulk, springs=False)
    forces = bulk.forces()
    search.begin(du, 1.0, R, forces)

    def rest(now):
        """Virtual work of the residual along the increment [J]."""
        return reductions.total(comm, float(du @ (now - forces))) - work

    now = move(stepper, start, du)
    first, num_cuts = rest(now), 0
    while search.cuts(now):
        num_cuts += 1
        now = bulk.forces()
    assert first > 0.5 * work
    assert 0 < num_cuts <= 8
    assert abs(rest(now)) <= 0.5 * work  # neither too far nor much too short
    moved = stepper.u.x.array[: bulk.num_owned] - start
    part = reductions.total(comm, float(moved @ du)) / reductions.total(comm, float(du @ du))
    np.testing.assert_allclose(moved, part * du, atol=1e-14)
    assert 0 < part < 1


def test_increments_that_the_tangent_predicts_stay_unchanged(stepper):
    bulk = stepper._bulk
    start = stepper.u.x.array[: bulk.num_owned].copy()
    du, R = increment(stepper, 1e-6)
    search = LineSearch(bulk, springs=False)
    search.begin(du, 1.0, R, bulk.forces())
    assert not search.cuts(move(stepper, start, du))
    np.testing.assert_array_equal(stepper.u.x.array[: bulk.num_owned], start + du)


def test_without_an_increment_there_is_nothing_to_cut(stepper):
    bulk = stepper._bulk
    start = stepper.u.x.array[: bulk.num_owned].copy()
    search = LineSearch(bulk, springs=False)
    du, R = increment(stepper, 2.0)
    search.begin(du, 1.0, R, bulk.forces())
    search.forget()
    assert not search.cuts(move(stepper, start, du))


def test_elastic_bodies_have_no_line_search(comm, monkeypatch):
    monkeypatch.setattr(newton, "LineSearch", None)  # which cannot be called
    stepper = nts.EnergyMomentum([Box(comm).body], dt=0.02)
    stepper.set_velocity(stepper.bodies[0], lambda X: 0.1 * X)
    assert stepper.advance().newton_iterations > 0
