"""A rubber O-ring is squeezed: force and contact pressure of a seal."""

# # A rubber seal
#
# An O-ring is squeezed between two flat faces. The results are its force per length, and the
# pressure with which it seals.
#
# You will learn
#
# - how to squeeze a nearly incompressible body by a quarter of its height,
# - how to get the force and the largest pressure of a contact from the table,
# - up to which squeeze the theory of small strains holds.
#
# ## Problem
#
# The ring is long compared with its cord, so the cross-section is in plane strain. The cord has
# the diameter D = 5.33 mm (neo-Hooke, E = 5 MPa, $\nu$ = 0.499). Both faces are rigid, without
# friction, and come closer by $\delta$ = D/4. Forces are those of one metre of the cord.
#
# ## Equations
#
# With $E^* = E / (1 - \nu^2)$, a cylinder between two planes that press it by the force F touches
# each over the half-width a, with the largest pressure p (Johnson, Contact Mechanics, ch. 4, 5):
#
# $$ a = \sqrt{\frac{2 F D}{\pi E^*}}, \qquad p = \frac{2 F}{\pi a}, \qquad
#    \delta = \frac{2 F}{\pi E^*} \left( 2 \ln \frac{2 D}{a} - 1 \right). \tag{1} $$
#
# A seal holds fluids up to about the pressure p.

# +
import os

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import plotting

full = 20
num_steps = min(int(os.environ.get("NTS_DEMO_STEPS", str(full))), full)  # The tests shorten it.
D, squeeze = 0.00533, 0.25  # m, -
E, nu = 5e6, 0.499  # Pa, -


def build(model):
    """Add the cord of four quarters, with its centre at the origin."""
    disc = model.occ.addDisk(0, 0, 0, D / 2, D / 2)
    centre = [model.occ.addPoint(x, y, 0) for x, y in ((-D, 0), (D, 0), (0, -D), (0, D))]
    lines = [(1, model.occ.addLine(*ends)) for ends in (centre[:2], centre[2:])]
    cut, _ = model.occ.fragment([(2, disc)], lines)
    model.occ.remove([entity for entity in cut if entity[0] == 1], recursive=True)
    model.occ.synchronize()
    quarters = [quarter for _, quarter in model.getEntities(2)]
    model.addPhysicalGroup(2, quarters, name="seal")
    model.mesh.setSize(model.getEntities(0), D / 40)
    for quarter in quarters:
        model.mesh.setRecombine(2, quarter)
    model.mesh.generate(2)


mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
seal = nts.Body(V, cells, tag["seal"], nts.NeoHookean(E=E, nu=nu, rho=1e3))


def hold(axis):
    """Hold the nodes in a plane of symmetry."""
    W = V.sub(axis)
    dofs, _ = fem.locate_dofs_geometrical((W, W.collapse()[0]), lambda x: np.abs(x[axis]) < 1e-9)
    return fem.dirichletbc(np.float64(0), dofs, W)


def face(name, side):
    """Face that moves towards the seal, from below (-1) or above (1)."""
    motion = nts.Motion(translation=lambda t: (0.0, -side * squeeze * D / 2 * t))
    return nts.RigidPlane((0.0, side * D / 2), (0.0, -side), name=name).moving(motion)


surface = nts.boundary_of(seal)
pairs = [nts.ContactPair(surface, face(name, side)) for name, side in (("lower", -1), ("upper", 1))]
stepper = nts.QuasiStatic([seal], pairs, dt=1 / full, bcs=[hold(0), hold(1)])
# -

# ## Run
#
# Time only measures the squeeze, from 0 to 1.

with nts.Recorder("seal", stepper, own_columns={"squeeze": lambda s: squeeze * D * s.t}) as record:
    for step in stepper.run(until=num_steps / full):
        record.write(step)

# ## Pictures
#
# The squeezed cord is stressed most in its middle.

plotting.snapshot(stepper, "seal.png")

# Its force follows the theory of small strains up to a tenth of the diameter.

# +
if mesh.comm.rank == 0:
    table = np.genfromtxt("seal.csv", delimiter=",", names=True)[1:]  # without the start
    F, delta = table["obstacle_upper_force_y"], table["squeeze"]
    E_star = E / (1 - nu**2)
    a = np.sqrt(2 * F * D / (np.pi * E_star))
    theory = 2 * F / (np.pi * E_star) * (2 * np.log(2 * D / a) - 1)
    figure, axes = plt.subplots(figsize=(6.4, 4), dpi=250, layout="constrained")
    axes.plot(1e3 * delta, 1e-3 * F, ".-", label="computed")
    axes.plot(1e3 * theory, 1e-3 * F, "k--", label="small strains")
    axes.set(xlabel=r"squeeze $\delta$ [mm]", ylabel="force F [kN/m]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig("seal_force.png")
# -

# ## Checks
#
# Up to 6 % of the diameter, the squeeze is that of (1) for the computed force within 2 %, and the
# largest pressure within 4 %. Both faces meet the same force.

# +
if mesh.comm.rank == 0:
    small = delta < 0.065 * D
    largest = table["pair_boundary_seal_upper_largest_pressure"]
    assert np.abs(theory / delta - 1)[small].max() < 0.02
    assert np.abs(largest / (2 * F / (np.pi * a)) - 1)[small].max() < 0.04
    assert np.abs(table["obstacle_lower_force_y"] + F).max() < 1e-3 * F.max()
    print(f"squeeze {delta[-1] / D:.2f} D: {F[-1]:.0f} N/m, up to {1e-6 * largest[-1]:.2f} MPa")
