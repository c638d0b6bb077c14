"""A part from one's own gmsh script: fused, filleted, fragmented."""

# # Your own geometry
#
# A plastic bracket with a rubber pad under its foot drops onto the floor.
#
# You will learn
#
# - how to turn a model of gmsh's CAD kernel into bodies,
# - that parts of a fragmented solid share nodes and need no contact,
# - how to let any body touch any other: `all_pairs`.
#
# ## Problem
#
# Bracket: foot 100 x 50 x 10 mm, upright 10 x 50 x 70 mm, fillet of 15 mm
# between them, E = 2 GPa, $\nu$ = 0.35, $\rho$ = 1200 kg/m³. Pad: 100 x 50 x 10 mm,
# E = 5 MPa, $\nu$ = 0.4, $\rho$ = 1000 kg/m³. Velocity 1 m/s downwards.
#
# ## Equations
#
# In each step, the momentum changes by the impulse of the floor's contact
# force. Springs give this force, and their energy is a part of the total one:
#
# $$ p_{n+1} - p_n = \Delta t \, F_{n+1/2}, \qquad E_{n+1} = E_n. \tag{1} $$

# +
import os

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import plotting

dt, full = 2e-4, 60  # s
num_steps = int(os.environ.get("NTS_DEMO_STEPS", str(full)))  # The tests shorten it.
# -

# ## Geometry
#
# This is plain gmsh; nothing here belongs to this package. A bounding box finds
# the curve of the fillet, and `fragment` makes bracket and pad share nodes.


# +
def build(model):
    """Draw the bracket and the pad, name them, make tetrahedra."""
    occ = model.occ
    foot = occ.addBox(0, 0, 0, 0.1, 0.05, 0.01)
    upright = occ.addBox(0, 0, 0.01, 0.01, 0.05, 0.07)
    (bracket,), _ = occ.fuse([(3, foot)], [(3, upright)])
    occ.synchronize()
    corner = model.getEntitiesInBoundingBox(0.009, -0.001, 0.009, 0.011, 0.051, 0.011, 1)
    bracket = occ.fillet([bracket[1]], [tag for _, tag in corner], [0.015])[0]
    pad = occ.addBox(0, 0, -0.01, 0.1, 0.05, 0.01)
    _, (upper, lower) = occ.fragment([bracket], [(3, pad)])
    occ.synchronize()
    model.addPhysicalGroup(3, [tag for _, tag in upper], name="bracket")
    model.addPhysicalGroup(3, [tag for _, tag in lower], name="pad")
    model.mesh.setSize(model.getEntities(0), 0.008)
    model.mesh.generate(3)


mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
bracket = nts.Body(V, cells, tag["bracket"], nts.NeoHookean(E=2e9, nu=0.35, rho=1200.0))
pad = nts.Body(V, cells, tag["pad"], nts.NeoHookean(E=5e6, nu=0.4, rho=1000.0))
# -

# ## Contact and run
#
# Bracket and pad share nodes, so `all_pairs` makes a single pair: both of them
# with the floor, which is 0.1 mm below.

# +
floor = nts.RigidPlane((0, 0, -0.0101), (0, 0, 1))
pairs = nts.all_pairs([bracket, pad], obstacles=[floor])
assert len(pairs) == 1
stepper = nts.EnergyMomentum([bracket, pad], pairs, dt=dt)
for body in (bracket, pad):
    stepper.set_velocity(body, (0, 0, -1.0))
diagnostics = nts.Diagnostics(stepper)
before, impulse = diagnostics.balance(), np.zeros(3)
with nts.Recorder("own_geometry", stepper, every=5) as record:
    for step in stepper.run(until=num_steps * dt):
        record.write(step)
        impulse += dt * diagnostics.contact_force()
        if step.step == min(12, num_steps):
            picture = plotting.snapshot(stepper, "own_geometry.png", camera=(1, -1.1, 0.5))
after = diagnostics.balance()
# -

# The pictures show the bracket after the impact, and the energies of the run.

picture

plotting.energies("own_geometry.csv", "own_geometry_energies.png")

# ## Checks
#
# Equations (1) hold to round-off. The mass is that of foot, upright and fillet
# (of which the cross-section is $r^2 (1 - \pi/4)$), within the error of the
# fillet's facets. At the end the bracket moves up.

# +
one = fem.form(fem.Constant(mesh, 1.0) * ufl.dx(domain=mesh))
volume = mesh.comm.allreduce(fem.assemble_scalar(one))
exact = 2 * 0.1 * 0.05 * 0.01 + 0.01 * 0.05 * 0.07 + 0.015**2 * (1 - np.pi / 4) * 0.05
assert abs(volume / exact - 1) < 2e-3, volume
change = after.linear_momentum - before.linear_momentum
assert np.allclose(change, impulse, rtol=0, atol=1e-10 * abs(before.linear_momentum[2]))
assert abs(after.total_energy / before.total_energy - 1) < 1e-10
if num_steps == full:
    assert after.linear_momentum[2] > 0.5 * abs(before.linear_momentum[2])
if mesh.comm.rank == 0:
    print(record.summary())
