"""A guided punch: pressed by a force, by its guide, and by a spring between both."""

# # A punch in its guide
#
# A round rigid punch is pressed into a rubber block. A guide lets it slide up and down only. It is
# driven in three ways: by a force, by the guide itself, and by a spring that hangs on the guide.
#
# You will learn
#
# - how a `Guide` leads a `RigidBody`, and how a `Force` drives the direction that is left free,
# - how to get the reaction of the guide if the displacement is prescribed,
# - how to put a spring between a tool and its guide.
#
# ## Problem
#
# The scene is in plane strain and without inertia. The punch is a disc of radius R = 10 mm. The
# rubber block, 60 mm x 20 mm (neo-Hooke, E = 1 MPa, $\nu$ = 0.45), is fixed at its bottom;
# $\mu$ = 0.3. Per metre of thickness, the largest force is 1.5 kN, and the stiffness of the
# spring is k = 450 kN/m.
#
# ## Equations
#
# The depth d of the punch and its force P are related by one curve, whatever drives the punch.
# With a spring of stiffness k, whose upper end has moved down by s,
#
# $$ P(d) = k\, (s - d). \tag{1} $$

# +
import os

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

full = 12
num_steps = min(int(os.environ.get("NTS_DEMO_STEPS", str(full))), full)  # The tests shorten it.
radius, largest, stiffness = 0.01, 1500.0, 4.5e5  # m, N/m, N/m^2
centre = (0.0, radius + 1e-5)  # m, nearly in touch


def build(model):
    """Add the punch, and below it the block with its top at y = 0."""
    punch = model.occ.addDisk(*centre, 0, radius, radius)
    model.occ.synchronize()
    model.addPhysicalGroup(2, [punch], name="punch")
    model.mesh.setSize(model.getEntities(0), 0.001)
    model.mesh.setRecombine(2, punch)
    model.mesh.generate(2)
    parts.add_rectangle(model, "block", corner=(-0.03, -0.02), size=(0.06, 0.02), cells=(60, 20))


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
block = nts.Body(V, cells, tag["block"], nts.NeoHookean(E=1e6, nu=0.45, rho=1e3))
top = nts.Surface(V, facets, tag["block_top"])
bottom = fem.locate_dofs_topological(V, 1, facets.find(tag["block_bottom"]))
held = fem.dirichletbc(np.zeros(2), bottom, V)
# -

# ## Three drives
#
# Time only measures the load, from 0 to 1. Rigid bodies should be segments, so the punch is.


# +
def press(name, guide, drive=None):
    """Press the punch; returns the stepper, and depths [m] and contact forces [N/m]."""
    punch = nts.RigidBody(V, cells, tag["punch"], rho=7.8e3, guide=guide)
    contact = nts.ContactPair(top, nts.boundary_of(punch), friction=nts.Coulomb(0.3))
    loads = [drive(punch)] if drive else []
    stepper = nts.QuasiStatic([block, punch], [contact], dt=1 / full, bcs=[held], loads=loads)
    diagnostics = nts.Diagnostics(stepper)
    curve = [(0.0, 0.0)]
    with nts.Recorder(name, stepper, columns_of=("supports", "loads")) as record:
        for step in stepper.run(until=num_steps / full):
            record.write(step)
            depth = centre[1] - diagnostics.centre_of_mass(punch)[1]
            curve.append((depth, step.reactions[0].force[1]))
    return stepper, np.array(curve)


def by_force(punch):
    """Let the force on the punch grow with the time."""
    return nts.Force(punch, lambda t: (0.0, -largest * t))


def by_spring(punch):
    """Hang the punch on a spring, whose upper end goes down with the time."""
    inside = ufl.Measure("dx", domain=mesh, subdomain_data=cells)(tag["punch"])
    area = mesh.comm.allreduce(fem.assemble_scalar(fem.form(1.0 * inside)))

    def work(u, eta, t):
        stretch = u - ufl.as_vector([0.0, -2 * largest / stiffness * t])
        return -stiffness / area * ufl.inner(stretch, eta) * inside

    return nts.FormLoad(V, work)


stepper, forced = press("punch", nts.Guide(slides="y"), by_force)
steps = np.arange(len(forced)) / full
motion = nts.Motion(translation=lambda t: (0.0, -np.interp(t, steps, forced[:, 0])))
_, led = press("punch_led", nts.Guide(motion=motion))
_, hung = press("punch_spring", nts.Guide(slides="y"), by_spring)
# -

# ## Pictures
#
# This is the block at the end of the first run.

plotting.snapshot(stepper, "punch.png")

# The points of all three runs lie on one curve.

# +
if mesh.comm.rank == 0:
    figure, axes = plt.subplots(figsize=(6.4, 4), dpi=250, layout="constrained")
    for curve, style, label in (
        (forced, "-", "driven by a force"),
        (led, "o", "led by the guide"),
        (hung, "x", "hung on a spring"),
    ):
        axes.plot(1e3 * curve[:, 0], 1e-3 * curve[:, 1], style, label=label)
    axes.set(xlabel="depth d [mm]", ylabel="force P [kN/m]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig("punch_force.png")
# -

# ## Checks
#
# The force of the block on its support equals that of the drive. When the guide leads the punch,
# it needs the same force at the same depth. The force of the spring is its stiffness times its
# change of length.

# +
applied = largest * steps
assert np.abs(forced[:, 1] - applied).max() < 1e-6 * largest
assert np.abs(led - forced).max(axis=0)[1] < 1e-6 * largest
stretch = 2 * largest / stiffness * steps - hung[:, 0]
assert np.abs(hung[:, 1] - stiffness * stretch).max() < 1e-5 * largest
if mesh.comm.rank == 0:
    print(f"{forced[-1, 1]:.0f} N/m at a depth of {1e3 * forced[-1, 0]:.2f} mm")
