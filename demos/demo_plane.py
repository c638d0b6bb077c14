"""A disc and a ring roll down a slope, in two dimensions."""

# # A race in the plane
#
# A solid disc and a ring roll down a slope. The disc is faster, catches up with the ring and
# strikes it.
#
# You will learn
#
# - how to set up a scene in two dimensions: a gmsh model of surfaces, `V` of shape `(2,)`,
#   points and vectors with two coordinates,
# - that pairs, obstacles, loads, ledger, files and pictures work as in three dimensions,
# - that forces, masses and energies are those of one metre of thickness.
#
# ## Problem
#
# Both bodies have a radius of 0.5 m, and the ring is 0.2 m thick. They are neo-Hookean,
# E = 3 MPa, $\nu$ = 0.3, $\rho$ = 1000 kg/m³, in plane strain. The slope is a rigid line at an
# angle of 20 degrees, $\mu$ = 0.5. The bodies start 0.05 m apart.
#
# ## Equations
#
# A rigid wheel with the radius of gyration $k$ rolls down with the acceleration
#
# $$ a = \frac{g \sin\theta}{1 + k^2 / R^2}, \qquad
#    k^2 = \tfrac{1}{2} (R^2 + r^2), \tag{1} $$
#
# where $r$ is the inner radius. This is 2/3 of $g \sin\theta$ for the disc, where $r = 0$, and
# 0.60 of it for the ring.

# +
import os

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import plotting

full, dt = 140, 0.005  # s
num_steps = int(os.environ.get("NTS_DEMO_STEPS", str(full)))  # The tests shorten it.
R, r, gap, g, slope = 0.5, 0.3, 0.05, 9.81, np.radians(20)
downhill, away = np.array([np.cos(slope), -np.sin(slope)]), np.array([np.sin(slope), np.cos(slope)])
start = {"disc": R * away, "ring": R * away + (2 * R + gap) * downhill}


def build(model):
    """Add the disc and the ring, surfaces in the plane z = 0."""
    circle = model.occ.addDisk
    disc = circle(*start["disc"], 0, R, R)
    whole, hole = (circle(*start["ring"], 0, radius, radius) for radius in (R, r))
    model.occ.cut([(2, whole)], [(2, hole)])
    model.occ.synchronize()
    model.addPhysicalGroup(2, [disc], name="disc")
    model.addPhysicalGroup(2, [whole], name="ring")
    model.mesh.setSize(model.getEntities(0), 0.035)
    model.mesh.generate(2)


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
rubber = nts.NeoHookean(E=3e6, nu=0.3, rho=1e3)
disc, ring = (nts.Body(V, cells, tag[name], rubber) for name in ("disc", "ring"))
road = nts.RigidPlane(point=(0, 0), normal=away)
pairs = nts.all_pairs([disc, ring], obstacles=[road], friction=nts.Coulomb(0.5))
weight = nts.Gravity([disc, ring], (0, -g))
stepper = nts.EnergyMomentum([disc, ring], pairs, dt=dt, loads=[weight])
# -

# ## Run

# +
diagnostics = nts.Diagnostics(stepper)
way = {"disc": [], "ring": []}
touching = []
with nts.Recorder("plane", stepper, every=10, columns_of=("obstacles", "loads")) as record:
    for step in stepper.run(until=num_steps * dt):
        record.write(step)
        touching.append(bool(mesh.comm.allreduce(pairs[0].history.active.sum())))
        for name, body in (("disc", disc), ("ring", ring)):
            way[name].append(diagnostics.centre_of_mass(body) @ downhill)
        if step.step == min(114, num_steps):
            picture = plotting.snapshot(stepper, "plane.png")
            forces = plotting.contact(stepper, "plane_contact.png", pair=1)
# -

# This is the stress while the disc strikes the ring. The grey area is below the road.

picture

# This is the contact pressure below both bodies, in N/m² as in space, with the forces on their
# nodes.

forces

plotting.energies("plane.csv", "plane_energies.png")

# ## Checks
#
# After half a second, before they meet, the disc and the ring have rolled as far as rigid
# wheels, within 3 %. The ledger explains all changes of the energy.

# +
if num_steps == full:
    for name, hole in (("disc", 0.0), ("ring", r)):
        expected = g * np.sin(slope) / (1 + (R**2 + hole**2) / (2 * R**2)) * 0.5**2 / 2
        rolled = way[name][99] - start[name] @ downhill
        assert abs(rolled / expected - 1) < 0.03, name
    assert not any(touching[:100]) and any(touching)
if mesh.comm.rank == 0:
    table = np.genfromtxt("plane.csv", delimiter=",", names=True)
    assert np.abs(table["energy_unaccounted"]).max() < 1e-9 * table["kinetic_energy"].max()
    print(record.summary())
