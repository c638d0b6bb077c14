"""A hollow door seal is squeezed flat until its inside touches itself."""

# # A hollow seal that touches itself
#
# The round profile of a door seal is squeezed between two faces. It flattens, and at last its
# inner walls touch. Then the force grows steeply.
#
# You will learn
#
# - how to combine contact with tools and self contact,
# - how to get the curve of force over squeeze,
# - how well theory of beams predicts the force, up to which squeeze.
#
# ## Problem
#
# The profile is a tube with the mean radius R = 9.4 mm and the wall t = 1.2 mm, in plane strain
# (neo-Hooke, E = 3 MPa, $\nu$ = 0.49). Both faces are rigid, without friction. Forces are those
# of one metre of the seal.
#
# ## Equations
#
# Let H be the distance between the middle lines of the upper and the lower wall, F the force, and
# $EI = E t^3 / (12 (1 - \nu^2))$. The angle $\theta(s)$ of an inextensible beam satisfies
# $EI\, \theta'' = \tfrac{1}{2} F \cos \theta$. From H = 1.44 R on, the walls lie flat on the faces,
# where $\theta = \theta' = 0$. Then $\theta'^2 = F \sin \theta / EI$ in the bends, so that
#
# $$ H = 2 \int \sin \theta\, ds
#      = 2 \sqrt{\frac{EI}{F}} \int_0^{\pi/2} \sqrt{\sin \theta}\, d\theta, \qquad
#    F = 5.742\, \frac{EI}{H^2}. \tag{1} $$
#
# The inner walls touch at H = t, where the bends are no longer slender.

# +
import os

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import plotting

full = 32
num_steps = min(int(os.environ.get("NTS_DEMO_STEPS", str(full))), full)  # The tests shorten it.
R, t = 0.0094, 0.0012  # m
E, nu = 3e6, 0.49  # Pa, -
EI = E * t**3 / (12 * (1 - nu**2))  # N m, of one metre
last = 2 * t * 0.99  # m, distance of the faces at the end


def build(model):
    """Add a tube of four quarters, with its centre at the origin."""
    occ, mesh = model.occ, model.mesh
    centre = occ.addPoint(0, 0, 0)
    axes = ((1, 0), (0, 1), (-1, 0), (0, -1))
    rings = [[occ.addPoint(r * x, r * y, 0) for x, y in axes] for r in (R - t / 2, R + t / 2)]
    arcs = [[occ.addCircleArc(ring[i], centre, ring[i - 3]) for i in range(4)] for ring in rings]
    spokes = [occ.addLine(*ends) for ends in zip(*rings, strict=True)]
    quarters = [
        occ.addPlaneSurface([occ.addCurveLoop([arcs[0][i], spokes[i - 3], arcs[1][i], spokes[i]])])
        for i in range(4)
    ]
    occ.synchronize()
    model.addPhysicalGroup(2, quarters, name="seal")
    model.addPhysicalGroup(1, arcs[0], name="inside")
    model.addPhysicalGroup(1, arcs[1], name="outside")
    for arc in arcs[0] + arcs[1]:
        mesh.setTransfiniteCurve(arc, 41)
    for spoke in spokes:
        mesh.setTransfiniteCurve(spoke, 3)
    for quarter in quarters:
        mesh.setTransfiniteSurface(quarter)
        mesh.setRecombine(2, quarter)
    mesh.generate(2)


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
seal = nts.Body(V, cells, tag["seal"], nts.NeoHookean(E=E, nu=nu, rho=1.1e3))
inside, outside = (nts.Surface(V, facets, tag[side]) for side in ("inside", "outside"))
# -

# ## Faces, self contact and symmetry
#
# Time only measures the squeeze, from 0 to 1. A surface that is both sides of a pair can touch
# itself.


# +
def hold(axis):
    """Hold the nodes in a plane of symmetry."""
    W = V.sub(axis)
    dofs, _ = fem.locate_dofs_geometrical((W, W.collapse()[0]), lambda x: np.abs(x[axis]) < 1e-9)
    return fem.dirichletbc(np.float64(0), dofs, W)


top = R + t / 2  # m


def face(name, side):
    """Face that moves towards the seal, from below (-1) or above (1)."""
    motion = nts.Motion(translation=lambda time: (0.0, -side * (top - last / 2) * time))
    return nts.RigidPlane((0.0, side * top), (0.0, -side), name=name).moving(motion)


faces = [face(name, side) for name, side in (("lower", -1), ("upper", 1))]
pairs = [nts.ContactPair(outside, plane) for plane in faces]
pairs.append(nts.ContactPair(inside, inside, name="self"))
stepper = nts.QuasiStatic([seal], pairs, dt=1 / full, bcs=[hold(0), hold(1)])
# -

# ## Run
#
# With a `StepControl`, a step that fails when the walls meet is halved.

# +
columns = {"squeeze": lambda s: 2 * (top - last / 2) * s.t}
with nts.Recorder("hollow_seal", stepper, own_columns=columns) as record:
    for step in stepper.run(until=num_steps / full, control=nts.StepControl()):
        record.write(step)
        if step.step == min(18, num_steps):
            half_way = plotting.snapshot(stepper, "hollow_seal.png")
# -

# ## Pictures
#
# Half of the way, the walls lie flat on both faces.

half_way

# At the end the inner walls touch, but for both bends.

plotting.snapshot(stepper, "hollow_seal_end.png")

# The force follows (1) until the bends are as narrow as the wall is thick.

# +
if mesh.comm.rank == 0:
    table = np.genfromtxt("hollow_seal.csv", delimiter=",", names=True)[1:]  # without the start
    F, squeeze = table["obstacle_upper_force_y"], table["squeeze"]
    H = 2 * R - squeeze
    flat = (H > 0.4 * R) & (H < 1.4 * R)
    figure, axes = plt.subplots(figsize=(6.4, 4), dpi=250, layout="constrained")
    axes.semilogy(1e3 * squeeze, F, ".-", label="computed")
    axes.semilogy(1e3 * squeeze[flat], 5.742 * EI / H[flat] ** 2, "k--", label="slender beam (1)")
    axes.set(xlabel="squeeze [mm]", ylabel="force F [N/m]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig("hollow_seal_force.png")
# -

# ## Checks
#
# While H is between 1.4 R and 0.4 R, the force is that of (1) within 2 %. At the end the inside
# touches itself, and nodes overlap by less than 1 % of the wall. Both faces meet the same force.

# +
if mesh.comm.rank == 0:
    assert np.abs(F / (5.742 * EI / H**2) - 1)[flat].max(initial=0.0) < 0.02
    assert np.abs(table["obstacle_lower_force_y"] + F).max() < 1e-3 * F.max()
    if num_steps == full:
        assert table["pair_self_contact_area"][-1] > 0
        assert table["min_gap"].min() > -0.01 * t
        middle = np.abs(squeeze - R).argmin()
        ratio = F[middle] * H[middle] ** 2 / EI
        print(f"F H^2 / EI = {ratio:.3f} at half of the height (slender beam 5.742)")
        print(f"force at the end {F[-1]:.0f} N/m, before the walls touch {F[-2]:.0f} N/m")
