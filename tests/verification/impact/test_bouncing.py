"""Bodies that bounce repeatedly: no drift of the energy, and the correct period.

A bar under gravity (Doyen, Ern and Piperno, SIAM J. Sci. Comput. 33, 2011)
and a ball between two free plates.
"""

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import meshing
from helpers.models import shapes

pytestmark = pytest.mark.at_most_two_ranks

# Tolerance of the total energy at any step, relative to the start.
ENERGY_TOLERANCE = 1e-10
# Tolerance of both momenta, relative to the start; bodies of a scene differ in mass by 1e5.
MOMENTUM_TOLERANCE = 1e-10
# Solutions with jumps: least order of convergence.
JUMP_ORDER = 0.5

# --- the bar -----------------------------------------------------------

LENGTH, HEIGHT, MODULUS, SPEED, G = 10.0, 5.0, 900.0, 30.0, 10.0
PERIOD = 16 / 3
# Courant number with which the leading errors of the phase, -1/24 of linear
# elements and 1/12 of the midpoint rule, cancel.
NON_DISPERSIVE = np.sqrt(0.5)


@dataclass(frozen=True)
class Bouncing:
    """Bar that bounces under gravity.

    Attributes:
        energy_error: Largest change of all energies, relative.
        touch: Times at which a contact begins.
        turn: Times at which the centre of mass turns upwards.
    """

    energy_error: float
    touch: tuple[float, ...]
    turn: tuple[float, ...]

    def period(self, number: int) -> float:
        """Mean of the first periods, relative to theory."""
        return (self.turn[2 * number] - self.turn[0]) / (number * PERIOD)


def bouncing(
    cells: int, periods: float, courant: float = 1.0, spring: float | None = None
) -> Bouncing:
    """Drop a bar of length 10 from 5 (c = 30, g = 10). Collective.

    Args:
        cells: Cells along the bar.
        periods: End, in periods of theory.
        courant: Cells that a wave passes in a step.
        spring: Stiffness of the contact, relative to a cell; None for a
            multiplier.
    """
    box = {"corner": (HEIGHT, 0, 0), "size": (LENGTH, 1, 1), "cells": (cells, 1, 1)}
    mesh, tags, facets, tag = nts.read_mesh(
        lambda m: meshing.add_box(m, "bar", **box), MPI.COMM_WORLD
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bar = nts.Body(V, tags, tag["bar"], shapes.linear_in_stretch(MODULUS, 0.0, 1.0))
    # The section has four nodes.
    stiffness = MODULUS * cells / LENGTH / 4
    enforcement = nts.LagrangeMultiplier() if spring is None else nts.Penalty(spring * stiffness)
    wall = nts.RigidPlane((0, 0, 0), (1, 0, 0))
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["bar_left"]), wall, enforcement, method="node-to-segment"
    )
    held = (["front", "back"], ["bottom", "top"])
    bcs = [
        shapes.rollers(V, facets, [tag[f"bar_{s}"] for s in sides], axis)
        for axis, sides in enumerate(held, start=1)
    ]
    dt = courant * LENGTH / cells / SPEED
    gravity = nts.Gravity([bar], (-G, 0, 0))
    stepper = nts.EnergyMomentum([bar], [pair], dt=dt, bcs=bcs, loads=[gravity])
    diagnostics = nts.Diagnostics(stepper)

    def energy() -> float:
        weight = LENGTH * G * diagnostics.centre_of_mass(bar)[0]
        parts = (diagnostics.kinetic_energy, diagnostics.strain_energy, diagnostics.contact_energy)
        return float(sum(part() for part in parts) + weight)

    start, error = energy(), 0.0
    t, velocity, contact = [0.0], [0.0], []
    for report in stepper.run(periods * PERIOD):
        error = max(error, abs(energy() / start - 1))
        t.append(report.t)
        velocity.append(float(diagnostics.body_velocity(bar)[0]))
        if report.num_active:
            contact.append(report.t - dt)
    return Bouncing(error, first(contact), first(upwards(t, velocity)))


def upwards(t: list[float], velocity: list[float]) -> list[float]:
    """Times at which a velocity gets positive."""
    v = np.array(velocity)
    turn = np.flatnonzero((v[:-1] < 0) & (v[1:] >= 0))
    return [float(np.interp(0, v[i : i + 2], t[i : i + 2])) for i in turn]


