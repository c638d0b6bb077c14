"""A snap-fit: insertion force of a cantilever hook over its path."""

# # A snap-fit
#
# A hook at the end of a beam is pushed over a round pin, and snaps in behind it.
#
# You will learn
#
# - how to get the insertion force over the path of a prescribed motion,
# - that edges may slide over a round obstacle, and leave it,
# - which part of the work is dissipated by friction.
#
# ## Problem
#
# The scene is in plane strain and without inertia. The beam (E = 2 GPa, $\nu$ = 0.4) is fixed at
# its left end. It has the thickness h = 2 mm, and the length L = 30 mm up to the front of the
# hook, which is H = 1 mm high and inclined by $\alpha$ = 30°. The pin is rigid, has the radius
# r = 2 mm, and moves along the beam; $\mu$ = 0.2. Forces are those of one metre of thickness.
#
# ## Equations
#
# The beam has the modulus $E / (1 - \nu^2)$. To bend its end by w takes the force P, and to push
# the pin along the front takes the insertion force F, as design guides have it:
#
# $$ P = \frac{E h^3 w}{4 (1 - \nu^2) L^3}, \qquad
#    F = P \tan(\alpha + \theta + \arctan \mu), \qquad \theta = \frac{3 w}{2 L}, \tag{1} $$
#
# where $\theta$ is the rotation of the end. F grows until the pin reaches the edge below the
# front. As the pin is round, this happens before the hook is lifted by H, at
#
# $$ w = H - r\, (1 - \cos(\alpha + \theta)). \tag{2} $$

# +
import os

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import plotting

full = 60
num_steps = min(int(os.environ.get("NTS_DEMO_STEPS", str(full))), full)  # The tests shorten it.
E, nu, mu, alpha = 2e9, 0.4, 0.2, np.radians(30)  # Pa, -, -, rad
L, h, H, r, flat = 0.03, 0.002, 0.001, 0.002, 0.0005  # m
end = L + H / np.tan(alpha)  # m, of the beam
clearance = 2e-5  # m, between pin and beam


def build(model):
    """Add beam and hook; cells are small below the hook."""
    coarse, fine = h / 4, 1e-4  # m
    corners = {
        **{(0, 0): coarse, (L - flat, 0): fine, (L - flat, -H): fine, (L, -H): fine},
        **{(end, 0): fine, (end, h): coarse, (0, h): coarse},
    }
    points = [model.occ.addPoint(x, y, 0, size) for (x, y), size in corners.items()]
    ends = zip(points, points[1:] + points[:1], strict=True)
    lines = [model.occ.addLine(first, second) for first, second in ends]
    hook = model.occ.addPlaneSurface([model.occ.addCurveLoop(lines)])
    model.occ.synchronize()
    model.addPhysicalGroup(2, [hook], name="hook")
    model.mesh.generate(2)


mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))  # triangles of degree 1 would lock
hook = nts.Body(V, cells, tag["hook"], nts.SaintVenantKirchhoff(E=E, nu=nu, rho=1e3))
left = fem.locate_dofs_geometrical(V, lambda x: x[0] < 1e-9)
held = fem.dirichletbc(np.zeros(2), left, V)
below = nts.boundary_of(hook, where=lambda x: (x[1] < h / 2) & (x[0] > L - 2 * H))
# -

# ## Insertion
#
# Time only measures the path, from 0 to 1.

# +
travel = end - L + flat + 0.0035  # m
motion = nts.Motion(translation=lambda t: (-travel * t, 0.0))
pin = nts.RigidSphere((end + 0.001, -r - clearance), r, name="pin").moving(motion)
contact = nts.ContactPair(below, pin, friction=nts.Coulomb(mu))
stepper = nts.QuasiStatic([hook], [contact], dt=1 / full, bcs=[held])
columns = {"path": lambda s: travel * s.t}
with nts.Recorder("snap_fit", stepper, own_columns=columns) as record:
    for step in stepper.run(until=num_steps / full, control=nts.StepControl()):
        record.write(step)
        if step.step == min(24, num_steps):
            picture = plotting.snapshot(stepper, "snap_fit.png")
# -

# ## Pictures
#
# The edge of the hook slides over the pin.

picture

# The insertion force is largest when the pin reaches this edge. Then the hook slides over the
# pin, at last by itself: the force pulls the pin in.

plotting.force_displacement("snap_fit.csv", "path", "obstacle_pin_force_x", "snap_fit_force.png")

# ## Checks
#
# The largest force is that of (1) and (2) within 5 %. At the end the hook is free again, and
# friction has dissipated the work of the insertion, within 2 %.

# +
if mesh.comm.rank == 0:
    w = H
    for _ in range(20):
        slope = alpha + 1.5 * w / L
        w = H - r * (1 - np.cos(slope))
    F = E * h**3 * w / (4 * (1 - nu**2) * L**3) * np.tan(slope + np.arctan(mu))
    table = np.genfromtxt("snap_fit.csv", delimiter=",", names=True)
    largest, last = table["obstacle_pin_force_x"].max(), table[-1]
    if num_steps == full:
        assert abs(largest / F - 1) < 0.05
        assert last["active_nodes"] == 0 and last["strain_energy"] < 1e-9
        assert abs(last["friction_dissipation"] / last["external_work"] - 1) < 0.02
        print(f"largest insertion force {largest:.1f} N/m (design guides {F:.1f} N/m)")
