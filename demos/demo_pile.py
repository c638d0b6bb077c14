"""Twenty-seven rubber balls fall into a box."""

# # A pile of balls
#
# Twenty-seven rubber balls fall into a box and come to rest as a pile.
#
# ![The pile](../docs/figures/pile.png)
#
# You will learn
#
# - how to let any body touch any other, and rigid walls,
# - how to compute explicitly, with a step that leaves room for cells that
#   get smaller,
# - how to damp.
#
# ## Problem
#
# Balls of radius 0.1 m in three layers, the rows shifted against each other;
# E = 100 kPa, nu = 0.3, rho = 1000 kg/m^3, stiffness damping 0.2 ms. Box
# 0.7 m x 0.7 m, friction 0.3 everywhere, g = 9.81 m/s^2.
#
# ## Equations
#
# Whatever the balls do, the floor carries in the mean, with the total mass m
# and the friction T_z at the walls,
#
# $$ \frac{1}{\tau} \int (F_z + T_z) \, dt = m g
#    + \frac{p_z(\tau) - p_z(0)}{\tau}, \tag{1} $$
#
# and at rest all momentum is gone.

# +
import logging
import os

from mpi4py import MPI

from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

r, half, g, end = 0.1, 0.35, 9.81, 1.6  # m, m, m/s^2, s
num_steps = int(os.environ.get("NTS_DEMO_STEPS", "0"))  # The tests shorten it.
centres = [
    (0.22 * i + 0.01 * k, 0.22 * j - 0.01 * k + 0.01 * i, 0.105 + 0.215 * k)
    for i in (-1, 0, 1)
    for j in (-1, 0, 1)
    for k in (0, 1, 2)
]


def build(model):
    """Add the balls."""
    for i, centre in enumerate(centres):
        shape = {"radius": r, "cells_per_edge": 4, "layers": 1}
        parts.add_solid_ball(model, f"ball {i}", centre=centre, **shape)


logging.basicConfig(format="%(message)s")
logging.getLogger("dolfinx_nts").setLevel(logging.INFO if num_steps == 0 else logging.WARNING)
mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
rubber = nts.NeoHookean(E=1e5, nu=0.3, rho=1e3, stiffness_damping=2e-4)
balls = [nts.Body(V, cells, tag[f"ball {i}"], rubber) for i in range(len(centres))]
# -

# ## Contact
#
# `all_pairs` logs what it builds: 26 pairs in which each two balls meet once,
# and one for each wall.

# +
walls = [
    nts.RigidPlane((-half * x, -half * y, 0), (x, y, z))
    for x, y, z in ((0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))
]
laws = {"enforcement": nts.Penalty(), "friction": nts.Coulomb(0.3)}
pairs = nts.all_pairs(balls, obstacles=walls, **laws)
logging.getLogger("dolfinx_nts").setLevel(logging.WARNING)
# -

# ## Run

# +
gravity = nts.Gravity(balls, (0, 0, -g))
stepper = nts.CentralDifference(balls, pairs, dt=5e-4, loads=[gravity])  # s
diagnostics = nts.Diagnostics(stepper)
until = num_steps * stepper.dt or end
camera = [(1.9, -1.5, 1.1), (0, 0, 0.25), (0, 0, 1)]
kinetic, impulse = [], 0.0
with nts.Recorder("pile", stepper, every=100) as record:
    for step in stepper.run(until=until):
        record.write(step)
        kinetic.append(diagnostics.kinetic_energy())
        forces = diagnostics.pair_resultants()[-len(walls) :, 0]
        impulse += forces[:, 2].sum() * step.dt
plotting.snapshot(stepper, "pile.png", camera=camera)
# -

# ## Checks
#
# Equation (1) with all walls: exactly up to damping's and the first step's
# share. At the end less than a hundredth of the greatest kinetic energy is
# left, and no ball has left the box.

# +
mass = mesh.comm.allreduce(stepper.mass.sum())
momentum = diagnostics.balance().linear_momentum[2]
if mesh.comm.rank == 0:
    print(f"impulse of the walls {impulse:.4f} N s, weight and momentum ", end="")
    print(f"{mass * g * until + momentum:.4f} N s")
    print(f"kinetic energy {kinetic[-1]:.4f} J, at most {max(kinetic):.4f} J")
assert abs(impulse - mass * g * until - momentum) < 0.01 * mass * g * until
if num_steps == 0:
    assert kinetic[-1] < 0.01 * max(kinetic)
    for ball in balls:
        x, y, z = diagnostics.centre_of_mass(ball)
        assert max(abs(x), abs(y)) < half and z > 0.8 * r
    if mesh.comm.rank == 0:
        print(record.summary())
