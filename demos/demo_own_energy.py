"""A strain energy of one's own: bars with and across the fibres."""

# # Your own energy
#
# Two bars of a fibre-reinforced rubber strike a wall. Along the fibres the
# rubber is four times as stiff as across them, so the wave is twice as fast.
#
# You will learn
#
# - how to write a strain energy as one UFL function,
# - how parameters get their values,
# - that nothing else in the script changes.
#
# ## Problem
#
# Bars of 1 m x 0.02 m x 0.02 m fly at v = 0.1 m/s towards the wall x = 0.
# Rubber: $\mu$ = 0.5 MPa, $\rho$ = 1000 kg/m³. Fibres: k = 3 MPa, along x in
# one bar and along y in the other.
#
# ## Equations
#
# With the right Cauchy-Green tensor C and the fibre direction a, the energy is
#
# $$ \psi = \tfrac{\mu}{2} (\mathrm{tr}\, C - 3 - \ln \det C)
#         + \tfrac{k}{8} (a \cdot C a - 1)^2. \tag{1} $$
#
# For small strains, Young's modulus is $2 \mu + k$ along the fibres and $2 \mu$
# across them, without lateral strain. A bar with the modulus E and the cross-section A
# presses on the wall by the force F for the time T,
#
# $$ F = \rho c v A, \qquad T = 2 L / c, \qquad c = \sqrt{E / \rho}. \tag{2} $$

# +
import os

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

length, width, num_cells = 1.0, 0.02, 50  # m
mu, k, rho, v = 0.5e6, 3e6, 1e3, 0.1  # Pa, Pa, kg/m^3, m/s
speed = {"along": np.sqrt((2 * mu + k) / rho), "across": np.sqrt(2 * mu / rho)}  # m/s
dt, full = length / num_cells / speed["along"], 220  # s
num_steps = int(os.environ.get("NTS_DEMO_STEPS", str(full)))  # The tests shorten it.
# -

# ## Energy
#
# The function receives C and the parameters by name.


# +
def fibred(axis):
    """Energy (1) with fibres along a coordinate axis."""

    def psi(C, mu, k):
        rubber = mu / 2 * (ufl.tr(C) - 3 - ufl.ln(ufl.det(C)))
        return rubber + k / 8 * (C[axis, axis] - 1) ** 2

    return nts.Hyperelastic(psi, rho=rho, mu=mu, k=k)


def build(model):
    """Add the bars, side by side."""
    for i, name in enumerate(speed):
        box = {"corner": (0, 3 * width * i, 0), "size": (length, width, width)}
        parts.add_box(model, name, **box, cells=(num_cells, 1, 1))


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
wall = nts.RigidPlane((0, 0, 0), (1, 0, 0))
bars = [nts.Body(V, cells, tag[name], fibred(axis)) for axis, name in enumerate(speed)]
pairs = [nts.ContactPair(nts.Surface(V, facets, tag[f"{n}_left"]), wall) for n in speed]
stepper = nts.EnergyMomentum(bars, pairs, dt=dt)
for bar in bars:
    stepper.set_velocity(bar, (-v, 0, 0))
# -

# ## Run
#
# A snapshot is taken when the wave has just been reflected in the bar with fibres along x.

# +
diagnostics = nts.Diagnostics(stepper)
start = diagnostics.balance().total_energy
forces = []
with nts.Recorder("own_energy", stepper, every=10) as record:
    for step in stepper.run(until=num_steps * dt):
        record.write(step)
        forces.append([mesh.comm.allreduce(np.abs(p.history.force[:, 0]).sum()) for p in pairs])
        if step.step == min(num_cells, num_steps):
            picture = plotting.snapshot(stepper, "own_energy.png", camera=(0.4, -1, 0.6))
# -

picture

# ## Checks
#
# The energy is constant to round-off, as it is for any energy function. Each bar
# presses on the wall by more than F/2 for the time T of (2), within 2 %.

# +
assert abs(diagnostics.balance().total_energy / start - 1) < 1e-10
if num_steps == full:
    for name, force in zip(speed, np.transpose(forces), strict=True):
        half = rho * speed[name] * v * width**2 / 2  # N
        duration, theory = np.count_nonzero(force > half) * dt, 2 * length / speed[name]
        if mesh.comm.rank == 0:
            print(f"{name} the fibres: {duration * 1e3:.2f} ms (wave {theory * 1e3:.2f} ms)")
        assert abs(duration / theory - 1) < 0.02, name
