"""A ball slides to and fro in a bowl."""

# # A ball in a bowl
#
# A rubber ball slides without friction in a rubber bowl, like a pendulum.
#
# You will learn
#
# - how to hold a body by boundary conditions,
# - how contact moves over curved, faceted surfaces of both bodies,
# - that the facets of the mesh affect the result.
#
# ## Problem
#
# The bowl has an inner radius of 1 m and an outer radius of 1.1 m, and is fixed
# at the outer surface. The ball has r = 0.3 m and is released 30 degrees from
# the bottom; g = 9.81 m/s². Both have E = 1 MPa, $\nu$ = 0.3 and
# $\rho$ = 1000 kg/m³.
#
# ## Equations
#
# The centre moves like a pendulum of length l = 1 m - r. With the
# amplitude $\alpha$, it passes the bottom after
#
# $$ \frac{T}{4} = \frac{\pi}{2} \sqrt{\frac{l}{g}}
#    \left( 1 + \frac{\alpha^2}{16} + \dots \right). \tag{1} $$

# +
import os

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

full, dt = 100, 0.01  # s
num_steps = int(os.environ.get("NTS_DEMO_STEPS", str(full)))  # The tests shorten it.
r, alpha, g = 0.3, np.pi / 6, 9.81  # m, -, m/s^2
length = 1.0 - r - 0.006  # m; the facets of both bodies leave that much room


def build(model):
    """Add the bowl and the ball."""
    wall = {"inner_radius": 1.0, "outer_radius": 1.1, "cells_per_edge": 16, "layers": 1}
    parts.add_bowl(model, "bowl", centre=(0, 0, 0), **wall)
    centre = (length * np.sin(alpha), 0, -length * np.cos(alpha))
    parts.add_solid_ball(model, "ball", centre=centre, radius=r, cells_per_edge=6, layers=2)


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
rubber = nts.NeoHookean(E=1e6, nu=0.3, rho=1e3)
ball, bowl = (nts.Body(V, cells, tag[name], rubber) for name in ("ball", "bowl"))
inside = nts.Surface(V, facets, tag["bowl_inner"])
contact = nts.ContactPair(nts.boundary_of(ball), inside)
held = fem.locate_dofs_topological(V, 2, facets.find(tag["bowl_outer"]))
bc = fem.dirichletbc(np.zeros(3), held, V)
# -

# ## Run

# +
gravity = nts.Gravity([ball], (0, 0, -g))
stepper = nts.EnergyMomentum([ball, bowl], [contact], dt=dt, bcs=[bc], loads=[gravity])
diagnostics = nts.Diagnostics(stepper)
t, x, work = [0.0], [diagnostics.centre_of_mass(ball)[0]], 0.0
with nts.Recorder("bowl", stepper, every=5) as record:
    for step in stepper.run(until=num_steps * dt):
        record.write(step)
        t.append(step.t)
        x.append(diagnostics.centre_of_mass(ball)[0])
        work += step.load_work
# -

# ## Picture

# +
plotting.snapshot(stepper, "bowl.png", camera=(0, -0.8, 0.6))
# -

# ## Checks
#
# The energy equals the work of gravity, to 1e-9 of the ball's m g l. The ball
# passes the bottom at the time (1) within 3 %. On the other side it comes as
# far within 10 %, because facets and vibrations change its path.

# +
weight = 1e3 * 4 / 3 * np.pi * r**3 * g
assert abs(diagnostics.balance().total_energy - work) < 1e-9 * weight * length
if num_steps == full:
    quarter = np.interp(0.0, -np.array(x[: np.argmin(x)]), t[: np.argmin(x)])
    theory = np.pi / 2 * np.sqrt(length / g) * (1 + alpha**2 / 16)
    if mesh.comm.rank == 0:
        print(f"passes the bottom at {quarter:.4f} s (pendulum {theory:.4f} s)")
        print(f"comes back to {-min(x) / x[0]:.4f} of the start")
    assert abs(quarter / theory - 1) < 0.03
    assert abs(-min(x) / x[0] - 1) < 0.1