def first(times: list[float]) -> tuple[float, ...]:
    """Times that are more than 1 s after the last: a contact lasts for 2/3 s."""
    return tuple(b for a, b in zip([-np.inf, *times], times, strict=False) if b - a > 1)


@pytest.mark.serial
def test_bouncing_bar_turns_in_the_period_of_theory(table_row):
    """Period 16/3, touch at 1 and 11/3.

    The contact stress is rho c (v + g t) in the first contact, so that
    the centre of mass turns at 1 + (sqrt(10) - 2)/3; the second contact
    is the first backwards.
    """
    meshes = (20, 40, 80)
    runs = [bouncing(cells, 1.4) for cells in meshes]
    for run, cells in zip(runs, meshes, strict=True):
        dt = 1 / (3 * cells)
        assert run.energy_error <= ENERGY_TOLERANCE
        assert abs(run.touch[0] - 1) <= 1.01 * dt
        assert abs(run.touch[1] - 11 / 3) <= 2 * dt
        assert abs(run.turn[0] - (1 + (np.sqrt(10) - 2) / 3)) <= dt
    table_row(
        "bouncing bar, multiplier, first period with 20, 40, 80 elements",
        "Doyen, Ern and Piperno 2011: 16/3",
        ", ".join(f"{100 * (run.period(1) - 1):+.2f}" for run in runs) + " %",
    )
    errors = [abs(run.period(1) - 1) for run in runs]
    assert errors[-1] <= 0.005
    assert np.log2(errors[0] / errors[-1]) / 2 >= JUMP_ORDER


@pytest.mark.serial
def test_bouncing_bar_keeps_its_energy_for_ten_periods(table_row):
    """With a multiplier the energy is conserved, but the period drifts.

    Each time the wall stops the node that it meets, and the energy of
    that node becomes vibration, which comes back at another time: the
    bar bounces lower and sooner, and the README says so.
    """
    run = bouncing(10, 10.5)
    table_row(
        "the same for ten periods, 10 elements",
        "energy is conserved; the pace does not last, as each impact makes a node vibrate",
        f"energy {run.energy_error:.0e}, mean period {100 * (run.period(10) - 1):+.0f} %",
    )
    assert run.energy_error <= ENERGY_TOLERANCE
    assert len(run.touch) >= 10
    assert abs(run.period(1) - 1) <= 0.01
    assert 0.7 <= run.period(10) <= 0.95


# Ten periods with a spring of half the stiffness of a cell, which stops nodes gradually. Each
# contact lasts longer by the time of a wave through some cells.
SPRING, MESHES = 0.5, (12, 18, 24)


def ten_periods(cells: int) -> Bouncing:
    """Bounce for ten periods, their relative excess, and one more contact."""
    return bouncing(cells, 10.4 + 5 / cells, NON_DISPERSIVE, SPRING)


@pytest.mark.serial
def test_bar_that_bounces_twenty_times_from_a_spring_keeps_its_energy_and_its_pace(
    table_row,
):
    """The mean of ten periods converges to 16/3 at first order, and is as good as the first."""
    runs = [ten_periods(cells) for cells in MESHES]
    for run in runs:
        assert run.energy_error <= ENERGY_TOLERANCE
        assert len(run.touch) >= 20
    table_row(
        "the same by springs half as stiff as an element, 12, 18, 24 elements",
        "mean of ten periods 16/3",
        ", ".join(f"{100 * (run.period(10) - 1):+.1f}" for run in runs)
        + f" %; energy {max(run.energy_error for run in runs):.0e}",
    )
    errors = [run.period(10) - 1 for run in runs]
    for run, cells, error in zip(runs, MESHES, errors, strict=True):
        assert 0 < error <= 0.5 / cells
        assert error <= 1.1 * (run.period(1) - 1)
    assert np.log(errors[0] / errors[-1]) / np.log(MESHES[-1] / MESHES[0]) >= 0.9


# --- the ball ----------------------------------------------------------

BALL_SPEED, TRAVEL = 0.02, 0.01


