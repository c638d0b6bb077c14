"""A ball is thrown along the floor: sliding becomes rolling."""

# # From sliding to rolling
#
# A bowling ball slides at first; friction slows it down and spins it up until
# it rolls.
#
# You will learn
#
# - how to add friction and gravity,
# - how to make a load grow with time,
# - what the energy ledger says about friction.
#
# ## Problem
#
# Solid ball, R = 1 m, on the plane z = 0, thrown with $v_0$ = 0.3 m/s and
# without spin; $\mu$ = 0.3, g = 10 m/s². The ball is stiff (E = 100 GPa), and
# gravity is increased within 5 ms, so that it hardly vibrates.
#
# ## Equations
#
# While the ball slides, friction $\mu m g$ slows it down and spins it up. With
# the moment of inertia $I = \tfrac{2}{5} m R^2$,
#
# $$ v = v_0 - \mu g t, \qquad R \omega = \tfrac{5}{2} \mu g t, \tag{1} $$
#
# until $v = R \omega$. From $t = 2 v_0/(7 \mu g)$ on, it rolls with $v = \tfrac{5}{7} v_0$.
# Friction has then taken two sevenths of its energy.

# +
import os

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

mu, g, speed, rise = 0.3, 10.0, 0.3, 0.005  # -, m/s^2, m/s, s
dt, full = 5e-4, 96  # s
num_steps = int(os.environ.get("NTS_DEMO_STEPS", str(full)))  # The tests shorten it.


def build(model):
    """Add the ball."""
    ball = {"centre": (0, 0, 1), "radius": 1.0, "cells_per_edge": 8, "layers": 2}
    parts.add_solid_ball(model, "ball", **ball)


def gravity(t):
    """Grow smoothly to (0, 0, -g)."""
    s = min(t / rise, 1.0)
    return (0, 0, -g * s * s * (3 - 2 * s))


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
ball = nts.Body(V, cells, tag["ball"], nts.SaintVenantKirchhoff(E=1e11, nu=0.3, rho=1e3))
floor = nts.RigidPlane((0, 0, 0), (0, 0, 1))
contact = nts.ContactPair(nts.boundary_of(ball), floor, friction=nts.Coulomb(mu))
# -

# ## Run
#
# The dissipation of a step is the sum over the nodes that slide.

# +
stepper = nts.EnergyMomentum([ball], [contact], dt=dt, loads=[nts.Gravity([ball], gravity)])
stepper.set_velocity(ball, (speed, 0, 0))
diagnostics = nts.Diagnostics(stepper)
start = diagnostics.balance().total_energy
t, v, work, dissipation = [0.0], [speed], 0.0, 0.0
with nts.Recorder("rolling", stepper, every=8) as record:
    for step in stepper.run(until=num_steps * dt):
        record.write(step)
        t.append(step.t)
        v.append(diagnostics.body_velocity(ball)[0])
        work += step.load_work
        dissipation += mesh.comm.allreduce(contact.history.dissipation.sum())
end = diagnostics.balance().total_energy
# -

# ## Pictures
#
# The displacements show that the ball rolls. Its speed decreases to that of a
# rigid ball.

plotting.snapshot(stepper, "rolling.png", colour="displacement")

# +
if mesh.comm.rank == 0:
    figure, axes = plt.subplots(figsize=(6.4, 4), dpi=250, layout="constrained")
    axes.plot(np.array(t) * 1e3, v, label="computed")
    exact = np.maximum(speed - mu * g * np.maximum(np.array(t) - rise / 2, 0), 5 / 7 * speed)
    axes.plot(np.array(t) * 1e3, exact, "--", label="rigid ball")
    axes.set(xlabel="time [ms]", ylabel="speed of the centre [m/s]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig("rolling_speed.png")
# -

# ## Checks
#
# Energy, dissipation and work of gravity balance to round-off. The ball
# rolls with 5/7 of its initial speed, within 1 %.

# +
assert abs((end + dissipation - work) / start - 1) < 1e-9
if num_steps == full:
    rolling = np.mean(v[-20:])
    assert abs(rolling / (5 / 7 * speed) - 1) < 0.01, rolling
    if mesh.comm.rank == 0:
        print(f"speed {rolling:.4f} m/s (rigid ball {5 / 7 * speed:.4f} m/s)")
        print(f"dissipation {dissipation / start:.4f} of the energy (rigid ball {2 / 7:.4f})")
