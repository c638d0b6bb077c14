"""Coulomb friction against the mechanics of rigid bodies.

A block that slides to rest and one on a slope; balls that begin to roll or
strike a plane at an angle. The bodies are elastic but stiff, the plane is
rigid. Formulas: any textbook, g the acceleration of gravity, I = beta m R^2.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import meshing
from helpers.models import shapes
from helpers.once import once, once_except

pytestmark = pytest.mark.at_most_two_ranks

G, MU, RHO = 10.0, 0.3, 1e3
PLANE = nts.RigidPlane((0, 0, 0), (0, 0, 1))
# Energy, dissipation and work of gravity together, relative to the start.
LEDGER_TOLERANCE = 1e-9
# Newton Physics asserts the stopping distance to 1 %.
DISTANCE_TOLERANCE = 1e-3
# Tolerance of the stopping time and of the acceleration on a slope, up to vibration.
PACE_TOLERANCE = 2e-3
# A ball of a mesh is an inscribed polyhedron.
BALL_TOLERANCE = 0.01
# Tolerances of an impact that slides all the time, with the moments of the polyhedron.
SLIP_TOLERANCE, SPIN_TOLERANCE = 1e-9, 1e-3


def body(
    build: Callable[[Any], None], side: str, E: float, mu: float
) -> tuple[nts.Body, nts.ContactPair]:
    """Body ``b`` whose nodes of one side may touch the plane. Collective."""
    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.SaintVenantKirchhoff(E=E, nu=0.3, rho=RHO)
    surface = nts.Surface(V, facets, tag[f"b_{side}"])
    return nts.Body(V, cells, tag["b"], material), nts.ContactPair(
        surface,
        PLANE,
        friction=nts.Coulomb(mu),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )


def block(mu: float) -> tuple[nts.Body, nts.ContactPair]:
    """Flat block, 1 m x 1 m x 0.25 m. Collective."""
    box = {"corner": (0, 0, 0), "size": (1, 1, 0.25), "cells": (4, 4, 2)}
    return body(lambda model: meshing.add_box(model, "b", **box), "bottom", 1e7, mu)


def grown(t: float, time: float) -> float:
    """Rise smoothly from 0 to 1 within a time."""
    s = min(t / time, 1.0)
    return s * s * (3 - 2 * s)


# --- the block ---------------------------------------------------------


@dataclass(frozen=True)
class Stop:
    """A block that slides to rest, relative to the formulas."""

    distance: float
    time: float
    dissipation: float
    ledger_error: float
    speed: float


@cache
def stop(dt: float) -> Stop:
    """Let a block with 2 m/s come to rest. Collective."""
    v = 2.0
    b, pair = block(MU)
    stepper = nts.EnergyMomentum([b], [pair], dt=dt, loads=[nts.Gravity([b], (0, 0, -G))])
    stepper.set_velocity(b, (v, 0, 0))
    diagnostics = nts.Diagnostics(stepper)
    mass = RHO * 0.25
    start, energy = diagnostics.centre_of_mass(b)[0], mass * v**2 / 2
    dissipation, work, ledger, t, speed = 0.0, 0.0, 0.0, [0.0], [v]
    end = v / (MU * G)
    for report in stepper.run(1.5 * end):
        dissipation += b.V.mesh.comm.allreduce(pair.history.dissipation.sum())
        work += report.load_work
        total = diagnostics.balance().total_energy + dissipation - work
        ledger = max(ledger, abs(total / energy - 1))
        t.append(report.t)
        speed.append(diagnostics.body_velocity(b)[0])
    sliding = np.array(speed) > 0.1 * v
    slope, at_start = np.polyfit(np.array(t)[sliding], np.array(speed)[sliding], 1)
    distance = diagnostics.centre_of_mass(b)[0] - start
    return Stop(
        distance=distance / (v**2 / (2 * MU * G)),
        time=-at_start / slope / end,
        dissipation=dissipation / energy,
        ledger_error=ledger,
        speed=abs(speed[-1]) / v,
    )


@pytest.mark.serial
def test_block_slides_the_distance_of_a_rigid_one(table_row):
    """Distance v^2/(2 mu g), time v/(mu g), friction work m v^2/2."""
    result = stop(0.01)
    table_row(
        "block sliding to rest",
        "distance v²/(2μg), time v/(μg)",
        f"{100 * (result.distance - 1):+.2f} %, {100 * (result.time - 1):+.2f} %",
    )
    assert abs(result.distance - 1) <= DISTANCE_TOLERANCE
    assert abs(result.time - 1) <= PACE_TOLERANCE
    # The rest of the energy is vibration.
    assert abs(result.dissipation - 1) <= 0.01
    assert result.ledger_error <= LEDGER_TOLERANCE
    assert result.speed <= 0.01


@pytest.mark.parametrize("dt", [0.02, once(0.005)])
def test_stopping_distance_does_not_depend_on_the_step(dt):
    result = stop(dt)
    assert abs(result.distance - 1) <= DISTANCE_TOLERANCE
    assert result.ledger_error <= LEDGER_TOLERANCE


def slide(part: float) -> tuple[float, float]:
    """Acceleration and distance of a block on a slope, mu = part * tan(slope).

    Gravity grows within 0.3 s, so that the block hardly vibrates; the
    acceleration is that from 0.4 s to 1 s. Collective.
    """
    slope = np.arctan(MU)
    down = np.array([np.sin(slope), 0, -np.cos(slope)])
    b, pair = block(part * MU)
    gravity = nts.Gravity([b], lambda t: G * grown(t, 0.3) * down)
    stepper = nts.EnergyMomentum([b], [pair], dt=0.01, loads=[gravity])
    diagnostics = nts.Diagnostics(stepper)
    start = diagnostics.centre_of_mass(b)[0]
    t, speed = [], []
    for report in stepper.run(1.0):
        t.append(report.t)
        speed.append(diagnostics.body_velocity(b)[0])
    late = np.array(t) > 0.4
    acceleration = np.polyfit(np.array(t)[late], np.array(speed)[late], 1)[0]
    return float(acceleration), float(diagnostics.centre_of_mass(b)[0] - start)


@pytest.mark.serial
def test_block_slides_down_a_slope_just_steeper_than_friction_allows(table_row):
    """Acceleration g (sin - mu cos) for mu 1 % below tan."""
    expected = G * np.cos(np.arctan(MU)) * 0.01 * MU
    acceleration, _ = slide(0.99)
    table_row(
        "block on a slope, μ = 0.99 tan θ",
        "acceleration g (sin θ - μ cos θ)",
        f"{100 * (acceleration / expected - 1):+.3f} %",
    )
    assert acceleration == pytest.approx(expected, rel=PACE_TOLERANCE)


@pytest.mark.serial
def test_block_sticks_on_a_slope_just_flatter_than_friction_allows():
    """At rest for mu 1 % above tan: less than a thousandth of the other's pace."""
    acceleration, travel = slide(1.01)
    assert abs(acceleration) <= 1e-3 * G * np.cos(np.arctan(MU)) * 0.01 * MU
    # It shears by rho g sin(slope) H^2 / (2 G); micro-slip is of that size.
    shear = RHO * G * MU * 0.25**2 / (2 * 1e7 / 2.6)
    assert 0 < travel <= 5 * shear


