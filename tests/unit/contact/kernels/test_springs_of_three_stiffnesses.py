"""Default springs, whose stiffness grows beyond the pressure of plane waves."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.contact.springs import spring_energy, spring_force

EPS, DEPTH = 30.0, 0.2  # N/m, m


def test_force_times_the_change_of_the_gap_is_the_change_of_the_energy():
    rng = np.random.default_rng(1)
    gap_n, gap = rng.uniform(-0.5, 0.2, (2, 200))
    depth = np.where(rng.uniform(size=200) < 0.3, np.inf, rng.uniform(0.0, 0.3, 200))
    lambda_N, _ = spring_force(gap_n, gap, EPS, soft_depth=depth)
    change = spring_energy(gap, EPS, depth) - spring_energy(gap_n, EPS, depth)
    np.testing.assert_allclose(lambda_N * (gap - gap_n), change, rtol=1e-12, atol=1e-14)
    assert np.all(lambda_N <= 0)


@pytest.mark.parametrize("share", [0.5, 0.7])
def test_slope_is_the_derivative_of_the_force(share):
    rng = np.random.default_rng(2)
    gap_n, gap = rng.uniform(-0.5, 0.1, (2, 100))
    away = np.abs(gap + DEPTH) > 1e-3  # from the kinks
    away &= np.abs(gap + 1.5 * DEPTH) > 1e-3
    gap_n, gap = gap_n[away & (gap < -1e-3)], gap[away & (gap < -1e-3)]
    step = 1e-6
    ends = [spring_force(gap_n, gap + d, EPS, share, DEPTH) for d in (-step, 0.0, step)]
    pushes = ends[1][0] < -1e-3
    quotient = (ends[2][0] - ends[0][0]) / (2 * step)
    np.testing.assert_allclose(ends[1][1][pushes], quotient[pushes], rtol=1e-5, atol=1e-5)


def test_energy_is_that_of_three_springs_in_parallel():
    compression = np.array([0.1, 0.25, 0.4])
    # Slopes of the force: 1, 10 and 100 times EPS, from 0, DEPTH and 3/2 DEPTH on.
    second, third = (np.maximum(compression - f * DEPTH, 0.0) ** 2 for f in (1.0, 1.5))
    expected = EPS / 2 * (compression**2 + 9 * second + 90 * third)
    np.testing.assert_allclose(spring_energy(-compression, EPS, DEPTH), expected, rtol=1e-14)


@pytest.mark.serial
def test_springs_of_a_bar_on_a_wall_are_soft_in_proportion_to_its_speed(comm):
    def arrived(speed):
        def build(model):
            size = {"size": (0.25, 0.25, 1.0), "cells": (1, 1, 4)}
            parts.add_box(model, "bar", corner=(0.0, 0.0, 0.0), **size)

        mesh, cells, facets, tag = nts.read_mesh(build, comm)
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        bar = nts.Body(V, cells, tag["bar"], nts.SaintVenantKirchhoff(1.0, 0.0, 1.0))
        wall = nts.RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        pair = nts.ContactPair(nts.Surface(V, facets, tag["bar_bottom"]), wall, nts.Penalty())
        stepper = nts.EnergyMomentum([bar], [pair], dt=0.05)
        stepper.set_velocity(bar, (0.0, 0.0, -speed))
        before = nts.Diagnostics(stepper).balance().total_energy
        depths = []
        for _ in stepper.run(until=1.0):
            depths.append(stepper.contacts[0].history.soft_depth.copy())
        after = nts.Diagnostics(stepper).balance().total_energy
        assert after == pytest.approx(before, rel=1e-12)
        # It stays at its value at impact.
        np.testing.assert_array_equal(depths[0], depths[-1])
        return depths[0]

    slow, fast = arrived(1e-4), arrived(3e-4)
    # One and a half times 5/3 of the compression of a cell under rho c v: h = 1/4, c = 1.
    np.testing.assert_allclose(slow, 1.5 * 5 / 3 * 1e-4 / 4, rtol=1e-9)
    np.testing.assert_allclose(fast, 3 * slow, rtol=1e-9)
