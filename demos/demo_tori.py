"""Two soft tori collide."""

# # Two tori
#
# A soft hollow torus strikes another one at an angle; both are free.
#
# You will learn
#
# - how to use a predefined shape twice, in different orientations,
# - how to use the whole boundary of a body as a surface,
# - that energy and momenta are conserved through large deformations and sliding contact.
#
# ## Problem
#
# The circle of each torus has the radius 76, and its tube the radii 19.5
# (inside) and 24 (outside); neo-Hooke, E = 2250, $\nu$ = 0.3, $\rho$ = 0.1. The
# axis of the upper torus is tilted by 45 degrees, and its centre is offset by
# 20. It arrives with the velocity 30 (Yang and Laursen 2008). Any consistent
# units will do.
#
# ## Equations
#
# Without supports, loads and friction, with momenta $p_a$ of the nodes,
#
# $$ \sum p_a, \quad \sum x_a \times p_a, \quad T + U \quad
#    \text{are constant.} \tag{1} $$

# +
import os

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

full, dt = 180, 0.05
num_steps = int(os.environ.get("NTS_DEMO_STEPS", str(full)))  # The tests shorten it.
shape = {"radius": 76.0, "inner_radius": 19.5, "outer_radius": 24.0, "cells": (30, 10, 1)}


def build(model):
    """Add both tori."""
    parts.add_torus(model, "lower", centre=(0, 0, 0), **shape)
    parts.add_torus(model, "upper", centre=(20, 0, 110), axis=(0, -1, 1), **shape)


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
rubber = nts.NeoHookean(E=2250.0, nu=0.3, rho=0.1, one_point=())
lower, upper = (nts.Body(V, cells, tag[name], rubber) for name in ("lower", "upper"))
# Elastic impact at nodes, with which the tori part within this run.
contact = nts.ContactPair(
    nts.boundary_of(upper),
    nts.boundary_of(lower),
    enforcement=nts.LagrangeMultiplier(),
    method="node-to-segment",
)

stepper = nts.EnergyMomentum([lower, upper], [contact], dt=dt)
stepper.set_velocity(upper, (0, 0, -30.0))
before = nts.Diagnostics(stepper).balance()
# -

# ## Run

# +
active = []
with nts.Recorder("tori", stepper, every=6) as record:
    for step in stepper.run(until=num_steps * dt):
        record.write(step)
        active.append(step.num_active)
        if step.step == min(60, num_steps):
            picture = plotting.snapshot(stepper, "tori.png", camera=(1, -0.6, 0.45))
# -

# ## Pictures
#
# The pictures show the tori in contact, and the whole run, coloured by the speed.

picture

plotting.animate("tori.vtkhdf", "tori.gif", colour="velocity", limits=(0, 60), fps=8)

# These are the energies and the momenta.

plotting.energies("tori.csv", "tori_energies.png")

plotting.momenta("tori.csv", "tori_momenta.png")

# ## Checks
#
# The invariants (1) are constant to round-off, relative to their size. At the
# end the tori have separated, and a part of the energy is vibration.

# +
after = nts.Diagnostics(stepper).balance()
for name in ("linear_momentum", "angular_momentum"):
    first, last = getattr(before, name), getattr(after, name)
    assert np.linalg.norm(last - first) < 1e-10 * np.linalg.norm(first), name
assert abs(after.total_energy / before.total_energy - 1) < 1e-10
if num_steps == full:
    assert max(active) > 0 and not any(active[-5:])
    vibration = after.strain_energy / after.total_energy
    assert 0.01 < vibration < 0.5, vibration
if mesh.comm.rank == 0:
    print(record.summary())
# -

# ## Reference
#
# B. Yang, T. A. Laursen (2008), Comput. Mech. 41, 189-205.