# --- balls -------------------------------------------------------------

SOLID, HOLLOW = 0.4, 0.4 * (1 - 0.8**5) / (1 - 0.8**3)
BETA = {"solid": SOLID, "hollow": HOLLOW}


def ball(kind: str, cells: int, mu: float) -> tuple[nts.Body, nts.ContactPair]:
    """Ball of radius 1 on the plane, a node at its lowest point. Collective."""
    if kind == "solid":
        shape = {"centre": (0, 0, 1), "radius": 1.0, "cells_per_edge": cells, "layers": 2}
        return body(lambda m: meshing.add_solid_ball(m, "b", **shape), "outer", 1e11, mu)
    shape = {"centre": (0, 0, 1), "inner_radius": 0.8, "outer_radius": 1.0}
    shape |= {"cells_per_edge": cells, "layers": 2}
    return body(lambda m: meshing.add_hollow_ball(m, "b", **shape), "outer", 1e11, mu)


def moments(b: nts.Body) -> tuple[float, float]:
    """Mass of a ball and moment of inertia about the y axis through (0, 0, 1)."""
    mesh = b.V.mesh
    x = ufl.SpatialCoordinate(mesh)
    dx = ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": 4})
    densities = (fem.Constant(mesh, RHO), RHO * (x[0] ** 2 + (x[2] - 1) ** 2))
    parts = [fem.assemble_scalar(fem.form(density * dx)) for density in densities]
    mass, inertia = mesh.comm.allreduce(np.array(parts))
    return float(mass), float(inertia)


@dataclass(frozen=True)
class Roll:
    """A ball that begins to roll: speed, time of the transition, beta."""

    speed: float
    time: float
    beta: float
    slip: float


SPEED = 0.3


