"""A roller is pressed into a block, and dragged along or rolled."""

# # Ironing and rolling
#
# A rigid roller presses a dent into a rubber block and moves along it. Without
# rotation it irons the block; with the right rotation it rolls.
#
# You will learn
#
# - how to prescribe the motion of an obstacle,
# - how to get the force on it,
# - how friction acts on a tool that slides or rolls.
#
# ## Problem
#
# A cylinder of radius R = 10 mm moves 2 mm down into the top of a rubber block
# (60 mm x 10 mm x 15 mm, E = 1 MPa), whose bottom is fixed, and then 30 mm along it;
# $\mu$ = 0.3. The motion is slow, so inertia is neglected. Steps in which nodes begin to slide
# may fail, and are then halved.
#
# ## Equations
#
# At the time t, a point X of the tool is at
#
# $$ x(t) = c + d(t) + R(t) (X - c). \tag{1} $$
#
# with the displacement d, the rotation R(t) and the centre c. If the roller does not rotate, all
# nodes slide, and the drag is $H \approx \mu N$. If it rotates by the angle s/R while it moves by
# s, hardly anything slides, and there is almost no drag.

# +
import os

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

radius, depth, way, mu = 0.01, 0.002, 0.03, 0.3  # m, m, m, -
pressing, full = 8, 40
num_steps = int(os.environ.get("NTS_DEMO_STEPS", str(full)))  # The tests shorten it.
axis = (-0.015, 0.0, radius)  # m, where the roller starts


def build(model):
    """Add the block, with its top at z = 0."""
    box = {"corner": (-0.03, -0.005, -0.015), "size": (0.06, 0.01, 0.015)}
    parts.add_box(model, "block", **box, cells=(40, 1, 8))


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
block = nts.Body(V, cells, tag["block"], nts.NeoHookean(E=1e6, nu=0.4, rho=1e3))
bottom = fem.locate_dofs_topological(V, 2, facets.find(tag["block_bottom"]))
held = fem.dirichletbc(np.zeros(3), bottom, V)
top = nts.Surface(V, facets, tag["block_top"])
# -

# ## The motion of the tool
#
# Without inertia, time only counts the steps: one second is one step. The
# displacement and the rotation vector are functions of time.


# +
def place(t):
    """Depth and distance of the axis [m]."""
    return min(t / pressing, 1.0) * depth, max(t - pressing, 0.0) / (full - pressing) * way


def displacement(t):
    """Displacement of the axis [m]."""
    down, along = place(t)
    return (along, 0.0, -down)


def rolling(t):
    """Rotation vector of a roller that rolls on its lowest line [rad]."""
    return (0.0, place(t)[1] / radius, 0.0)


def run(name, rotation=None):
    """Press the roller and move it along; return the stepper, times [s] and forces on it [N]."""
    motion = nts.Motion(displacement, rotation, centre=axis)
    roller = nts.RigidCylinder(point=axis, axis=(0, 1, 0), radius=radius).moving(motion)
    contact = nts.ContactPair(top, roller, friction=nts.Coulomb(mu))
    stepper = nts.QuasiStatic([block], [contact], dt=1.0, bcs=[held])
    diagnostics = nts.Diagnostics(stepper)
    times, forces = [], []
    with nts.Recorder(name, stepper, every=8) as record:
        for step in stepper.run(until=num_steps, control=nts.StepControl()):
            record.write(step)
            force = diagnostics.obstacles()["moving_rigid_cylinder"].force
            times.append(step.t)
            forces.append(force)
    return stepper, np.array(times), np.array(forces)


ironed, iron_times, iron_force = run("ironing")
rolled, roll_times, roll_force = run("ironing_rolled", rolling)
# -

# ## Pictures
#
# The tool is drawn at its final position.

plotting.snapshot(ironed, "ironing.png")

# +
if mesh.comm.rank == 0:
    figure, axes = plt.subplots(figsize=(6.4, 4), dpi=250, layout="constrained")
    for name, t, force in (("iron", iron_times, iron_force), ("roll", roll_times, roll_force)):
        axes.plot(t, force[:, 2], label=f"{name}: press N")
        axes.plot(t, -force[:, 0], "--", label=f"{name}: drag H")
    axes.set(xlabel="step", ylabel="force on the tool [N]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig("ironing_force.png")
# -

# ## Checks
#
# Drag over press is the coefficient of friction for the iron, within 5 % because the surface of
# the dent is inclined. For the roll it is at most a tenth of that.

# +
assert min(iron_force[-1, 2], roll_force[-1, 2]) > 0
if num_steps == full:
    iron_drag, roll_drag = (
        -(force[t > full / 2] / force[t > full / 2, 2:]).mean(axis=0)[0]
        for t, force in ((iron_times, iron_force), (roll_times, roll_force))
    )
    if mesh.comm.rank == 0:
        print(f"drag over press: iron {iron_drag:.3f}, roll {roll_drag:.3f} (mu = {mu})")
    assert abs(iron_drag / mu - 1) < 0.05 and abs(roll_drag) < 0.1 * mu
