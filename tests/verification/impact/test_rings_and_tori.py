"""Soft rings and tori that collide: large deformation, sliding, conservation.

There is no closed form; what must hold are the balances. Rings: outer
diameter 20 m, wall 0.3 m, E = 20 MPa, nu = 1/6, rho = 1000 kg/m^3, 4 m/s.
Tori after Yang and Laursen (2008): radii 76 and 24, wall 4.5, neo-Hooke,
E = 2250, nu = 0.3, rho = 0.1, 30.
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

# Tolerance relative to the start, at any step: energy, and both momenta.
ENERGY_TOLERANCE = 1e-10
MOMENTUM_TOLERANCE = 1e-11
# Energy and its dissipation together.
LEDGER_TOLERANCE = 1e-9
MEAN_ITERATIONS = 7.0  # no step is tried twice
# A share of the angular momentum by which a body turns; it did not before.
TURNS = 1e-3


@dataclass(frozen=True)
class Run:
    """A collision; momenta and energies at any step, relative to the start.

    Attributes:
        energy_error: Largest change of the energy.
        ledger_error: Largest change of energy and dissipation together.
        linear_drift: Largest change of the linear momentum.
        angular_drift: Largest change of the angular momentum.
        active: Active pairs of each step.
        dissipation: Total dissipation.
        iterations: Newton iterations of each step.
        approach: Velocity of approach along the line of centres, at the
            start and at the end.
        spins: Angular momentum of each body about its centre of mass at
            the end, relative to the whole.
    """

    energy_error: float
    ledger_error: float
    linear_drift: float
    angular_drift: float
    active: tuple[int, ...]
    dissipation: float
    iterations: tuple[int, ...]
    approach: tuple[float, float]
    spins: np.ndarray


def collide(stepper: nts.EnergyMomentum, until: float) -> Run:
    """Advance and keep the balances. Collective."""
    diagnostics, (pair,), bodies = nts.Diagnostics(stepper), stepper.pairs, stepper.bodies
    comm = stepper.u.function_space.mesh.comm

    def approach() -> float:
        travel = diagnostics.centre_of_mass(bodies[0]) - diagnostics.centre_of_mass(bodies[1])
        speed = diagnostics.body_velocity(bodies[1]) - diagnostics.body_velocity(bodies[0])
        return float(speed @ travel / np.linalg.norm(travel))

    first, before = diagnostics.balance(), approach()
    energy, linear, angular, dissipation, active, iterations = ([] for _ in range(6))
    for report in stepper.run(until):
        balance = diagnostics.balance()
        energy.append(balance.total_energy)
        linear.append(np.linalg.norm(balance.linear_momentum - first.linear_momentum))
        angular.append(np.linalg.norm(balance.angular_momentum - first.angular_momentum))
        dissipation.append(comm.allreduce(pair.history.dissipation.sum()))
        active.append(report.num_active)
        iterations.append(report.newton_iterations)
    whole = float(np.linalg.norm(first.angular_momentum))
    ledger = np.array(energy) + np.cumsum(dissipation)
    return Run(
        energy_error=float(np.abs(np.array(energy) / first.total_energy - 1).max()),
        ledger_error=float(np.abs(ledger / first.total_energy - 1).max()),
        linear_drift=float(max(linear) / np.linalg.norm(first.linear_momentum)),
        angular_drift=float(max(angular) / whole),
        active=tuple(active),
        dissipation=float(sum(dissipation)),
        iterations=tuple(iterations),
        approach=(before, approach()),
        spins=np.array([shapes.spin(stepper, body) for body in bodies]) / whole,
    )


def two_bodies(
    build: Callable[[Any], None],
    material: nts.Hyperelastic,
    friction: nts.Coulomb | None,
    method: Any = "node-to-segment",
) -> tuple[nts.Body, nts.Body, nts.ContactPair]:
    """Bodies ``upper`` and ``lower`` and their contact. Collective."""
    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    lower, upper = (nts.Body(V, cells, tag[name], material) for name in ("lower", "upper"))
    surfaces = [nts.Surface(V, facets, tag[f"{name}_outer"]) for name in ("upper", "lower")]
    return (
        lower,
        upper,
        nts.ContactPair(
            *surfaces, friction=friction, method=method, enforcement=nts.LagrangeMultiplier()
        ),
    )


@cache
def rings(mu: float, until: float, eps_T: float | None = None) -> Run:
    """Eccentric collision of two free rings. Collective."""
    shape = {"inner_radius": 9.7, "outer_radius": 10.0, "width": 1.0, "cells": (96, 2, 1)}
    offset, distance = 5.0, 20.1

    def build(model: Any) -> None:
        height = np.sqrt(distance**2 - offset**2)
        meshing.add_ring(model, "lower", centre=(0, 0, 0), **shape)
        meshing.add_ring(model, "upper", centre=(offset, height, 0), **shape)

    material = nts.SaintVenantKirchhoff(E=2e7, nu=1 / 6, rho=1e3)
    lower, upper, pair = two_bodies(build, material, nts.Coulomb(mu, eps_T))
    stepper = nts.EnergyMomentum([lower, upper], [pair], dt=0.05)
    stepper.set_velocity(upper, (0, -4, 0))
    return collide(stepper, until)


def neo_hooke(C: Any, lmbda: Any, mu: Any) -> Any:
    """Strain energy mu/2 (tr C - 3 - ln det C) + lambda/8 (ln det C)^2."""
    ln = ufl.ln(ufl.det(C))
    return mu / 2 * (ufl.tr(C) - 3 - ln) + lmbda / 8 * ln**2


@cache
def tori(until: float, method: str = "node-to-segment") -> Run:
    """A torus falls on another, tilted by 45 degrees, off the centre. Collective."""
    shape = {"radius": 76.0, "inner_radius": 19.5, "outer_radius": 24.0, "cells": (36, 12, 1)}

    def build(model: Any) -> None:
        meshing.add_torus(model, "lower", centre=(0, 0, 0), **shape)
        meshing.add_torus(model, "upper", centre=(20, 0, 110), axis=(0, -1, 1), **shape)

    E, nu = 2250.0, 0.3
    lame = {"lmbda": E * nu / ((1 + nu) * (1 - 2 * nu)), "mu": E / (2 * (1 + nu))}
    material = nts.Hyperelastic(neo_hooke, rho=0.1, **lame)
    lower, upper, pair = two_bodies(build, material, None, method)
    stepper = nts.EnergyMomentum([lower, upper], [pair], dt=0.05)
    stepper.set_velocity(upper, (0, 0, -30))
    return collide(stepper, until)


def check_balances(run: Run) -> None:
    """Assert what holds in any collision."""
    assert max(run.active) > 0
    assert run.linear_drift <= MOMENTUM_TOLERANCE
    assert run.angular_drift <= MOMENTUM_TOLERANCE
    assert run.ledger_error <= LEDGER_TOLERANCE
    if run.dissipation == 0:
        assert run.energy_error <= ENERGY_TOLERANCE


def check_rebound(run: Run) -> None:
    """Assert that the bodies met and are separating."""
    assert run.approach[0] > 0 > run.approach[1]
    assert not any(run.active[-5:])


def balances(run: Run) -> str:
    """Report the conservation errors."""
    energy = run.ledger_error if run.dissipation else run.energy_error
    return f"{energy:.0e}, {run.linear_drift:.0e}, {run.angular_drift:.0e}"


@pytest.mark.serial
def test_two_rings_rebound_with_exact_energy_and_momenta(table_row):
    run = rings(0.0, 9.0)
    table_row("two soft rings", "energy, linear and angular momentum are conserved", balances(run))
    check_balances(run)
    check_rebound(run)
    assert run.dissipation == 0


@pytest.mark.serial
@pytest.mark.parametrize("eps_T", [None, 1e6], ids=["exact", "spring"])
def test_two_rings_with_friction_spin_afterwards(eps_T, table_row):
    run = rings(0.3, 9.0, eps_T)
    table_row(
        f"two soft rings, μ = 0.3, {'tangential spring' if eps_T else 'exact friction'}",
        "energy with dissipation, linear and angular momentum are conserved",
        balances(run),
    )
    check_balances(run)
    check_rebound(run)
    assert run.dissipation > 0
    assert np.mean(run.iterations) <= MEAN_ITERATIONS
    assert np.abs(run.spins[:, 2]).min() >= TURNS
    # Equal forces at equal lever arms rotate both in the same direction.
    assert np.prod(run.spins[:, 2]) > 0


@pytest.mark.serial
@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
def test_two_tori_rebound_with_exact_energy_and_momenta(method, table_row):
    run = tori(9.0, method)
    table_row(
        f"two soft tori (Yang and Laursen 2008), {method}",
        "energy, linear and angular momentum are conserved",
        balances(run),
    )
    check_balances(run)
    check_rebound(run)
    assert np.linalg.norm(run.spins, axis=1).min() >= TURNS


@pytest.mark.several_ranks
def test_rings_keep_the_balances_on_any_number_of_ranks():
    check_balances(rings(0.3, 1.0))


@pytest.mark.at_most_two_ranks
@pytest.mark.several_ranks
def test_tori_keep_the_balances_on_any_number_of_ranks():
    check_balances(tori(1.0))