@cache
def roll(kind: str, cells: int) -> Roll:
    """Let a ball slide until it rolls. Collective.

    It turns by less than 0.01 until then: over many facets a ball of a
    mesh bumps like a polygon. Gravity grows within 5 ms, so that the
    ball hardly vibrates; time counts from the middle of that.
    """
    b, pair = ball(kind, cells, MU)
    rise, beta = 0.005, BETA[kind]
    end = beta * SPEED / ((1 + beta) * MU * G)
    gravity = nts.Gravity([b], lambda t: (0, 0, -G * grown(t, rise)))
    stepper = nts.EnergyMomentum([b], [pair], dt=0.0005, loads=[gravity])
    stepper.set_velocity(b, (SPEED, 0, 0))
    diagnostics = nts.Diagnostics(stepper)
    t, speed = [], []
    for report in stepper.run(1.6 * end + rise / 2):
        t.append(report.t - rise / 2)
        speed.append(diagnostics.body_velocity(b)[0])
    times, speeds = np.array(t), np.array(speed)
    rolls = SPEED / (1 + beta)
    sliding = (times > rise / 2) & (speeds > rolls + 0.2 * (SPEED - rolls))
    slope, at_start = np.polyfit(times[sliding], speeds[sliding], 1)
    final = speeds[times > 1.1 * end].mean()
    mass, inertia = moments(b)
    omega = shapes.spin(stepper, b)[1] / inertia
    return Roll(
        speed=float(final),
        time=float((final - at_start) / slope),
        beta=inertia / mass,
        slip=float(diagnostics.body_velocity(b)[0] - omega) / SPEED,
    )


@pytest.mark.serial
@pytest.mark.parametrize("kind", BETA)
def test_sliding_ball_begins_to_roll(kind, table_row):
    """v/(1 + beta) at t = beta v/((1 + beta) mu g), beta = 2/5 or 0.551.

    The polyhedra of two meshes with their own beta, and that of the
    sphere as the mesh is refined.
    """
    errors = []
    for cells in (4, 12):
        result = roll(kind, cells)
        for beta in (result.beta, BETA[kind]):
            speed, time = SPEED / (1 + beta), beta * SPEED / ((1 + beta) * MU * G)
            changes = result.speed / speed - 1, result.time / time - 1
            errors.append(tuple(map(abs, changes)))
        assert max(errors[-2]) <= BALL_TOLERANCE
        # Rolling without slip, up to vibration.
        assert abs(result.slip) <= 0.02
    table_row(
        f"{kind} ball that slides until it rolls, 12 cells an edge",
        "speed v/(1 + β), time β v/((1 + β) μ g)",
        f"{100 * changes[0]:+.1f} %, {100 * changes[1]:+.1f} %",
    )
    assert max(errors[-1]) <= BALL_TOLERANCE
    assert max(errors[-1]) < max(errors[1])


@dataclass(frozen=True)
class Bounce:
    """Impact of a ball on a plane, in terms of the formulas.

    Attributes:
        restitution: Of the normal velocity.
        tangential: Loss of tangential velocity / (mu (1 + e) v_n).
        spin: Angular velocity beta R / (mu (1 + e) v_n), beta of the mesh.
        ledger_error: Of energy and dissipation, relative to the start.
    """

    restitution: float
    tangential: float
    spin: float
    ledger_error: float


def bounce(kind: str, cells: int, mu: float) -> Bounce:
    """Throw a ball at the plane, 0.1 m/s down and 1 m/s along. Collective."""
    v_n, v_t = 0.1, 1.0
    b, pair = ball(kind, cells, mu)
    stepper = nts.EnergyMomentum([b], [pair], dt=2e-4)
    stepper.set_velocity(b, (v_t, 0, -v_n))
    diagnostics = nts.Diagnostics(stepper)
    comm = b.V.mesh.comm
    start = diagnostics.balance().total_energy
    dissipation, ledger, quiet = 0.0, 0.0, 0
    for report in stepper.run(0.05):
        dissipation += comm.allreduce(pair.history.dissipation.sum())
        total = diagnostics.balance().total_energy + dissipation
        ledger = max(ledger, abs(total / start - 1))
        speed = diagnostics.body_velocity(b)
        quiet = 0 if report.num_active or speed[2] < 0 else quiet + 1
        if quiet == 5:
            break
    mass, inertia = moments(b)
    impulse = mu * (speed[2] + v_n)
    return Bounce(
        restitution=float(speed[2]) / v_n,
        tangential=float((v_t - speed[0]) / impulse),
        spin=float(shapes.spin(stepper, b)[1] / inertia * (inertia / mass) / impulse),
        ledger_error=ledger,
    )


@pytest.mark.parametrize("kind", once_except(list(BETA), "solid"))
def test_ball_that_strikes_at_a_shallow_angle_slides_all_the_time(kind, table_row):
    """Full slip: dv_t = -mu (1 + e) v_n, omega = mu (1 + e) v_n / (beta R)."""
    result = bounce(kind, 8, 0.2)
    table_row(
        f"oblique impact of a {kind} ball, full slip",
        "Δv = μ (1 + e) v_n, ω = μ (1 + e) v_n/(β R)",
        f"{abs(result.tangential - 1):.0e}, {abs(result.spin - 1):.0e}",
    )
    assert 0 < result.restitution <= 1
    assert abs(result.tangential - 1) <= SLIP_TOLERANCE
    assert abs(result.spin - 1) <= SPIN_TOLERANCE
    assert result.ledger_error <= LEDGER_TOLERANCE
