"""Identification: Young's modulus and Poisson's ratio of a ball from a recorded impact."""

# # An impact identifies a material
#
# A soft ball strikes a rigid floor. The positions of its surface are recorded, with noise. An
# optimiser finds the Young's modulus and the Poisson's ratio with which the computed impact is
# nearest to the record.
#
# You will learn
#
# - how to make parameters of a material controls of a run,
# - how to compare each step with data,
# - how to pass objective and gradient to an optimiser of SciPy.
#
# ## Problem
#
# A ball of rubber with the radius R = 50 mm falls on a floor at v = 1.5 m/s. It has
# E = 100 kPa, $\nu$ = 0.35 and $\rho$ = 1000 kg/m³. The record has the displacements of its
# surface at the end of every step, with an independent error of each component of 0.5 mm.
#
# ## Equations
#
# With the recorded displacements $w_n$ at the times $t_n$, the objective is
#
# $$ J(\ln E, \nu) = \frac{1}{A v^2 T^2} \sum_n \int_{\partial B} |u(t_n) - w_n|^2 dA. \tag{1} $$
#
# Its gradient takes one transposed linear system a step, backwards in time. Contact is
# differentiated as it is computed.

# +
import os

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem
from scipy.optimize import minimize

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

radius, v, rho, noise = 0.05, 1.5, 1e3, 5e-4  # m, m/s, kg/m^3, m
true, guess = np.array([np.log(1e5), 0.35]), np.array([np.log(6e4), 0.2])  # ln Pa, -
dt, full = 1e-3, 48  # s
num_steps = int(os.environ.get("NTS_DEMO_STEPS", str(full)))  # The tests shorten it.


def build(model):
    """Add the ball, just above the floor."""
    shape = {"centre": (0, 0, 1.02 * radius), "radius": radius}
    parts.add_solid_ball(model, "ball", **shape, cells_per_edge=4, layers=2)


mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
# -

# ## Ball
#
# Both parameters are Constants in the energy, here of a neo-Hookean material. The logarithm of E
# is of order one, as optimisers like it.

# +
log_E, nu = fem.Constant(mesh, guess[0]), fem.Constant(mesh, guess[1])
mu, lmbda = ufl.exp(log_E) / 2 / (1 + nu), ufl.exp(log_E) * nu / (1 + nu) / (1 - 2 * nu)


def psi(C):
    """Strain energy of the ball [J/m^3]."""
    ln_J = ufl.ln(ufl.det(C)) / 2
    return mu / 2 * (ufl.tr(C) - 3) - mu * ln_J + lmbda / 2 * ln_J**2


ball = nts.Body(V, cells, tag["ball"], nts.Hyperelastic(psi, rho=rho))
floor = nts.RigidPlane((0, 0, 0), (0, 0, 1))
skin = nts.Surface(V, facets, tag["ball_outer"])
contact = nts.ContactPair(skin, floor, enforcement=nts.Penalty(eps_N=1.0e4))
stepper = nts.EnergyMomentum([ball], [contact], dt=dt)
stepper.set_velocity(ball, (0, 0, -v))
# -

# ## Objective
#
# A function of the time returns the term of (1) at the end of each step, and reads the record for
# it. The record itself is the run with the true values, made by the same object with a record of
# zeros.

# +
w, record = fem.Function(V), {}
dA = ufl.Measure("ds", domain=mesh, subdomain_data=facets)(tag["ball_outer"])
scale = 4 * np.pi * radius**2 * (v * num_steps * dt) ** 2
distance = ufl.inner(stepper.u - w, stepper.u - w) / scale * dA


def misfit(t):
    """Term of the objective at a time, with the record of this time."""
    step = round(t / dt)
    if step not in record:
        record[step] = stepper.u.x.array + noise * errors.standard_normal(w.x.array.size)
    w.x.array[:] = record[step]
    w.x.scatter_forward()
    return distance


errors = np.random.default_rng([1, mesh.comm.rank])
J = nts.Gradient(stepper, [log_E, nu], misfit, until=num_steps * dt)
least = J.value(true)  # The first run fills the record; what remains is the noise.
# -

# ## Identification
#
# The optimiser is the quasi-Newton method L-BFGS-B, with bounds that keep the material stable.

# +
path = []
found = minimize(
    *(J.value, guess),
    jac=J.gradient,
    method="L-BFGS-B",
    bounds=[(np.log(2e4), np.log(5e5)), (0.0, 0.45)],
    callback=lambda x: path.append([np.exp(x[0]), x[1]]),
    options={"ftol": 1e-14, "gtol": 1e-9},
)
E_found, nu_found = np.exp(found.x[0]), found.x[1]
if mesh.comm.rank == 0:
    print(f"E = {E_found / 1e3:.2f} kPa, nu = {nu_found:.4f} after {found.nfev} runs")
    table = np.column_stack([np.arange(1, len(path) + 1), path])
    np.savetxt("identification.csv", table, delimiter=",", header="iteration,E,nu", comments="")
    plt.plot(table[:, 0], table[:, 1] / np.exp(true[0]), "o-", label="E / true E")
    plt.plot(table[:, 0], table[:, 2] / true[1], "s-", label=r"$\nu$ / true $\nu$")
    plt.xlabel("iteration")
    plt.legend()
    plt.savefig("identification_path.png")
    plt.close()
# -

# ## Picture
#
# This is the ball with the identified material when it is pressed most, or at the end of a
# shorter run.

# +
shown = nts.EnergyMomentum([ball], [contact], dt=dt)
shown.set_velocity(ball, (0, 0, -v))
with nts.Recorder("identified", shown, every=6) as recorder:
    for step in shown.run(until=min(num_steps, full // 4) * dt):
        recorder.write(step)
picture = plotting.snapshot(shown, "identification.png", camera=(0.4, -1, 0.3))
# -

picture

# ## Checks
#
# The gradient agrees with a difference of two runs. The optimiser has found an objective that is
# not larger than that of the true values, E within 1 % and Poisson's ratio within 3 %.

# +
h, (slope, _) = np.array([1e-4, 0]), J.gradient(guess)
difference = (J.value(guess + h) - J.value(guess - h)) / (2 * h[0])
assert abs(slope / difference - 1) < 1e-5
assert found.fun <= least
if num_steps == full:
    assert abs(E_found / np.exp(true[0]) - 1) < 0.01
    assert abs(nu_found / true[1] - 1) < 0.03