@dataclass(frozen=True)
class Caught:
    """Ball between two plates.

    Attributes:
        energy_error: Largest change of the total energy, relative.
        linear_drift: Largest change of the linear momentum, relative to
            that of the ball at the start.
        angular_drift: The same of the angular momentum, relative to the
            linear momentum of the ball times its radius.
        touch: Time at which each impact begins [s].
        speed: Normal velocity of the ball after each impact, relative
            to the start.
    """

    energy_error: float
    linear_drift: float
    angular_drift: float
    touch: tuple[float, ...]
    speed: tuple[float, ...]


def caught(until: float) -> Caught:
    """Let a ball bounce between free plates. Collective.

    Radius 1, E = 1e5, rho = 1e3, 0.02 m/s, 1 s from plate to plate; an
    impact lasts for about 1 s, a wave through the ball for 0.2 s. The
    plates are 1e5 times as heavy, so that they hardly take energy.
    """
    comm, v = MPI.COMM_WORLD, BALL_SPEED

    def build(model: Any) -> None:
        meshing.add_solid_ball(
            model, "ball", centre=(0, 0, 0), radius=1.0, cells_per_edge=2, layers=1
        )
        for name, z in (("lower", -1.4 - TRAVEL), ("upper", 1 + TRAVEL)):
            box = {"corner": (-1.5, -1.5, z), "size": (3, 3, 0.4), "cells": (3, 3, 1)}
            meshing.add_box(model, name, **box)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    ball = nts.Body(V, cells, tag["ball"], nts.SaintVenantKirchhoff(E=1e5, nu=0.3, rho=1e3))
    heavy = nts.SaintVenantKirchhoff(E=1e7, nu=0.3, rho=1e8)
    plates = [nts.Body(V, cells, tag[name], heavy) for name in ("lower", "upper")]
    surface = nts.Surface(V, facets, tag["ball_outer"])
    pairs = [
        nts.ContactPair(
            surface,
            nts.Surface(V, facets, tag[name]),
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
        for name in ("lower_top", "upper_bottom")
    ]
    stepper = nts.EnergyMomentum([ball, *plates], pairs, dt=0.1)
    stepper.set_velocity(ball, (0.1 * v, 0.05 * v, -v))
    diagnostics = nts.Diagnostics(stepper)
    start = diagnostics.balance()
    scale = np.linalg.norm(start.linear_momentum)
    energy, linear, angular, touch, speed, side = 0.0, 0.0, 0.0, [], [], None
    for report in stepper.run(until):
        balance = diagnostics.balance()
        energy = max(energy, abs(balance.total_energy / start.total_energy - 1))
        change = balance.linear_momentum - start.linear_momentum
        linear = max(linear, float(np.linalg.norm(change) / scale))
        change = balance.angular_momentum - start.angular_momentum
        angular = max(angular, float(np.linalg.norm(change) / scale))
        touching = [comm.allreduce(pair.history.active.sum()) > 0 for pair in pairs]
        for number in np.flatnonzero(touching):
            if number != side:
                side = number
                touch.append(report.t)
                speed.append(0.0)
        if speed:
            speed[-1] = float(diagnostics.body_velocity(ball)[2]) / v
    return Caught(energy, linear, angular, tuple(touch), tuple(speed))


@pytest.mark.serial
def test_ball_bounces_between_two_plates_without_any_drift(table_row):
    """Twenty impacts, counted where the ball touches the other plate.

    A plate of much greater mass returns the ball with the speed with
    which it came, up to the vibration of the ball.
    """
    result = caught(50.0)
    assert result.energy_error <= ENERGY_TOLERANCE
    assert result.linear_drift <= MOMENTUM_TOLERANCE
    assert result.angular_drift <= MOMENTUM_TOLERANCE
    assert 0.98 <= result.speed[0] <= 1
    assert sum(t < 4.05 for t in result.touch) == 2  # one second from plate to plate
    speed = np.array(result.speed[:-1])  # the last impact may not be over
    table_row(
        "ball between two free plates",
        "energy and momenta are conserved; the ball comes back as fast as it came",
        f"{len(speed)} impacts: energy {result.energy_error:.0e}, momenta "
        f"{max(result.linear_drift, result.angular_drift):.0e}, first return {speed[0]:.3f}",
    )
    assert len(speed) >= 20
    assert np.all(-speed[1:] / speed[:-1] >= 0.9)
