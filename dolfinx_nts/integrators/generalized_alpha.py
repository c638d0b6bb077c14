r"""Generalised-alpha method: a dissipative scheme for comparison.

J. Chung and G. M. Hulbert, J. Appl. Mech. 60 (1993): Newmark's formulas for
displacement and velocity, with the balance of momentum

.. math:: M [(1 - \alpha_m) a_{n+1} + \alpha_m a_n]
   + f_{int}(F_{n+1-\alpha_f}) + \sum \lambda_N \nabla g_{n+1} = f_{ext}.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arguments import finite, instances
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.jit import assembled, compile_form
from dolfinx_nts.integrators.implicit import ImplicitStepper
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.model.loads import Load
from dolfinx_nts.parallel import reductions

__all__ = ["GeneralizedAlpha"]


_MAX_ITERATIONS = 1000


class GeneralizedAlpha(ImplicitStepper):
    r"""Generalised-alpha method, which damps high frequencies.

    Second order in the step. It conserves the linear momentum, but neither
    the energy nor the angular momentum: it is here to be compared with.
    Contact is closed at the end of a step, g = 0, so that nodes lose their
    impact energy. Collective, as all its methods.

    Args:
        bodies: Bodies of one space, which fill the mesh.
        pairs: Contact pairs, by `Penalty` or ``LagrangeMultiplier("plastic")``.
        dt: Length of a step [s].
        rho_inf: Spectral radius at infinite frequency, from 0 (what is not
            resolved is gone after one step) to 1 (no damping).
        bcs: See `EnergyMomentum`.
        loads: Loads on the bodies.
        update: See `EnergyMomentum`.
        petsc_options: See `EnergyMomentum`.

    Attributes:
        a: Acceleration at t [m/s^2]; from the balance of momentum at the
            start. The others are those of `EnergyMomentum`.

    Raises:
        TypeError: An argument has the wrong type.
        ValueError: As of `EnergyMomentum`; ``rho_inf`` is not in [0, 1]; a
            pair has elastic impact.
    """

    a: fem.Function
    _contact = "static"

    def __init__(
        self,
        bodies: Sequence[Body],
        pairs: Sequence[ContactPair] = (),
        *,
        dt: float,
        rho_inf: float = 0.8,
        bcs: Sequence[fem.DirichletBC] = (),
        loads: Sequence[Load] = (),
        update: Callable[[float], None] | None = None,
        petsc_options: Mapping[str, Any] | None = None,
    ) -> None:
        """Choose the parameters and compile the forms."""
        if not 0 <= finite("rho_inf", rho_inf) <= 1:
            raise ValueError(f"expected a spectral radius rho_inf in [0, 1], given {rho_inf}")
        for pair in instances(ContactPair, pairs):
            law = pair.enforcement
            if isinstance(law, LagrangeMultiplier) and law.impact == "elastic":
                raise ValueError(
                    "expected Penalty or LagrangeMultiplier('plastic') for GeneralizedAlpha, "
                    "given elastic impact"
                )
        self.rho_inf = float(rho_inf)
        self._alpha_m, self._alpha_f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
        self._gamma = 0.5 - self._alpha_m + self._alpha_f
        self._beta = (1 - self._alpha_m + self._alpha_f) ** 2 / 4
        self._load_point = self._stress_share = 1 - self._alpha_f
        super().__init__(
            bodies,
            pairs,
            dt=dt,
            bcs=bcs,
            loads=loads,
            update=update,
            petsc_options=petsc_options,
        )
        eta = ufl.TestFunction(self.u.function_space)
        momentum = bulk_form(bodies, lambda material, parameters, rho: rho * ufl.inner(self.a, eta))
        self._mass_form = compile_form(momentum)
        self._known = False  # whether the acceleration belongs to the present state

    def serialize(self, archive: Archive) -> None:
        """Serialize the state, also the acceleration."""
        super().serialize(archive)
        self._serialize_nodal(archive, "a", self.a.x.array)
        self._known = archive.same("a_is_known", self._known)

    def first_piola(self, material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
        """Stress at the weighted deformation gradient."""
        F_m = (1 - self._alpha_f) * F + self._alpha_f * F_n
        return F_m * material.stress(right_cauchy_green(F_m), **parameters)

    def _acceleration(self) -> Any:
        """Weighted acceleration of a step, UFL (3,), with the one at its start."""
        self.a = fem.Function(self.u.function_space, name="acceleration")
        a = self._newmark(self.u, self.u_n, self.v, self.a, self._dt)
        return (1 - self._alpha_m) * a + self._alpha_m * self.a

    def _newmark(self, u: Any, u_n: Any, v: Any, a: Any, dt: Any) -> Any:
        """Acceleration at the end of a step."""
        return ((u - u_n) / dt - v) / (self._beta * dt) - (1 / (2 * self._beta) - 1) * a

    def _state_was_set(self) -> None:
        super()._state_was_set()
        self._known = False

    def _step(self) -> StepReport:
        """Solve a step, with the acceleration at its start."""
        if not self._known:
            self._start()
        return super()._step()

    def _start(self) -> None:
        """Acceleration of a state that was set: M a = f, without contact."""
        for load in self.loads:
            load.update(self.t)
        # Part of the residual is that of the inertia at u = u_n.
        self.a.x.array[:] = 0
        inertia = (self._alpha_m - 1) / (self._beta * self.dt) * self.nodal_momentum()
        force = inertia.ravel() - self._bulk.forces()
        for load in self.loads:
            load.update(self.t + self._load_point * self.dt)
        self._solve_mass(force)
        self._known = True

    def _momentum_of(self, a: Floats) -> Floats:
        """Consistent mass times owned values, both ``(3 n,)``. Collective."""
        self.a.x.array[: len(a)] = a
        self.a.x.scatter_forward()
        return assembled(self._mass_form)

    def _solve_mass(self, force: Floats) -> None:
        """Set the acceleration by conjugate gradients. Collective.

        The mass matrix is well-conditioned; its rows of given displacements
        are left out.
        """
        free = np.ones(len(force))
        free[self._bulk.fixed] = 0
        a, r = np.zeros(len(force)), free * force
        start = norm = self._norm(r)
        p = r.copy()
        for _ in range(_MAX_ITERATIONS):
            if norm <= 1e-15 * start:
                break
            product = free * self._momentum_of(p)
            step = norm**2 / float(reductions.total(self._comm, p @ product))
            a += step * p
            r -= step * product
            before, norm = norm, self._norm(r)
            p = r + (norm / before) ** 2 * p
        self._momentum_of(a)

    def _update_velocity(self) -> None:
        """Newmark's formulas; the energy that they do not account for."""
        n, dt, comm = 3 * self._num_owned, self.dt, self._comm
        u, u_n, v, a_n = (f.x.array for f in (self.u, self.u_n, self.v, self.a))
        a_n = a_n.copy()
        a = self._newmark(u, u_n, v, a_n, dt)
        rate = self._momentum_of(((1 - self._alpha_m) * a + self._alpha_m * a_n)[:n])
        before = v[:n] @ self.nodal_momentum().ravel()
        v += dt * ((1 - self._gamma) * a_n + self._gamma * a)
        after = v[:n] @ self.nodal_momentum().ravel()
        self.a.x.array[:] = a
        gained = (after - before) / 2 - rate @ (u - u_n)[:n]
        self.inertia_defect = float(reductions.total(comm, gained))
