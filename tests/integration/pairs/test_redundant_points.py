"""Rigid bodies at rest, or nearly so, on redundant contact points, with exact friction."""

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers.once import once

MU, EDGE, G = 0.3, 0.1, 9.81
SCHEMES = pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.Midpoint])
# More iterations than Newton's method needs with correct contact states.
FEW = 12


def boxes(
    scheme: Any,
    number: int = 1,
    *,
    slope: float = 0.0,
    lift: float = 0.0,
    dt: float = 2e-3,
    e: float = 1.0,
    comm: MPI.Comm = MPI.COMM_SELF,
) -> tuple[Any, list[nts.RigidBody]]:
    """Stacked rigid boxes on a plane whose normal is tilted against gravity [rad]."""

    def build(model: Any) -> None:
        for i in range(number):
            corner = (0.0, 0.0, lift + i * EDGE)
            parts.add_box(model, f"box {i}", corner=corner, size=(EDGE,) * 3, cells=(1, 1, 1))

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bodies = [nts.RigidBody(V, cells, tag[f"box {i}"], rho=1000.0) for i in range(number)]
    floor = nts.RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    law = nts.LagrangeMultiplier(impact="restitution", e=e) if e < 1 else nts.LagrangeMultiplier()
    pairs = nts.all_pairs(
        bodies,
        obstacles=[floor],
        enforcement=law,
        friction=nts.Coulomb(MU),
        method="node-to-segment",
    )
    g = (G * np.sin(slope), 0.0, -G * np.cos(slope))
    return scheme(bodies, pairs, dt=dt, loads=[nts.Gravity(bodies, g)]), bodies


@pytest.mark.serial
@pytest.mark.parametrize("seed", [0, 3])
@SCHEMES
def test_a_die_that_comes_to_rest_needs_few_iterations_and_obeys_coulombs_law(scheme, seed):
    # Without step control each step must converge.
    rng = np.random.default_rng(seed)
    stepper, (die,) = boxes(scheme, lift=0.02, dt=4e-3, e=0.3)
    omega, v = rng.normal(size=3) * 4, np.append(rng.normal(size=2) / 2, -0.5)
    stepper.set_velocity(die, lambda x: np.cross(omega, x.T - x.T.mean(axis=0)).T + v[:, None])
    diagnostics = nts.Diagnostics(stepper)
    energy = first = diagnostics.balance().total_energy
    for _ in range(150):
        step = stepper.advance()
        assert step.newton_iterations <= FEW
        before, energy = energy, diagnostics.balance().total_energy
        if scheme is nts.EnergyMomentum:
            assert abs(energy - before - step.load_work - sum(step.contact_work)) < 1e-10 * first
        for contact in stepper.contacts:
            history = contact.history
            traction = np.linalg.norm(history.traction, axis=1)
            assert (traction + MU * history.lambda_N).max() < 1e-9
            assert history.lambda_N.max() <= 0
    assert np.linalg.norm(diagnostics.body_velocity(die)) < 0.02


@pytest.mark.serial
@SCHEMES
def test_a_box_that_slides_stops_where_the_closed_form_has_it(scheme):
    stepper, (box,) = boxes(scheme)
    speed = 0.5
    stepper.set_velocity(box, (speed, 0.0, 0.0))
    diagnostics = nts.Diagnostics(stepper)
    start = diagnostics.centre_of_mass(box)[0]
    iterations = [step.newton_iterations for step in stepper.run(until=0.2)]
    travel = diagnostics.centre_of_mass(box)[0] - start
    # It stops within a step.
    last = MU * G * stepper.dt**2
    assert abs(travel - speed**2 / (2 * MU * G)) < last
    # The mean velocity of a step is zero from then on.
    assert abs(diagnostics.body_velocity(box)[0]) < MU * G * stepper.dt
    assert max(iterations) <= FEW


@pytest.mark.parametrize("part", [0.9, once(1.2)])
@SCHEMES
def test_a_box_on_a_slope_slides_above_the_friction_angle(comm, scheme, part):
    slope = np.arctan(part * MU)
    stepper, (box,) = boxes(scheme, slope=slope, comm=comm)
    diagnostics = nts.Diagnostics(stepper)
    start = diagnostics.centre_of_mass(box)
    for step in stepper.run(until=0.1):
        assert step.newton_iterations <= FEW
    travel = diagnostics.centre_of_mass(box) - start
    acceleration = max(G * (np.sin(slope) - MU * np.cos(slope)), 0.0)
    np.testing.assert_allclose(travel, [acceleration * stepper.t**2 / 2, 0.0, 0.0], atol=1e-11)


@pytest.mark.serial
@SCHEMES
def test_a_stack_of_three_boxes_stays_at_rest(scheme):
    stepper, bodies = boxes(scheme, 3)
    diagnostics = nts.Diagnostics(stepper)
    starts = [diagnostics.centre_of_mass(body) for body in bodies]
    for _ in range(50):
        assert stepper.advance().newton_iterations <= FEW
    for body, start in zip(bodies, starts, strict=True):
        np.testing.assert_allclose(diagnostics.centre_of_mass(body), start, atol=1e-11)
        assert np.linalg.norm(diagnostics.body_velocity(body)) < 1e-9
