"""Drop test: a box falls with one edge on the edge of a rail, and begins to turn."""

# # A drop test of a box
#
# A box falls on the sharp edge of a rigid rail. Its own lowest edge crosses the rail between two
# nodes of the mesh. The box rebounds and turns.
#
# You will learn
#
# - how to compute the contact of edges that cross,
# - what the impact does to velocity and rotation, compared with a rigid box,
# - how to get the largest force and acceleration of a drop test.
#
# ## Problem
#
# The box (neo-Hooke, E = 2 GPa, $\nu$ = 0.3, $\rho$ = 300 kg/m³) has the length L = 0.4 m and a
# square cross-section with the width b = 0.2 m. It has fallen by 0.2 m, so that it arrives with
# v = 1.98 m/s. Its lowest edge crosses the edge of the rail at the distance r = 0.09 m from its
# middle. There is no friction, and gravity is neglected while the box touches the rail.
#
# ## Equations
#
# The impulse J on a rigid box with the mass m and the moment of inertia I = m (L² + b²)/12 changes
# its velocity by J/m and its angular velocity by Jr/I. The energy is the same before and after
# the impact if the point of contact leaves as fast as it arrives, so that
#
# $$ J = \frac{2 m v}{1 + m r^2 / I}. \tag{1} $$
#
# This neglects vibrations of the box, and its rotation during the impact.

# +
import os

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

full, dt = 45, 3e-5  # s
num_steps = min(int(os.environ.get("NTS_DEMO_STEPS", str(full))), full)  # The tests shorten it.
L, b, r = 0.4, 0.2, 0.09  # m
E, nu, rho = 2e9, 0.3, 300.0  # Pa, -, kg/m^3
v = np.sqrt(2 * 9.81 * 0.2)  # m/s
above = 1e-5  # m, of the box above the rail in the beginning


def build(model):
    """Add the box, with its middle at the origin."""
    box = {"corner": (-L / 2, -b / 2, -b / 2), "size": (L, b, b)}
    parts.add_box(model, "box", **box, cells=(12, 6, 6))


mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
x, y, z = mesh.geometry.x.T.copy()
half = np.sqrt(0.5)
mesh.geometry.x[:] = np.c_[x, half * (y - z), half * (y + z) + half * b + above]  # on an edge
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
box = nts.Body(V, cells, tag["box"], nts.NeoHookean(E=E, nu=nu, rho=rho))
# -

# ## The rail and both pairs
#
# The rail has an edge along y, and two faces. One pair has the nodes of the box and these faces.
# The other has the edges that cross. Without it, the box would sink in until a node of its edge
# touches a face.

# +
w, d = 0.25, 0.05  # m, half of the length of the rail, and its depth
points = [(r, -w, 0), (r, w, 0), (r - d, -w, -d), (r - d, w, -d), (r + d, -w, -d), (r + d, w, -d)]
sides = [(-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)]  # m, points in front of the faces
rail = nts.RigidSurface(points, [[0, 1, 2, 3], [0, 1, 4, 5]], outside=sides, name="rail")
skin = nts.boundary_of(box)
edges = nts.ContactPair(skin, rail, nts.Penalty(), method="edge-to-edge", name="edges")
stepper = nts.EnergyMomentum([box], [nts.ContactPair(skin, rail), edges], dt=dt)
stepper.set_velocity(box, (0.0, 0.0, -v))
# -

# ## Run

# +
with nts.Recorder("drop_test", stepper, every=3, columns_of=("bodies", "obstacles")) as record:
    for step in stepper.run(until=num_steps * dt):
        record.write(step)
        if step.step == min(18, num_steps):
            picture = plotting.snapshot(stepper, "drop_test.png", camera=(1, -2.5, 0.6))
# -

# ## Pictures
#
# The stress is largest where the edges cross.

picture

# The force on the box lasts for a millisecond.

# +
if mesh.comm.rank == 0:
    table = np.genfromtxt("drop_test.csv", delimiter=",", names=True)
    force = -table["obstacle_rail_force_z"]
    figure, axes = plt.subplots(figsize=(6.4, 4), dpi=250, layout="constrained")
    axes.plot(1e3 * table["time"], 1e-3 * force, ".-")
    axes.set(xlabel="time [ms]", ylabel="force on the box [kN]")
    axes.grid(alpha=0.3)
    figure.savefig("drop_test_force.png")
# -

# ## Checks
#
# The impulse is that of (1) within 2 %, the energy is conserved to round-off, and the edges
# overlap by less than 0.1 mm.

# +
if mesh.comm.rank == 0:
    m = rho * L * b**2  # kg
    rigid = 2 * m * v / (1 + 12 * r**2 / (L**2 + b**2))  # N s
    impulse = m * (table["body_box_velocity_z"][-1] + v)
    assert np.abs(table["total_energy"] / table["total_energy"][0] - 1).max() < 1e-9
    assert table["min_gap"].min() > -1e-4
    if num_steps == full:
        assert table["active_nodes"][-1] == 0
        assert abs(impulse / rigid - 1) < 0.02
        print(f"impulse {impulse:.2f} N s (rigid box {rigid:.2f} N s)")
        print(f"largest force {force.max():.0f} N, acceleration {force.max() / m / 9.81:.0f} g")
