"""A ball falls onto a round plate: bodies of revolution in two dimensions."""

# # A ball on a drum
#
# A rubber ball falls onto the middle of a round plate that is clamped at its rim, and bounces.
# Nothing changes around the axis, so only half of the cross-section has to be meshed.
#
# You will learn
#
# - how to turn a plane mesh into one of bodies of revolution: `nts.axisymmetric(mesh)`,
# - that masses, forces and energies are those of the whole bodies,
# - which momenta exist, and what holds the nodes on the axis.
#
# ## Problem
#
# The coordinate x is the radius, and y is the axis. The ball has a radius of 0.1 m; the plate
# has a radius of 0.4 m and a thickness of 12 mm. Both are neo-Hookean with E = 1 MPa (ball) and
# 20 MPa (plate), $\nu$ = 0.45, $\rho$ = 1000 kg/m³. The ball arrives at 3 m/s.
#
# ## Equations
#
# The deformation gradient has one more component, the stretch of circles around the axis, and
# integrals go around the axis:
#
# $$ F_{33} = 1 + \frac{u_x}{x}, \qquad dV = 2 \pi x\, dx\, dy. \tag{1} $$

# +
import os

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import plotting

full, dt = 100, 0.0005  # s
num_steps = int(os.environ.get("NTS_DEMO_STEPS", str(full)))  # The tests shorten it.
radius, width, thickness, speed = 0.1, 0.4, 0.012, 3.0  # m, m/s


def build(model):
    """Add half a disc and a rectangle, the sections of ball and plate, at x >= 0."""
    disc = model.occ.addDisk(0, radius + 0.001, 0, radius, radius)
    right = model.occ.addRectangle(0, 0, 0, 1, 1)
    ((_, ball),), _ = model.occ.intersect([(2, disc)], [(2, right)])
    model.occ.synchronize()
    model.addPhysicalGroup(2, [ball], name="ball")
    model.mesh.setSize(model.getEntities(0), 0.01)
    model.mesh.setRecombine(2, ball)
    model.mesh.generate(2)
    plate = {"corner": (0, -thickness), "size": (width, thickness), "cells": (50, 2)}
    nts.parts.add_rectangle(model, "plate", **plate)


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
nts.axisymmetric(mesh)  # before anything else is made from the mesh
V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
ball = nts.Body(V, cells, tag["ball"], nts.NeoHookean(E=1e6, nu=0.45, rho=1e3))
plate = nts.Body(V, cells, tag["plate"], nts.NeoHookean(E=2e7, nu=0.45, rho=1e3))
rim = fem.locate_dofs_geometrical(V, lambda x: x[0] > width - 1e-6)
clamp = fem.dirichletbc(np.zeros(2), rim, V)  # the axis needs no condition
pairs = nts.all_pairs([ball, plate])
stepper = nts.EnergyMomentum([ball, plate], pairs, dt=dt, bcs=[clamp])
stepper.set_velocity(ball, (0.0, -speed))
# -

# ## Run

# +
diagnostics = nts.Diagnostics(stepper)
mass = diagnostics.bodies()["ball"].mass
momentum = [float(diagnostics.linear_momentum()[0])]
impulse = [0.0]
with nts.Recorder("drum", stepper, every=5, columns_of=("supports", "bodies")) as record:
    for step in stepper.run(until=num_steps * dt):
        record.write(step)
        momentum.append(float(diagnostics.linear_momentum()[0]))
        impulse.append(impulse[-1] + dt * step.reactions[0].force[0])
        if step.step == min(30, num_steps):
            picture = plotting.snapshot(stepper, "drum.png")
# -

# This is the stress while the ball bends the plate; the axis is on the left.

picture

plotting.energies("drum.csv", "drum_energies.png")

# ## Checks
#
# The mass of the ball is that of a sphere, within the error of its facets. The axial momentum,
# which is the only one, changes by the impulse of the clamp. The ledger explains all changes of
# the energy.

# +
assert abs(mass / (4 / 3 * np.pi * radius**3 * 1e3) - 1) < 0.005
gained = np.array(momentum) - momentum[0]
assert np.abs(gained - impulse).max() < 1e-9 * mass * speed
if mesh.comm.rank == 0:
    table = np.genfromtxt("drum.csv", delimiter=",", names=True)
    assert np.abs(table["energy_unaccounted"]).max() < 1e-9 * table["kinetic_energy"][0]
    print(record.summary())
if num_steps == full:
    rebound = float(diagnostics.body_velocity(ball)[0])
    assert 0.3 * speed < rebound < speed
