"""Twelve rubber balls fall into a box."""

# # A pile of balls
#
# Twelve soft rubber balls sink in a box of liquid and come to rest as a pile.
#
# You will learn
#
# - how to let bodies touch each other and rigid walls,
# - how to use explicit steps, with a margin for cells that get smaller,
# - how to add damping.
#
# ## Problem
#
# The balls have a radius of 0.1 m and lie in two layers with staggered rows;
# E = 30 kPa, $\nu$ = 0.3, $\rho$ = 1000 kg/m³. The box is 0.7 m x 0.48 m wide, the
# coefficient of friction is 0.3 everywhere, and g = 9.81 m/s². The liquid is a
# drag of $\alpha$ = 6/s times the momentum, without which the balls would bounce
# for a long time. Stiffness damping of 0.2 ms reduces the noise of the contact
# springs.
#
# ## Equations
#
# Whatever the balls do, with their total mass m and momentum $p_z$, the impulse
# of the vertical force $F_z$ of floor and walls is
#
# $$ \int_0^\tau F_z \, dt = m g \tau + p_z(\tau)
#    + \alpha \int_0^\tau p_z \, dt, \tag{1} $$
#
# and at rest the floor carries the weight.

# +
import logging
import os
import sys

from mpi4py import MPI

from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

r, half_x, half_y, g, alpha, end = 0.1, 0.35, 0.24, 9.81, 6.0, 1.2  # m, m, m, m/s^2, 1/s, s
num_steps = int(os.environ.get("NTS_DEMO_STEPS", "0"))  # The tests shorten it.
centres = [
    (0.22 * i + 0.01 * k, 0.22 * j - 0.01 * k + 0.01 * i, 0.105 + 0.215 * k)
    for i in (-1, 0, 1)
    for j in (-0.5, 0.5)
    for k in (0, 1)
]


def build(model):
    """Add the balls."""
    for i, centre in enumerate(centres):
        shape = {"radius": r, "cells_per_edge": 3, "layers": 1}
        parts.add_solid_ball(model, f"ball {i}", centre=centre, **shape)


logging.basicConfig(format="%(message)s", stream=sys.stdout)
logging.getLogger("dolfinx_nts").setLevel(logging.INFO if num_steps == 0 else logging.WARNING)
mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
damping = {"mass_damping": alpha, "stiffness_damping": 2e-4}  # 1/s, s
rubber = nts.NeoHookean(E=3e4, nu=0.3, rho=1e3, **damping)
balls = [nts.Body(V, cells, tag[f"ball {i}"], rubber) for i in range(len(centres))]
# -

# ## Contact
#
# `all_pairs` logs what it makes: 11 pairs, in which any two balls are combined
# once, and one pair for each wall. The springs let some balls sink into each
# other by a fifth of a facet, which the log reports once for any two of them. By
# default springs are a quarter as stiff, and nodes of balls this coarse sink too deep.

# +
walls = [
    nts.RigidPlane((-half_x * x, -half_y * y, 0), (x, y, z))
    for x, y, z in ((0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))
]
laws = {"enforcement": nts.Penalty(eps_N=2e3), "friction": nts.Coulomb(0.3)}  # N/m, -
pairs = nts.all_pairs(balls, obstacles=walls, **laws)
# -

# ## Run

# +
gravity = nts.Gravity(balls, (0, 0, -g))
stepper = nts.CentralDifference(balls, pairs, dt=1.2e-3, loads=[gravity])  # s
diagnostics = nts.Diagnostics(stepper)
until = num_steps * stepper.dt or end
kinetic, impulse, drag = [], 0.0, 0.0
with nts.Recorder("pile", stepper, every=100) as record:
    for step in stepper.run(until=until):
        record.write(step)
        kinetic.append(diagnostics.kinetic_energy())
        forces = diagnostics.pair_resultants()[-len(walls) :, 0]
        impulse += forces[:, 2].sum() * step.dt
        drag += alpha * diagnostics.linear_momentum()[2] * step.dt
# -

# These are the balls at rest.

plotting.snapshot(stepper, "pile.png", camera=(1.5, -1.2, 0.7))

# ## Checks
#
# Equation (1) holds up to the error of the sums, which is of first order in the
# step. At the end less than a hundredth of the largest kinetic energy is left,
# the floor carries the weight within 5 %, and no ball has left the box.

# +
mass = mesh.comm.allreduce(stepper.mass.sum())
momentum = diagnostics.balance().linear_momentum[2]
expected = mass * g * until + momentum + drag
if mesh.comm.rank == 0:
    print(f"impulse of floor and walls {impulse:.2f} N s, of the balls {expected:.2f} N s")
    print(f"kinetic energy {kinetic[-1]:.4f} J, at most {max(kinetic):.4f} J")
assert abs(impulse - expected) < 0.01 * mass * g * until
if num_steps == 0:
    assert kinetic[-1] < 0.01 * max(kinetic)
    if mesh.comm.rank == 0:
        print(f"floor and walls carry {forces[:, 2].sum():.1f} N (weight {mass * g:.1f} N)")
    assert abs(forces[:, 2].sum() / (mass * g) - 1) < 0.05
    for ball in balls:
        x, y, z = diagnostics.centre_of_mass(ball)
        assert abs(x) < half_x and abs(y) < half_y and z > 0.5 * r
    if mesh.comm.rank == 0:
        print(record.summary())
