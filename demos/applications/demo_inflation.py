"""Inflation of a soft tube in a square channel, as in a pneumatic actuator."""

# # Inflation of a pneumatic tube
#
# Air inflates a tube of silicone rubber until it touches the walls of a square channel, and
# presses on them.
#
# You will learn
#
# - how to inflate a body by an internal pressure that follows its surface,
# - how to find the pressure at which an actuator touches its surroundings,
# - how contact pressure and internal pressure are related.
#
# ## Problem
#
# The scene is a slice of a tube in plane strain, without inertia. In the beginning its radii are
# A = 8 mm inside and B = 10 mm outside. The rubber is nearly incompressible (neo-Hooke,
# E = 300 kPa, $\nu$ = 0.495). The walls of the channel are rigid, without friction, and
# c = 12 mm away from the axis.
#
# ## Equations
#
# An incompressible tube with the shear modulus G and the present radii a, b, where
# $b^2 - a^2 = B^2 - A^2$, is in equilibrium with the internal pressure
#
# $$ p = G \left[ \ln \frac{a B}{A b}
#    + \frac{1}{2} \left( \frac{B^2}{b^2} - \frac{A^2}{a^2} \right) \right], \tag{1} $$
#
# until b = c. Later the parts of the tube on the walls are flat, so that tension in the tube has
# no component across it. There the contact pressure is p.

# +
import os

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

full = 20
num_steps = min(int(os.environ.get("NTS_DEMO_STEPS", str(full))), full)  # The tests shorten it.
A, B, c, width = 0.008, 0.01, 0.012, 0.0005  # m
E, nu, largest = 3e5, 0.495, 3e4  # Pa, -, Pa


def build(model):
    """Add the tube, with its axis along z."""
    shape = {"inner_radius": A, "outer_radius": B, "width": width}
    parts.add_ring(model, "tube", centre=(0, 0, 0), cells=(96, 4, 1), **shape)


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
tube = nts.Body(V, cells, tag["tube"], nts.NeoHookean(E=E, nu=nu, rho=1e3))
inner, outer = (nts.Surface(V, facets, tag[f"tube_{side}"]) for side in ("inner", "outer"))
# -

# ## Walls, supports and load
#
# Nodes in the planes of symmetry stay there, and all nodes stay in their plane z. Time only
# measures the load, from 0 to 1.


# +
def hold(axis, where):
    """Hold a component of the displacement."""
    W = V.sub(axis)
    dofs, _ = fem.locate_dofs_geometrical((W, W.collapse()[0]), where)
    return fem.dirichletbc(np.float64(0), dofs, W)


bcs = [hold(axis, lambda x, axis=axis: np.abs(x[axis]) < 1e-9) for axis in (0, 1)]
bcs.append(hold(2, lambda x: x[2] > -1.0))
names, outwards = ("left", "right", "bottom", "top"), [(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)]
directions = dict(zip(names, np.array(outwards), strict=True))
walls = [nts.RigidPlane(c * out, -out, name=name) for name, out in directions.items()]
pairs = [nts.ContactPair(outer, wall) for wall in walls]
load = nts.Pressure(inner, lambda t: largest * t)
stepper = nts.QuasiStatic([tube], pairs, dt=1 / full, bcs=bcs, loads=[load])
# -

# ## Run
#
# The curve has the pressure, and the distance of the outer surface from the axis: along x, where
# walls may touch it, and its largest value, along the diagonals.

# +
curve = [(0.0, B, B)]  # Pa, m, m
with nts.Recorder("inflation", stepper, every=4) as record:
    for step in stepper.run(until=num_steps / full, control=nts.StepControl()):
        record.write(step)
        x, y, _ = np.abs(stepper.x[outer.nodes]).T
        along = [mesh.comm.allreduce(v.max(initial=0.0), MPI.MAX) for v in (x, np.hypot(x, y))]
        curve.append((largest * step.t, *along))
p, b, diagonal = np.array(curve).T
# -

# ## Pictures
#
# The tube fills the channel, but for the corners.

plotting.snapshot(stepper, "inflation.png", camera=(0, 0, 1))

# Until it touches the walls, it is as wide as (1) has it.


# +
def pressure(b):
    """Internal pressure (1) of a tube with the outer radius b [Pa]."""
    a = np.sqrt(b**2 - B**2 + A**2)
    G = E / (2 * (1 + nu))
    return G * (np.log(a * B / (A * b)) + ((B / b) ** 2 - (A / a) ** 2) / 2)


if mesh.comm.rank == 0:
    figure, axes = plt.subplots(figsize=(6.4, 4), dpi=250, layout="constrained")
    axes.plot(1e-3 * p, 1e3 * diagonal, ".-", label="along the diagonal")
    axes.plot(1e-3 * p, 1e3 * b, ".-", label="along x")
    radii = np.linspace(B, c, 100)
    axes.plot(1e-3 * pressure(radii), 1e3 * radii, "k--", label="free tube")
    axes.set(xlabel="internal pressure [kPa]", ylabel="distance from the axis [mm]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig("inflation_radius.png")
# -

# ## Checks
#
# The pressures of the free tube are those of (1) within 2 %, and it touches the walls at the
# pressure of (1) for b = c. In the middle of a wall the contact pressure, divided by the stretch
# of the tube because it refers to the reference area, is the internal pressure within 3 %.

# +
is_free = b < c * (1 - 1e-6)
assert np.abs(p[is_free][1:] / pressure(b[is_free][1:]) - 1).max() < 0.02
if num_steps == full:
    before, after = p[is_free][-1], p[~is_free][0]
    assert before < pressure(c) < after
    contact = stepper.contacts[list(directions).index("right")]
    y = stepper.x[outer.nodes, 1]
    Y = y - stepper.u.x.array.reshape(-1, 3)[outer.nodes, 1]
    middle = (contact.pressure > 0) & (np.abs(Y) < 0.1 * B) & (np.abs(Y) > 0.01 * B)
    sums = np.array([contact.pressure[middle].sum(), (y / np.where(middle, Y, 1.0))[middle].sum()])
    on_wall, stretch = mesh.comm.allreduce(sums) / mesh.comm.allreduce(np.count_nonzero(middle))
    assert abs(on_wall / stretch / largest - 1) < 0.03
    if mesh.comm.rank == 0:
        print(f"touches between {before:.0f} and {after:.0f} Pa (theory {pressure(c):.0f} Pa)")
        print(f"pressure on the wall {on_wall / stretch:.0f} Pa (internal {largest:.0f} Pa)")
