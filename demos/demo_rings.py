"""Two soft rings collide, with friction."""

# # Two soft rings
#
# A thin ring strikes another one off-centre, and friction makes both spin.
#
# You will learn
#
# - what exact Coulomb friction, without a tangential spring, does,
# - that friction conserves linear and angular momentum,
# - how the ledger accounts for the energy.
#
# ## Problem
#
# Both rings have a diameter of 20 m, a wall of 0.3 m and a width of 1 m
# (St. Venant-Kirchhoff, E = 20 MPa, $\nu$ = 1/6, $\rho$ = 1000 kg/m³). One ring
# is at rest. The other flies at 4 m/s along a line that passes the centre of
# the first at a distance of 5 m; $\mu$ = 0.3.
#
# ## Equations
#
# With `LagrangeMultiplier()`, the forces of a node, $t_N \le 0$ and $t_T$, satisfy
# Coulomb's law without springs,
#
# $$ |t_T| \le -\mu t_N, \qquad
#    \text{slip} = 0 \text{ where } |t_T| < -\mu t_N, \tag{1} $$
#
# and the energy changes only by the work of the slip,
#
# $$ E_{n+1} - E_n = -\mu \sum |t_N| \, |\text{slip}|. \tag{2} $$

# +
import os

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

full, dt = 180, 0.05  # s
num_steps = int(os.environ.get("NTS_DEMO_STEPS", str(full)))  # The tests shorten it.
ring = {"inner_radius": 9.7, "outer_radius": 10.0, "width": 1.0, "cells": (64, 1, 1)}
offset, distance = 5.0, 20.1  # m


def build(model):
    """Add both rings."""
    parts.add_ring(model, "lower", centre=(0, 0, 0), **ring)
    centre = (offset, np.sqrt(distance**2 - offset**2), 0)
    parts.add_ring(model, "upper", centre=centre, **ring)


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
rubber = nts.SaintVenantKirchhoff(E=2e7, nu=1 / 6, rho=1e3)
lower, upper = (nts.Body(V, cells, tag[name], rubber) for name in ("lower", "upper"))
surfaces = [nts.Surface(V, facets, tag[f"{name}_outer"]) for name in ("upper", "lower")]
contact = nts.ContactPair(*surfaces, nts.LagrangeMultiplier(), friction=nts.Coulomb(0.3))

stepper = nts.EnergyMomentum([lower, upper], [contact], dt=dt)
stepper.set_velocity(upper, (0, -4.0, 0))
before = nts.Diagnostics(stepper).balance()
# -

# ## Run

# +
dissipation, active = 0.0, []
with nts.Recorder("rings", stepper, every=10) as record:
    for step in stepper.run(until=num_steps * dt):
        record.write(step)
        active.append(step.num_active)
        dissipation += mesh.comm.allreduce(contact.history.dissipation.sum())
        if step.step == min(50, num_steps):
            picture = plotting.snapshot(stepper, "rings.png", camera=(0, 0, 1))
# -

# The pictures show the rings in contact, then the energies with the part that friction took,
# and the momenta.

picture

plotting.ledger("rings.csv", "rings_ledger.png")

plotting.momenta("rings.csv", "rings_momenta.png")

# ## Checks
#
# The momenta are constant to round-off, and so is the sum of energy and
# dissipation, to 1e-9. Over the whole impact, friction takes a few per cent of
# the energy.

# +
after = nts.Diagnostics(stepper).balance()
for name in ("linear_momentum", "angular_momentum"):
    first, last = getattr(before, name), getattr(after, name)
    assert np.linalg.norm(last - first) < 1e-10 * np.linalg.norm(first), name
assert abs((after.total_energy + dissipation) / before.total_energy - 1) < 1e-9
if num_steps == full:
    assert max(active) > 0 and not any(active[-5:])
    assert 1e-3 < dissipation / before.total_energy < 0.3
if mesh.comm.rank == 0:
    print(record.summary())
