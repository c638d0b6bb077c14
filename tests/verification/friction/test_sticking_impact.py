"""Oblique impact of an elastic ball that sticks, against the theory of Hertz and Mindlin.

The ball neither rotates nor slides before it strikes a rigid plane at an angle; friction lets it
stick. The tangential force follows the elastic slip of the contact area, which reverses during the
impact (Maw, Barber and Fawcett 1976). Reduced to a foundation of springs along a line (Popov and
Hess 2015), with moduli E/(1 - nu^2) and 4 G/(2 - nu) and the profile x^2/R, that theory is exact
for a half-space.
"""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import meshing
from helpers.models import shapes

R, E, NU, RHO = 0.05, 1e7, 0.3, 1e3  # m, Pa, -, kg/m^3
FALL, ALONG, MU = 1.0, 0.3, 5.0  # m/s, m/s, -
# The contact area is not much smaller than the ball, and has the radius of one facet. Springs with
# the static stiffness of nodes have an error of 80 %.
TOLERANCE = 0.35


def duration():
    """Hertz's duration of the impact [s]."""
    mass, stiffness = 4 / 3 * np.pi * R**3 * RHO, 4 / 3 * E / (1 - NU**2) * np.sqrt(R)
    return 2.9432 * (5 * mass * FALL**2 / 4 / stiffness) ** 0.4 / FALL


def theory(num_springs=200, num_steps=3000):
    """Speed along the plane, and circumferential speed, after the impact [m/s]."""
    mass, dt = 4 / 3 * np.pi * R**3 * RHO, duration() / num_steps
    depth = 1.1 * FALL * duration() / 2.9432
    x, dx = np.linspace(0, np.sqrt(R * depth), num_springs, retstep=True)
    normal, along = 2 * dx * E / (1 - NU**2), 2 * dx * 2 * E / (1 + NU) / (2 - NU)
    z, down, speed, spin, slip = 0.0, -FALL, ALONG, 0.0, np.zeros(num_springs)
    while z <= 0 or down <= 0:
        z += down * dt
        pressed = np.fmax(-z - x**2 / R, 0.0)
        limit = MU * normal * pressed / along
        slip = np.clip(np.where(pressed > 0, slip + (speed - spin) * dt, 0.0), -limit, limit)
        down += normal * pressed.sum() / mass * dt
        force = -along * slip.sum()
        speed += force / mass * dt
        spin -= 2.5 * force / mass * dt
    return speed, spin


def strike(scheme, cells_per_edge, **options):
    """The same speeds of a mesh with default contact [m/s]. Collective."""

    def build(model):
        shape = {"cells_per_edge": cells_per_edge, "layers": cells_per_edge // 2}
        meshing.add_solid_ball(model, "ball", centre=(0, 0, R), radius=R, **shape)

    mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    ball = nts.Body(V, cells, tag["ball"], nts.NeoHookean(E=E, nu=NU, rho=RHO))
    plane = nts.RigidPlane((0, 0, 0), (0, 0, 1))
    stepper = scheme([ball], nts.all_pairs([ball], obstacles=[plane], friction=MU), **options)
    stepper.set_velocity(ball, (ALONG, 0.0, -FALL))
    for _ in stepper.run(until=1.3 * duration()):
        pass
    diagnostics = nts.Diagnostics(stepper)
    velocity, momentum = diagnostics.body_velocity(ball), diagnostics.balance().linear_momentum
    spin = 2.5 * shapes.spin(stepper, ball)[1] * velocity[2] / momentum[2]
    return velocity[0], spin / R


@pytest.mark.serial
@pytest.mark.parametrize(
    ("scheme", "cells_per_edge"),
    [(nts.EnergyMomentum, 8), (nts.CentralDifference, 12)],
    ids=["energy-momentum", "explicit"],
)
def test_a_ball_that_sticks_leaves_with_the_spin_of_theory(scheme, cells_per_edge, table_row):
    steps = {"dt": duration() / 40} if scheme is nts.EnergyMomentum else {}
    expected, found = theory(), strike(scheme, cells_per_edge, **steps)
    speed, spin = np.array(found) / expected - 1
    table_row(
        f"oblique impact of a ball that sticks, {scheme.__name__}",
        f"speed {expected[0]:.3f} m/s, spin times radius {expected[1]:.3f} m/s (Hertz, Mindlin)",
        f"{100 * speed:+.1f} %, {100 * spin:+.0f} %",
    )
    assert abs(speed) < TOLERANCE and abs(spin) < TOLERANCE
