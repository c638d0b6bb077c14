"""A rigid mass strikes a clamped rod of the same mass: the solution of St. Venant.

In units of E = rho = A = 1 and with tau = c t/L the force over rho c v A is exp(-tau) until the
wave comes back from the clamp at tau = 2, and exp(-tau) + 2 (3 - tau) exp(2 - tau) from then on, as
long as it is positive.
"""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.scenes import boxes, distribute

pytestmark = pytest.mark.serial

LENGTH, SPEED, CELLS = 10.0, 0.01, 60
END = 3 + np.exp(-2) / 2


def exact(tau):
    second = np.exp(-tau) + 2 * (3 - tau) * np.exp(2 - tau)
    return np.where(tau < 2, np.exp(-tau), np.maximum(second, 0.0))


def test_duration_impulses_and_rebound_are_exact_within_two_percent(told):
    data = boxes([(1, 1, CELLS), (1, 1, 1)], [(1.0, 1.0, LENGTH), (2.0, 2.0, 0.5)])
    data.X[np.unique(data.cells[data.body == 1])] += [-0.5, -0.5, LENGTH + 1e-6]
    mesh, cells, facets, tag = distribute(MPI.COMM_SELF, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rod = nts.Body(V, cells, tag["body 0"], nts.SaintVenantKirchhoff(1.0, 0.0, 1.0))
    mass = nts.RigidBody(V, cells, tag["body 1"], LENGTH / 2)
    pair = nts.ContactPair(*(nts.Surface(V, facets, tag[name]) for name in ("top 0", "bottom 1")))
    foot = fem.locate_dofs_topological(V, 2, facets.find(tag["bottom 0"]))
    clamp = fem.dirichletbc(np.zeros(3), foot, V)
    dt = LENGTH / CELLS
    stepper = nts.EnergyMomentum([rod, mass], [pair], dt=dt, bcs=[clamp])
    stepper.set_velocity(mass, (0, 0, -SPEED))
    diagnostics = nts.Diagnostics(stepper)
    first, speed = diagnostics.balance(), [-SPEED]
    for _ in stepper.run(until=3.3 * LENGTH):
        speed.append(diagnostics.body_velocity(mass)[2])
    energy = diagnostics.balance().total_energy
    assert abs(energy - first.total_energy) < 1e-11 * first.total_energy
    force = np.diff(speed) / SPEED * CELLS
    tau = np.arange(1, len(speed)) / CELLS
    duration, impulses = tau[force > 1e-6][-1], []
    assert abs(duration - END) < 0.02 * END
    fine = np.linspace(0, END, 100_001)
    for some, part in ((tau < 1.8, fine < 1.8), (tau > 1.8, fine > 1.8)):
        impulse = np.trapezoid(exact(fine[part]), fine[part])
        impulses.append(force[some].sum() / CELLS / impulse - 1)
        assert abs(impulses[-1]) < 0.02
    rebound = np.trapezoid(exact(fine), fine) - 1
    assert abs(speed[-1] / SPEED - rebound) < 0.02 * rebound
    # The returning front is a jump, which every mesh overshoots: two steps share its peak.
    largest = max(force[1:] + force[:-1]) / 2
    told(
        f"rigid mass strikes a clamped rod of the same mass, {CELLS} cells, elastic impact: "
        "duration, rebound, largest force (mean of two steps), impulse before and after the "
        "wave comes back",
        f"{END:.3f} L/c, {rebound:.3f} v, {exact(2.0):.3f} rho c v A (jump), exact",
        f"{duration:.3f} L/c, {speed[-1] / SPEED:.3f} v, {largest:.3f} rho c v A, "
        f"{100 * impulses[0]:+.2f} %, {100 * impulses[1]:+.2f} %",
    )
