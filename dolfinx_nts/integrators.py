"""Time integrators: what is evaluated when, and what is accepted.

The unknown of a step is u_{n+1}; v_{n+1} = 2 (u_{n+1} - u_n)/dt - v_n. Both
schemes differ in the stress and in the contact kernel only.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from dolfinx_nts import _kernels, newton
from dolfinx_nts.assembly import Bulk, SaddleSolver
from dolfinx_nts.bodies import Body, bulk_form
from dolfinx_nts.contact import ContactPair, ContactStep, Kernel
from dolfinx_nts.materials import Hyperelastic

__all__ = ["EnergyMomentum", "Midpoint", "StepReport"]

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class StepReport(newton.NewtonReport):
    t: float
    dt: float


def _right_cauchy_green(F: Any) -> Any:
    return F.T * F


class _Stepper:
    _kernel: ClassVar[Kernel]

    def __init__(self, bodies, pairs, *, dt, bcs=()):
        V = bodies[0].V
        self.V, self.bodies, self.pairs, self.bcs = V, tuple(bodies), tuple(pairs), tuple(bcs)
        self.t = 0.0
        self._dt = fem.Constant(V.mesh, float(dt))
        self.u, self.v, self._u_n = (fem.Function(V) for _ in range(3))
        self._X = V.tabulate_dof_coordinates()
        eta = ufl.TestFunction(V)
        I = ufl.Identity(3)
        u, u_n, v, dt_ = self.u, self._u_n, self.v, self._dt

        def residual(material, parameters, rho):
            F_n, F = I + ufl.grad(u_n), I + ufl.grad(u)
            S = self._stress(material, parameters, F_n, F)
            P = (F_n + F) / 2 * S
            inertia = rho * (2 / dt_**2 * (u - u_n) - 2 / dt_ * v)
            return ufl.inner(inertia, eta) + ufl.inner(P, ufl.grad(eta))

        self._bulk = Bulk(bulk_form(bodies, residual), u, bcs)
        self._solver = SaddleSolver(V.mesh.comm, self._bulk.fixed)
        self._force_scale = 0.0

    def set_velocity(self, body, v):
        self.v.x.array.reshape(-1, 3)[body.nodes] = v

    def advance(self):
        V = self.V
        u, u_n = self.u.x.array, self._u_n.x.array
        u_n[:] = u
        n = V.dofmap.index_map.size_local
        dt = float(self._dt.value)
        x_n = self._X + u_n.reshape(-1, 3)
        x_trial = x_n + dt * self.v.x.array.reshape(-1, 3)
        diag = self._bulk.tangent().getDiagonal().array.reshape(-1, 3).mean(1)
        reports = []
        for guess in (u_n + dt * self.v.x.array, u_n.copy()):
            u[:] = guess
            fem.set_bc(u, self.bcs) if self.bcs else None
            steps = [
                ContactStep(p, type(self)._kernel, x_n, x_trial, 0.1 * diag) for p in self.pairs
            ]
            solution = newton.solve(
                self._bulk, self._solver, steps, self._X[:n], force_scale=self._force_scale, size=0.566
            )
            reports.append(solution.report)
            if not solution.report.reason:
                break
        else:
            u[:] = u_n
            raise newton.ConvergenceError(f"t={self.t}: {reports}", reports)
        self._force_scale = np.sqrt(V.mesh.comm.allreduce(solution.R_bulk @ solution.R_bulk))
        self.v.x.array[:] = 2 / dt * (u - u_n) - self.v.x.array
        for p, s in zip(self.pairs, steps):
            p.history = s.accepted()
        self.t += dt
        self.last = solution
        return solution.report


class Midpoint(_Stepper):
    _kernel = _kernels.contact_midpoint

    def _stress(self, material, parameters, F_n, F):
        return material.stress(_right_cauchy_green((F_n + F) / 2), **parameters)


class EnergyMomentum(_Stepper):
    _kernel = _kernels.contact_conserving

    def _stress(self, material, parameters, F_n, F):
        C_n, C = _right_cauchy_green(F_n), _right_cauchy_green(F)
        return material.conserving_stress(C_n, C, **parameters)
