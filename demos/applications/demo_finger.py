"""A pneumatic finger bends under pressure and presses on an object."""

# # A pneumatic finger
#
# A soft finger with a row of chambers is inflated. It bends, until it touches a round object, and
# presses on it.
#
# You will learn
#
# - how to inflate chambers by a pressure that follows their walls,
# - how to get the rotation of the tip, and the force on the object,
# - how well beam theory predicts the bending of a soft actuator.
#
# ## Problem
#
# The scene is in plane strain and without inertia. The finger (neo-Hooke, E = 0.5 MPa,
# $\nu$ = 0.45) is fixed at its left end. Its upper wall is 2 mm thick, its lower wall 4 mm. Between
# them are 20 chambers of the height h = 8 mm, which are 4 mm long, with ribs of 1 mm. They are
# inflated by p = 40 kPa. The object is a rigid cylinder with the radius 15 mm, without friction.
# Forces are those of one metre of width.
#
# ## Equations
#
# On each cross-section the pressure acts with the force p h in the middle of the chamber, at
# $y_c$. The walls carry it. Their centroid is at $y_w$, and their second moment of area is I. So
# the pressure bends them to the curvature
#
# $$ \kappa = \frac{p h\, (y_c - y_w)}{E^* I}, \qquad E^* = \frac{E}{1 - \nu^2}, \tag{1} $$
#
# and the tip turns by $\theta = \kappa L$ over the length L of the chambers, as long as nothing is
# in its way. (1) holds for small strains, and leaves out that ribs stiffen the walls.

# +
import os

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import plotting

full = 16
num_steps = min(int(os.environ.get("NTS_DEMO_STEPS", str(full))), full)  # The tests shorten it.
E, nu, largest = 5e5, 0.45, 4e4  # Pa, -, Pa
lower, h, upper, rib, chamber, number = 0.004, 0.008, 0.002, 0.001, 0.004, 20  # m, and of chambers
height, L = lower + h + upper, number * (rib + chamber)  # m
length = L + 0.005  # m, with the tip


def build(model):
    """Add the finger, a rectangle without its chambers."""
    occ = model.occ
    finger = occ.addRectangle(0, 0, 0, length, height)
    starts = [rib + i * (rib + chamber) for i in range(number)]
    holes = [(2, occ.addRectangle(x, lower, 0, chamber, h)) for x in starts]
    occ.cut([(2, finger)], holes)
    occ.synchronize()
    model.addPhysicalGroup(2, [surface for _, surface in model.getEntities(2)], name="finger")
    model.mesh.setSize(model.getEntities(0), rib)
    model.mesh.generate(2)


mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))  # triangles of degree 1 would lock
finger = nts.Body(V, cells, tag["finger"], nts.NeoHookean(E=E, nu=nu, rho=1.1e3))
# -

# ## Chambers, object and support
#
# Surfaces are chosen by positions. Time only measures the pressure, from 0 to 1.


# +
def is_chamber(x):
    """Whether points are on the wall of a chamber."""
    across = (x[1] > lower - 1e-9) & (x[1] < lower + h + 1e-9)
    return across & (x[0] > rib - 1e-9) & (x[0] < L + 1e-9)


walls = nts.boundary_of(finger, where=is_chamber)
below = nts.boundary_of(finger, where=lambda x: x[1] < 1e-9)
pressure = nts.Pressure(walls, lambda t: largest * t)
object_ = nts.RigidSphere((0.078, -0.03), 0.015, name="object")
left = fem.locate_dofs_geometrical(V, lambda x: x[0] < 1e-9)
held = fem.dirichletbc(np.zeros(2), left, V)
pairs = [nts.ContactPair(below, object_)]
stepper = nts.QuasiStatic([finger], pairs, dt=1 / full, bcs=[held], loads=[pressure])
tip = nts.boundary_of(finger, where=lambda x: x[0] > length - 1e-9)


def rotation():
    """Rotation of the line between both corners of the tip [rad]."""
    x = stepper.x[tip.nodes, :2]
    X = x - stepper.u.x.array.reshape(-1, 2)[tip.nodes]
    corners = [x[np.abs(X[:, 1] - y) < 1e-9] for y in (0.0, height)]
    sums = np.array([[*corner.sum(axis=0), len(corner)] for corner in corners])
    sums = mesh.comm.allreduce(sums)
    across = np.diff(sums[:, :2] / sums[:, 2:], axis=0)[0]
    return np.arctan2(*across)


# -

# ## Run

# +
theta = [0.0]
with nts.Recorder("finger", stepper) as record:
    for step in stepper.run(until=num_steps / full, control=nts.StepControl()):
        record.write(step)
        theta.append(rotation())
# -

# ## Pictures
#
# At the end the finger lies on the object.

plotting.snapshot(stepper, "finger.png")

# The tip turns as (1) predicts in the beginning, then faster, since the chambers grow. The object
# slows it down.

# +
if mesh.comm.rank == 0:
    walls_of = ((lower, lower / 2), (upper, height - upper / 2))  # m, thickness and middle
    y_w = sum(t * y for t, y in walls_of) / (lower + upper)
    second = sum(t**3 / 12 + t * (y - y_w) ** 2 for t, y in walls_of)  # m^3, I of one metre
    table = np.genfromtxt("finger.csv", delimiter=",", names=True)
    p, theta = largest * table["time"], np.array(theta)
    theory = p * h * (lower + h / 2 - y_w) * (1 - nu**2) / (E * second) * L
    force = -table["obstacle_object_force_y"]
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), dpi=160, layout="constrained")
    axes[0].plot(1e-3 * p, np.degrees(theta), ".-", label="computed")
    axes[0].plot(1e-3 * p, np.degrees(theory), "k--", label="beam theory (1)")
    axes[0].set(xlabel="pressure [kPa]", ylabel="rotation of the tip [degrees]")
    axes[0].legend()
    axes[1].plot(1e-3 * p, force, ".-")
    axes[1].set(xlabel="pressure [kPa]", ylabel="downward force on the object [N/m]")
    for each in axes:
        each.grid(alpha=0.3)
    figure.savefig("finger_bending.png")
# -

# ## Checks
#
# Up to 7.5 kPa the rotation is that of (1) within 5 %. The pressure in closed chambers has no
# resultant, so that the support carries the force on the object.

# +
if mesh.comm.rank == 0:
    small = (p > 0) & (p < 8e3)
    assert np.abs(theta / np.where(small, theory, 1.0) - 1)[small].max() < 0.05
    assert force[small].max() == 0 and force[-1] > 1.0
    for axis in "xy":
        difference = table[f"support_1_force_{axis}"] - table[f"obstacle_object_force_{axis}"]
        assert np.abs(difference).max() < 1e-6 * force.max()
    print(f"rotation {theta[3]:.4f} at {p[3]:.0f} Pa (beam theory {theory[3]:.4f})")
    print(f"force on the object {force[-1]:.2f} N/m at {p[-1]:.0f} Pa")
