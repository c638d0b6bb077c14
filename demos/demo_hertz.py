"""Hertz: a ball pressed on a plane, load stepping without inertia."""

# # Hertz contact
#
# Half a ball is pressed onto a rigid plane. By symmetry, a quarter of this half is enough.
#
# You will learn
#
# - how to apply a load in steps without inertia (`QuasiStatic`),
# - how to use symmetry, and how to move a support,
# - how to get the contact pressure at nodes.
#
# ## Problem
#
# The ball has R = 1 m, E = 1 Pa and $\nu$ = 0.3; its middle plane moves down
# by d = 1e-4 m. The mesh has six tetrahedra across the radius of contact.
#
# ## Equations
#
# With $1/E^* = (1 - \nu^2)/E$ and the force $F$, Hertz's solution is (Johnson,
# Contact Mechanics, ch. 4)
#
# $$ a = \left( \frac{3 F R}{4 E^*} \right)^{1/3}, \qquad
#    p = p_0 \sqrt{1 - r^2/a^2}, \qquad
#    p_0 = \left( \frac{6 F E^{*2}}{\pi^3 R^2} \right)^{1/3}. \tag{1} $$
#
# Moments of the nodal forces f give a and $p_0$ without locating the edge of
# contact: $\sum f r^2 = \tfrac{2}{5} F a^2$, $\sum f p = \tfrac{3}{4} F p_0$.

# +
import os

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem
from dolfinx.mesh import locate_entities_boundary

import dolfinx_nts as nts
from dolfinx_nts import plotting

full, depth, E, nu = 4, 1e-4, 1.0, 0.3  # -, m, Pa, -
num_steps = min(int(os.environ.get("NTS_DEMO_STEPS", str(full))), full)
E_star, zone = E / (1 - nu**2), 1.3 * np.sqrt(depth)  # Pa, m


def build(model):
    """Add an octant of the ball, its pole off the contact; x, y, z < R."""
    import gmsh  # the first rank alone needs it

    occ = model.occ
    ball = occ.addSphere(0, 0, 0, 1, angle1=0, angle2=np.pi / 2, angle3=np.pi / 2)
    occ.rotate([(3, ball)], 0, 0, 0, 1, 1, 1, 2 * np.pi / 3)
    occ.mirror([(3, ball)], 0, 0, 1, 0)
    occ.translate([(3, ball)], 0, 0, 1)
    occ.synchronize()
    model.addPhysicalGroup(3, [ball], name="ball")
    away = f"Max(0, Sqrt(x*x + y*y + z*z) - {zone})"
    size = model.mesh.field.add("MathEval")
    model.mesh.field.setString(size, "F", f"Min(0.2, {np.sqrt(depth) / 6} + 0.3 * {away})")
    model.mesh.field.setAsBackgroundMesh(size)
    for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
        gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)
    model.mesh.generate(3)


mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
ball = nts.Body(V, cells, tag["ball"], nts.SaintVenantKirchhoff(E, nu, 1.0))
# -

# ## Symmetry, support and contact
#
# The surfaces are found by their coordinates: the planes of symmetry, the
# middle plane, and the rest.

# +
tiny, approach = 1e-9, fem.Constant(mesh, 0.0)


def hold(axis, place, value):
    """Give a component of the displacement in a plane."""
    plane = locate_entities_boundary(mesh, 2, lambda x: np.abs(x[axis] - place) < tiny)
    return fem.dirichletbc(value, fem.locate_dofs_topological(V.sub(axis), 2, plane), V.sub(axis))


def update(t):
    """Move the middle plane."""
    approach.value = -depth * t


bcs = [hold(0, 0.0, np.float64(0)), hold(1, 0.0, np.float64(0)), hold(2, 1.0, approach)]
surface = nts.boundary_of(ball, where=lambda x: x[0] ** 2 + x[1] ** 2 + (x[2] - 1) ** 2 > 1 - tiny)
pair = nts.ContactPair(surface, nts.RigidPlane((0, 0, 0), (0, 0, 1)))

stepper = nts.QuasiStatic([ball], [pair], dt=1 / full, bcs=bcs, update=update)
# Two columns of our own in the table hold the displacement and the theoretical force on the
# quarter.
columns = {
    "approach": lambda s: depth * s.t,
    "force_of_Hertz": lambda s: E_star / 3 * (depth * s.t) ** 1.5,
}
with nts.Recorder("hertz", stepper, own_columns=columns) as record:
    for step in stepper.run(until=num_steps / full):
        record.write(step)
# -

# ## Checks
#
# The radius of contact and the largest pressure are those of (1) for the
# computed force, within 2 and 4 %.

# +
f, p = -pair.history.lambda_N, pair.pressure
r = np.hypot(*stepper.x[surface.nodes, :2].T)
total, second, square = mesh.comm.allreduce(np.array([f.sum(), f @ r**2, f @ p]))
force = 4 * total
a = (0.75 * force / E_star) ** (1 / 3)
p_0 = (6 * force * E_star**2 / np.pi**3) ** (1 / 3)
radius, pressure = np.sqrt(2.5 * second / total), 4 / 3 * square / total
if mesh.comm.rank == 0:
    print(f"radius {radius:.5f} m (Hertz {a:.5f} m), pressure {pressure:.5f} Pa ({p_0:.5f} Pa)")
assert abs(radius / a - 1) < 0.02
assert abs(pressure / p_0 - 1) < 0.04
# -

# ## Pictures
#
# The pictures show the force over the displacement, and the pressure over the radius.

plotting.force_displacement(
    "hertz.csv", "approach", ["contact_force_z", "force_of_Hertz"], "hertz_force.png"
)

# +
points = mesh.comm.gather(np.column_stack([r, p]))
if mesh.comm.rank == 0:
    figure, axes = plt.subplots(figsize=(6.4, 4), dpi=250, layout="constrained")
    axes.plot(*(np.concatenate(points).T / [[a], [p_0]]), ".", label="nodes")
    line = np.linspace(0, 1, 200)
    axes.plot(line, np.sqrt(1 - line**2), label="Hertz")
    axes.set(xlabel="$r / a$", ylabel="$p / p_0$", xlim=(0, 1.5))
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig("hertz_pressure.png")
