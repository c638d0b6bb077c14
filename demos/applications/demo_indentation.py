"""Indentation of soft tissue: force over depth, and Young's modulus from a fit."""

# # Indentation of soft tissue
#
# A rigid ball is pressed into a block of soft tissue. Young's modulus is then fitted to the curve
# of force over depth, as in an experiment, and compared with that of the block.
#
# You will learn
#
# - how to indent a body with a rigid sphere whose motion is prescribed,
# - how to get a force-displacement curve, and how to fit a modulus to it,
# - how to refine a block around a small contact.
#
# ## Problem
#
# The scene is a body of revolution: x is the radius, y the axis. The indenter has the radius
# R = 5 mm and moves 0.5 mm down. The tissue is nearly incompressible (neo-Hooke, E = 10 kPa,
# $\nu$ = 0.49). The block has a radius and a height of 100 mm, so that it is much
# larger than the contact. It is fixed at its bottom. There is no friction.
#
# ## Equations
#
# By Hertz, with the depth d and $E^* = E / (1 - \nu^2)$, the force is
#
# $$ F = \tfrac{4}{3} E^* \sqrt{R}\, d^{3/2}. \tag{1} $$
#
# It is linear in E, so that least squares over all measured points $(d_i, F_i)$ give
#
# $$ E = \frac{3 (1 - \nu^2)}{4 \sqrt{R}} \frac{\sum F_i d_i^{3/2}}{\sum d_i^3}. \tag{2} $$

# +
import os

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

full = 20
num_steps = min(int(os.environ.get("NTS_DEMO_STEPS", str(full))), full)  # The tests shorten it.
radius, depth, size = 0.005, 0.0005, 0.1  # m
E, nu = 1e4, 0.49  # Pa, -


def build(model):
    """Add half of the cross-section of the block, with its top at y = 0."""
    parts.add_rectangle(model, "tissue", corner=(0, -1), size=(1, 1), cells=(48, 48))


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
# -

# ## Mesh
#
# The unit square becomes the block. Cells near the contact are 0.1 mm wide, those far away grow
# in proportion to the distance.

# +
growth = 6.0
x = mesh.geometry.x
x[:] = size * np.sign(x) * np.expm1(growth * np.abs(x)) / np.expm1(growth)
nts.axisymmetric(mesh)
V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
tissue = nts.Body(V, cells, tag["tissue"], nts.NeoHookean(E=E, nu=nu, rho=1e3))
bottom = fem.locate_dofs_topological(V, 1, facets.find(tag["tissue_bottom"]))
held = fem.dirichletbc(np.zeros(2), bottom, V)
# -

# ## Indenter
#
# Time only measures the load, from 0 to 1. The table has a column of the depth, and one of the
# force of Hertz to compare with.

# +
motion = nts.Motion(translation=lambda t: (0.0, -depth * t))
indenter = nts.RigidSphere((0.0, radius), radius, name="indenter").moving(motion)
contact = nts.ContactPair(nts.Surface(V, facets, tag["tissue_top"]), indenter)
stepper = nts.QuasiStatic([tissue], [contact], dt=1 / full, bcs=[held])
stiffness = 4 / 3 * E / (1 - nu**2) * np.sqrt(radius)  # N/m^1.5
columns = {
    "depth": lambda s: depth * s.t,
    "force_of_Hertz": lambda s: stiffness * (depth * s.t) ** 1.5,
}
with nts.Recorder("indentation", stepper, own_columns=columns) as record:
    for step in stepper.run(until=num_steps / full):
        record.write(step)
# -

# ## Pictures
#
# This is the stress around the contact, seen from behind: the axis is on the right.

middle = np.array((0.003, -0.0005, 0.0))  # m
camera = [middle - (0, 0, 0.016), middle, (0, 1, 0)]
plotting.snapshot(stepper, "indentation.png", camera=camera)

# The computed force follows that of Hertz.

forces = ["obstacle_indenter_force_y", "force_of_Hertz"]
plotting.force_displacement("indentation.csv", "depth", forces, "indentation_force.png")

# ## Checks
#
# From the first step on, each force is that of (1) within 2 %, and the fit (2) returns Young's
# modulus of the block within 2 %. Both errors are those of the mesh and of the theory, which
# assumes small strains and a parabolic indenter.

# +
if mesh.comm.rank == 0:
    table = np.genfromtxt("indentation.csv", delimiter=",", names=True)[1:]  # without the start
    d, F = table["depth"], table["obstacle_indenter_force_y"]
    assert np.abs(F / table["force_of_Hertz"] - 1).max() < 0.02
    fitted = 3 * (1 - nu**2) / (4 * np.sqrt(radius)) * (F @ d**1.5) / (d**3).sum()
    print(f"fitted E = {fitted:.0f} Pa (block {E:.0f} Pa)")
    assert abs(fitted / E - 1) < 0.02
