"""A gripper with two fingers grasps a soft ball and lifts it by friction."""

# # A gripper lifts a soft ball
#
# Two fingers grasp a soft ball that lies on a table, and move up. With enough friction they lift
# it; with less they slide along the ball, which stays on the table.
#
# You will learn
#
# - how to press a finger by a force in one direction, and prescribe its motion in another,
# - how to get the grip force between finger and ball, and the force on the table,
# - which coefficient of friction a grasp needs at least.
#
# ## Problem
#
# The ball (neo-Hooke, E = 20 kPa, $\nu$ = 0.45, $\rho$ = 1000 kg/m³) has the radius R = 30 mm.
# The fingers are rigid plates, which are pressed on it by the force N = 1 N each. After the grasp
# they go up by 10 mm, slowly, so that inertia is neglected. The table has no friction.
#
# ## Equations
#
# Each finger carries at most $\mu N$. So the ball with the weight W is lifted if
#
# $$ 2 \mu N \geq W, \qquad \mu \geq \mu_0 = \frac{W}{2 N}. \tag{1} $$
#
# With a smaller coefficient the fingers slide, and the table carries the rest, $W - 2 \mu N$.

# +
import os

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

grasping, full = 4, 9  # steps
num_steps = min(int(os.environ.get("NTS_DEMO_STEPS", str(full))), full)  # The tests shorten it.
radius, gap, height = 0.03, 1e-4, 0.01  # m
grip, rho, g = 1.0, 1e3, 9.81  # N, kg/m^3, m/s^2


def build(model):
    """Add the ball, with its lowest point at z = 0, and a finger on each side."""
    ball = {"centre": (0, 0, radius), "radius": radius, "cells_per_edge": 6, "layers": 2}
    parts.add_solid_ball(model, "ball", **ball)
    finger = {"size": (0.008, 0.03, 0.05), "cells": (1, 2, 1)}
    parts.add_box(model, "left", corner=(-radius - gap - 0.008, -0.015, 0.005), **finger)
    parts.add_box(model, "right", corner=(radius + gap, -0.015, 0.005), **finger)


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
inside = ufl.Measure("dx", domain=mesh, subdomain_data=cells)(tag["ball"])
volume = mesh.comm.allreduce(fem.assemble_scalar(fem.form(fem.Constant(mesh, 1.0) * inside)))
weight = rho * volume * g  # N, of the ball as it is meshed
least = weight / (2 * grip)  # coefficient of friction
# -

# ## Fingers, table and symmetry
#
# Time only counts the steps. Weight and grip grow during the first four, then the fingers move
# up. Their guide prescribes this motion, and lets them slide along x, where the grip acts. Nodes
# of the ball in its planes of symmetry stay there, so that it does not roll.


# +
def up(t):
    """Displacement of the fingers [m]."""
    return (0.0, 0.0, height * max(t - grasping, 0.0) / (full - grasping))


def hold(axis):
    """Hold the nodes of the ball in a plane of symmetry."""
    dofs, _ = fem.locate_dofs_geometrical(
        (V.sub(axis), V.sub(axis).collapse()[0]),
        lambda x: (np.abs(x[axis]) < 1e-9) & (np.abs(x[0]) < radius + gap / 2),
    )
    return fem.dirichletbc(np.float64(0), dofs, V.sub(axis))


guide = nts.Guide(slides="x", motion=nts.Motion(translation=up))
a = 0.05  # m, half of the table
corners = [(-a, -a, 0.0), (a, -a, 0.0), (a, a, 0.0), (-a, a, 0.0)]
table = nts.RigidSurface(corners, [[0, 1, 2, 3]], outside=(0, 0, 1), name="table")
# -

# ## Two runs
#
# The coefficients of friction are 2 % above and 2 % below $\mu_0$.


