"""A rubber ball strikes a plate, with both schemes."""

# # A rubber ball strikes a plate
#
# A hollow ball strikes a free plate at an angle. Two schemes compute the
# same impact, and only one of them conserves the energy.
#
# You will learn
#
# - how to describe two bodies and the contact between them,
# - how to record and draw a run,
# - what happens to the energy in an impact.
#
# ## Problem
#
# Ball: outer radius 1 m, inner radius 0.8 m, flying with
# v = (0, 1, -1) m/s. Plate: 4 m x 4 m x 0.4 m, at rest. Both are made of
# rubber (St. Venant-Kirchhoff, E = 100 kPa, $\nu$ = 0.4, $\rho$ = 1000 kg/m³).
# There are no supports and no gravity, so the total linear momentum, angular
# momentum and energy are constant (Franke, Hesch, Betsch 2011).
#
# ## Equations
#
# A step from $t_n$ to $t_{n+1} = t_n + \Delta t$ solves, with the mass matrix
# $M$, the positions $x$ and the contact forces $\lambda_N \le 0$ of the active nodes,
#
# $$ \frac{2}{\Delta t} M \left( \frac{x_{n+1} - x_n}{\Delta t} - v_n \right)
#    + f_{int} + \sum \lambda_N F = 0, \tag{1} $$
#
# and the velocity follows from $v_{n+1} = 2 (x_{n+1} - x_n) / \Delta t - v_n$.
#
# where F is the gradient of the gap g. `Midpoint` evaluates the stress and F at the
# mean of both states. Here its $\lambda_N$ are Lagrange multipliers that close the gap
# at $t_{n+1}$. This is a plastic impact, in which nodes lose their impact energy.
#
# `EnergyMomentum` takes the stress and F from difference quotients of energy and
# gap. Springs, the default, keep the surfaces apart. Their force is the difference
# quotient of their energy U(g), so that the energy E of bodies and springs is constant:
#
# $$ E_{n+1} - E_n = \sum \left( U_{n+1} - U_n - \lambda_N (g_{n+1} - g_n) \right) = 0,
#    \qquad \lambda_N = \frac{U_{n+1} - U_n}{g_{n+1} - g_n}. \tag{2} $$

# +
import os
from pathlib import Path

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

num_steps = int(os.environ.get("NTS_DEMO_STEPS", "100"))  # The tests shorten it.
dt = 0.01  # s


def build(model):
    """Add the ball, 0.05 m above the plate."""
    ball = {"centre": (0.0, -0.5, 1.05), "inner_radius": 0.8, "outer_radius": 1.0}
    parts.add_hollow_ball(model, "ball", **ball, cells_per_edge=6, layers=2)
    plate = {"corner": (-2.0, -2.0, -0.4), "size": (4.0, 4.0, 0.4), "cells": (10, 10, 1)}
    parts.add_box(model, "plate", **plate)


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
# -

# ## Bodies and contact
#
# `tag` maps the names of gmsh's physical groups to tag numbers. The nodes of
# the ball must not pass through the segments of the plate. Without a contact law, a
# pair has springs, whose stiffness follows from the bodies. The other law is the
# plastic impact of the reference.

# +
rubber = nts.SaintVenantKirchhoff(E=1.0e5, nu=0.4, rho=1.0e3, one_point=())  # Pa, -, kg/m^3
ball = nts.Body(V, cells, tag["ball"], rubber)
plate = nts.Body(V, cells, tag["plate"], rubber)
ball_outer = nts.Surface(V, facets, tag["ball_outer"])
plate_top = nts.Surface(V, facets, tag["plate_top"])
springs = nts.ContactPair(ball_outer, plate_top)
plastic = nts.ContactPair(ball_outer, plate_top, nts.LagrangeMultiplier("plastic"))
# -

# ## Both schemes
#
# The recorder writes one row of balances per step, and fields for ParaView
# every fifth step.


# +
def strike(name, scheme, contact):
    """Compute the impact, write files that begin with ``name``, and return two pictures."""
    stepper = scheme([ball, plate], [contact], dt=dt)  # s
    stepper.set_velocity(ball, (0.0, 1.0, -1.0))  # m/s
    with nts.Recorder(name, stepper, every=5) as record:
        for step in stepper.run(until=num_steps * dt):
            record.write(step)
            if step.step == min(50, num_steps):
                picture = plotting.snapshot(stepper, f"{name}.png", cut=(1, 0, 0))
                pressure = plotting.contact(stepper, f"{name}_pressure.png")
    if mesh.comm.rank == 0:
        print(record.summary(), end="\n\n")
    return record, picture, pressure


energy_momentum, picture, pressure = strike("ball_plate", nts.EnergyMomentum, springs)
midpoint, _, _ = strike("ball_plate_midpoint", nts.Midpoint, plastic)
# -

# ## Pictures
#
# The ball, here cut open, is flat where it touches the plate.

picture

# This is the contact pressure on its underside.

pressure

# During the impact, a part of the kinetic energy becomes strain energy.

plotting.energies("ball_plate.csv", "ball_plate_energies.png")

# The momenta do not change:

plotting.momenta("ball_plate.csv", "ball_plate_momenta.png")

# The energy changes with one of the schemes:

# +
plotting.energy_error(
    {
        "midpoint rule, plastic impact": "ball_plate_midpoint.csv",
        "energy-momentum scheme, springs": "ball_plate.csv",
    },
    "ball_plate_energy_error.png",
)
# -

# ## Checks
#
# An independent program gives the mass of the meshed ball, 1983.755251 kg.
# From it follow the energy m (1 + 1)/2, the linear momentum m (0, 1, -1)
# and, with the centre (0, -0.5, 1.05), the angular momentum about the
# origin. Both schemes conserve the momenta, and the energy-momentum scheme
# conserves the energy as well. The other run loses 0.14 % of the energy; the
# last columns of its table say how: -2.8 J at nodes that stop in the impact
# (activation), and -0.05 J by the midpoint rule itself (bulk, persistent contact).

# +
m = 1983.755251244
for record in (energy_momentum, midpoint):
    end = record.diagnostics.balance()
    assert np.allclose(end.linear_momentum, [0.0, m, -m], rtol=0.0, atol=1e-10 * m)
    assert np.allclose(end.angular_momentum, [-0.55 * m, 0.0, 0.0], rtol=0.0, atol=1e-10 * m)
    drift = abs(end.total_energy - m) / m
    if record is energy_momentum:
        assert drift < 1e-10, drift
    elif num_steps >= 10:
        assert 1e-4 < drift < 2e-3, drift

if mesh.comm.rank == 0:
    print(f"Tables (.csv), fields (.vtkhdf) and pictures (.png) are in {Path.cwd()}")
# -

# ## Reference
#
# M. Franke, C. Hesch, P. Betsch (2011), eqs. 47-58.
