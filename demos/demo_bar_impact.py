"""An elastic bar strikes a wall: the exact wave solution."""

# # A bar strikes a wall
#
# The impact of a bar has an exact solution, so the force and the duration of
# contact can be checked.
#
# You will learn
#
# - how to build a body without a mesh file,
# - how to use a rigid obstacle,
# - how well a mesh of one hundred cells reproduces the wave solution.
#
# ## Problem
#
# Steel bar, length L = 1 m, cross-section A = 0.01 m x 0.01 m, E = 210 GPa,
# $\rho$ = 7850 kg/m³, $\nu$ = 0, velocity v = 1 m/s towards the wall x = 0.
#
# ## Equations
#
# A wave with the stress $-\rho c v$, $c = \sqrt{E/\rho}$, runs to the free end and
# comes back as a release wave. Until then the force on the wall is
#
# $$ F = \rho c v A, \qquad 0 < t < 2 L / c, \tag{1} $$
#
# and then the bar leaves the wall, free of stress, with the velocity -v.

# +
import os

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

E, rho, v = 210e9, 7850.0, 1.0  # Pa, kg/m^3, m/s
length, width, num_cells = 1.0, 0.01, 100
c = np.sqrt(E / rho)  # m/s
full = 2 * num_cells + 20
num_steps = int(os.environ.get("NTS_DEMO_STEPS", str(full)))  # The tests shorten it.
dt = length / num_cells / c  # s, in which the wave passes a cell
exact = rho * c * v * width**2  # N
# -

# ## Mesh, body and contact
#
# `read_mesh` takes a file, a live gmsh model, or a function that fills a model.


# +
def build(model):
    """Add the bar, with the surfaces bar_left, bar_right, ..."""
    box = {"corner": (0, 0, 0), "size": (length, width, width), "cells": (num_cells, 1, 1)}
    parts.add_box(model, "bar", **box)


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
bar = nts.Body(V, cells, tag["bar"], nts.SaintVenantKirchhoff(E=E, nu=0.0, rho=rho))
wall = nts.RigidPlane((0, 0, 0), (1, 0, 0))
contact = nts.ContactPair(nts.Surface(V, facets, tag["bar_left"]), wall)

stepper = nts.EnergyMomentum([bar], [contact], dt=dt)
stepper.set_velocity(bar, (-v, 0, 0))
diagnostics = nts.Diagnostics(stepper)
before = diagnostics.balance()
t, force = [], []
with nts.Recorder("bar_impact", stepper, every=10) as record:
    for step in stepper.run(until=num_steps * dt):
        record.write(step)
        t.append(step.t - dt / 2)
        force.append(diagnostics.balance().contact_force[0])
after = diagnostics.balance()
# -

# ## Pictures
#
# The kinetic energy becomes strain energy and is then recovered.

plotting.energies("bar_impact.csv", "bar_impact_energies.png")

# By default springs keep the nodes out of the wall. They have 3/5 of the stiffness of
# the cells behind them, so the force rises and falls within a few steps.

# +
if mesh.comm.rank == 0:
    figure, axes = plt.subplots(figsize=(6.4, 4), dpi=250, layout="constrained")
    axes.plot(np.array(t) * 1e3, np.array(force) / 1e3, label="computed")
    expected = np.array([0, exact, exact, 0]) / 1e3
    axes.plot(np.array([0, 0, 2, 2]) * length / c * 1e3, expected, label="exact")
    axes.set(xlabel="time [ms]", ylabel="force on the wall [kN]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig("bar_impact_force.png")
# -

# ## Checks
#
# The energy is constant. The impulse must be $2 \rho L A v$, the time with more
# than half of the force (1) $2 L/c$, and the force in the middle half of this time
# that of (1) on average, each within 1 %.

# +
assert abs(after.total_energy / before.total_energy - 1) < 1e-10
if num_steps == full:
    impulse = np.sum(force) * dt
    assert abs(impulse / (2 * rho * length * width**2 * v) - 1) < 0.01, impulse
    duration = np.count_nonzero(np.array(force) > exact / 2) * dt
    assert abs(duration / (2 * length / c) - 1) < 0.01, duration
    mean = np.mean(force[num_cells // 2 : 3 * num_cells // 2])
    assert abs(mean / exact - 1) < 0.01, mean
    if mesh.comm.rank == 0:
        print(f"force {mean:.1f} N (exact {exact:.1f} N)")
        print(f"duration {duration * 1e3:.4f} ms (exact {2e3 * length / c:.4f} ms)")