# +
def grasp(name, mu):
    """Grasp and lift; return the stepper, and the table by columns on the first rank."""
    ball = nts.Body(V, cells, tag["ball"], nts.NeoHookean(E=2e4, nu=0.45, rho=rho))
    left, right = (nts.RigidBody(V, cells, tag[side], rho, guide) for side in ("left", "right"))
    outer = nts.Surface(V, facets, tag["ball_outer"])
    pads = [nts.Surface(V, facets, tag[pad]) for pad in ("left_right", "right_left")]
    # At nodes: with mortar contact, Newton's method ends at 1e-6 of the grip.
    pairs = [
        nts.ContactPair(outer, pad, friction=nts.Coulomb(mu), method="node-to-segment")
        for pad in pads
    ]
    pairs.append(nts.ContactPair(outer, table))

    def press(finger, sign):
        """Press a finger on the ball."""
        return nts.Force(finger, lambda t: (sign * grip * min(t / grasping, 1.0), 0.0, 0.0))

    gravity = nts.Gravity([ball], lambda t: (0.0, 0.0, -g * min(t / grasping, 1.0)))
    loads = [gravity, press(left, 1), press(right, -1)]
    bodies, bcs = [ball, left, right], [hold(0), hold(1)]
    stepper = nts.QuasiStatic(bodies, pairs, dt=1.0, bcs=bcs, loads=loads)
    columns = {"rise_of_fingers": lambda s: up(s.t)[2]}
    shown = ("between", "obstacles", "supports", "bodies")
    with nts.Recorder(name, stepper, own_columns=columns, columns_of=shown) as record:
        for step in stepper.run(until=num_steps):
            record.write(step)
    if mesh.comm.rank == 0:
        return stepper, np.genfromtxt(f"{name}.csv", delimiter=",", names=True)
    return stepper, None


stepper, lifted = grasp("gripper", 1.02 * least)
slipping, slipped = grasp("gripper_slips", 0.98 * least)
# -

# ## Pictures
#
# Fingers and ball are cut open. With the larger coefficient the ball is in the air.

view = {"camera": [(0.03, -0.2, 0.1), (0.005, 0, 0.03), (0, 0, 1)], "cut": (0, -1, 0)}
plotting.snapshot(stepper, "gripper.png", **view)

# With the smaller one it lies on the table, and the fingers slide along it.

plotting.snapshot(slipping, "gripper_slips.png", **view)

# The ball has sunk on the table under its weight before it rises.

# +
height_columns = "body_ball_centre_of_mass_z", "rise_of_fingers"
if mesh.comm.rank == 0:
    figure, axes = plt.subplots(figsize=(6.4, 4), dpi=250, layout="constrained")
    for rows, label in ((lifted, "1.02"), (slipped, "0.98")):
        ball, fingers = (1e3 * (rows[column] - rows[column][0]) for column in height_columns)
        text = rf"$\mu = {label}\, \mu_0$"
        axes.plot(fingers[grasping:], ball[grasping:], "o-", label=text)
    axes.set(xlabel="rise of the fingers [mm]", ylabel="rise of the ball [mm]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig("gripper_rise.png")
# -

# ## Checks
#
# In both runs the force between each finger and the ball is N, and the planes of symmetry need
# no force. The fingers carry the weight, or $2 \mu N$ if this is less; the table carries the rest.
# In the last two steps the ball rises as the fingers do, or stays where it is.

# +
if mesh.comm.rank == 0 and num_steps == full:
    for rows, mu, is_lifted in ((lifted, 1.02 * least, True), (slipped, 0.98 * least, False)):
        last, zero = rows[-1], 1e-6 * grip
        assert abs(last["between_ball_left_force_x"] - grip) < zero
        assert abs(last["between_ball_right_force_x"] + grip) < zero
        assert abs(last["support_1_force_x"]) + abs(last["support_2_force_y"]) < zero
        carried = last["between_ball_left_force_z"] + last["between_ball_right_force_z"]
        table_force = -last["obstacle_table_force_z"]
        expected = min(weight, 2 * mu * grip)
        assert abs(carried - expected) + abs(table_force - (weight - expected)) < zero
        rises = [rows[column][-1] - rows[column][-3] for column in height_columns]
        assert abs(rises[0] - is_lifted * rises[1]) < 1e-3 * height
        print(f"mu = {mu:.4f}: fingers carry {carried:.4f} N, the table {abs(table_force):.4f} N")
    print(f"weight {weight:.4f} N, least coefficient of friction {least:.4f}")
