r"""Generalised-alpha method: a dissipative scheme for comparison.

J. Chung and G. M. Hulbert, J. Appl. Mech. 60 (1993): Newmark's formulas for displacement and
velocity, with the balance of momentum

.. math:: M [(1 - \alpha_m) a_{n+1} + \alpha_m a_n]
   + f_{int}(F_{n+1-\alpha_f}) + \sum \lambda_N \nabla g_{n+1} = f_{ext}.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arguments import finite, instances
from dolfinx_nts.common.arrays import Floats, GlobalInts
from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.integrators.implicit import ImplicitStepper
from dolfinx_nts.integrators.rates import ConsistentMass, Rates
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.integrators.state import serialize_nodal
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.loads import Load
from dolfinx_nts.parallel import reductions

__all__ = ["GeneralizedAlpha"]

# Conjugate gradients for the mass matrix, which is well-conditioned: most iterations, and
# reduction of the residual, which is that of rounding.
_MAX_ITERATIONS, _REDUCTION = 1000, 1e-15


@dataclass(frozen=True)
class _Parameters:
    """Parameters of the method by its spectral radius at infinite frequency."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float

    @classmethod
    def of(cls, rho_inf: float) -> "_Parameters":
        alpha_m, alpha_f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
        beta = (1 - alpha_m + alpha_f) ** 2 / 4
        return cls(alpha_m, alpha_f, beta, 0.5 - alpha_m + alpha_f)


class GeneralizedAlpha(ImplicitStepper):
    r"""Generalised-alpha method, which damps high frequencies.

    Second order in the step. It conserves the linear momentum, but neither the energy nor the
    angular momentum: it is here to be compared with. Contact is closed at the end of a step, g
    = 0, so that nodes lose their impact energy. Collective, as all its methods.

    Args:
        bodies: Bodies of one space, which fill the mesh.
        pairs: Contact pairs, by `Penalty` or ``LagrangeMultiplier("plastic")``.
        dt: Length of a step [s].
        rho_inf: Spectral radius at infinite frequency, from 0 (what is not resolved is gone
            after one step) to 1 (no damping).
        bcs: See `EnergyMomentum`.
        loads: Loads on the bodies.
        update: See `EnergyMomentum`.
        petsc_options: See `EnergyMomentum`.

    Attributes:
        rho_inf: The spectral radius.
        a: Acceleration at t [m/s^2]; from the balance of momentum at the start. The others are
            those of `EnergyMomentum`.

    Raises:
        TypeError: An argument has the wrong type.
        ValueError: As of `EnergyMomentum`; ``rho_inf`` is not in [0, 1]; a pair has elastic
            impact.
    """

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
        """Check the laws of contact and make the scheme."""
        if not 0 <= finite("rho_inf", rho_inf) <= 1:
            raise ValueError(f"expected a spectral radius rho_inf in [0, 1], given {rho_inf}")
        for pair in instances(ContactPair, pairs):
            law = pair.enforcement
            if isinstance(law, LagrangeMultiplier) and law.impact == "elastic":
                raise ValueError(
                    "expected Penalty or LagrangeMultiplier('plastic') for GeneralizedAlpha, "
                    "given elastic impact"
                )
        parameters = _Parameters.of(rho_inf)
        super().__init__(
            Scheme(
                contact="static",
                stress=partial(_stress, parameters.alpha_f),
                rates=partial(_NewmarkRates, parameters),
                stress_share=1 - parameters.alpha_f,
                load_point=1 - parameters.alpha_f,
            ),
            bodies,
            pairs,
            dt=dt,
            bcs=bcs,
            loads=loads,
            update=update,
            petsc_options=petsc_options,
        )
        self.rho_inf = float(rho_inf)

    @property
    def a(self) -> fem.Function:
        """Acceleration at t [m/s^2]."""
        assert isinstance(self._rates, _NewmarkRates)
        return self._rates.a


def _stress(alpha_f: float, material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
    """Stress at the weighted deformation gradient, see `Scheme`."""
    F_m = (1 - alpha_f) * F + alpha_f * F_n
    return F_m * material.stress(right_cauchy_green(F_m), **parameters)


class _NewmarkRates(Rates):
    """Newmark's formulas, with the acceleration as a state, see `Rates`.

    Args:
        parameters: Of the method.
        u_n: As of `Rates`, and so are the others.
        u: Displacement at the end of a step.
        v: Velocity at its start.
        dt: Its length [s].
        bodies: The bodies.

    Attributes:
        a: Acceleration at t [m/s^2].
    """

    def __init__(
        self,
        parameters: _Parameters,
        u_n: fem.Function,
        u: fem.Function,
        v: fem.Function,
        dt: fem.Constant,
        bodies: Sequence[Body],
    ) -> None:
        """Begin with an acceleration that is not known."""
        self._parameters = p = parameters
        self.a = fem.Function(u.function_space, name="acceleration")
        self._mass_times_a, self._mass_times_v = (ConsistentMass(bodies, f) for f in (self.a, v))
        self.acceleration = (1 - p.alpha_m) * self._newmark(u, u_n, v, self.a, dt)
        self.acceleration += p.alpha_m * self.a
        super().__init__(u_n, u, v, dt, bodies)

    def _newmark(self, u: Any, u_n: Any, v: Any, a: Any, dt: Any) -> Any:
        """Acceleration at the end of a step."""
        beta = self._parameters.beta
        return ((u - u_n) / dt - v) / (beta * dt) - (1 / (2 * beta) - 1) * a

    def forget(self) -> None:
        """Compute the acceleration anew at the next step, as the state was set."""
        super().forget()
        self._known = False

    def begin(self, forces: Callable[[], Floats], free: Floats | None) -> None:
        """Acceleration of a state that was set: M a = f, without contact."""
        if self._known:
            return
        p = self._parameters
        # Part of the residual is that of the inertia at u = u_n.
        self.a.x.array[:] = 0
        factor = (p.alpha_m - 1) / (p.beta * float(self.dt.value))
        force = factor * self._mass_times_v.momentum().ravel() - forces()
        self._solve_mass(force, np.ones_like(force) if free is None else free.ravel())
        self._known = True

    def _momentum_of(self, a: Floats) -> Floats:
        """Consistent mass times owned values, both ``(3 n,)``. Collective."""
        self.a.x.array[: len(a)] = a
        self.a.x.scatter_forward()
        return self._mass_times_a.momentum().ravel()

    def _solve_mass(self, force: Floats, free: Floats) -> None:
        """Set the acceleration where it is free by conjugate gradients. Collective."""
        comm: MPI.Comm = self.u.function_space.mesh.comm
        a, r = np.zeros(len(force)), free * force
        first = square = float(reductions.total(comm, r @ r))
        p = r.copy()
        for _ in range(_MAX_ITERATIONS):
            if np.sqrt(square) <= _REDUCTION * np.sqrt(first):
                break
            product = free * self._momentum_of(p)
            step = square / float(reductions.total(comm, p @ product))
            a += step * p
            r -= step * product
            before, square = square, float(reductions.total(comm, r @ r))
            p = r + square / before * p
        self._momentum_of(a)

    def _set_velocity(self) -> float:
        """Newmark's formulas; returns the energy that they do not account for."""
        p, dt, mass = self._parameters, float(self.dt.value), self._mass_times_v
        u, u_n, v, a_n = (f.x.array for f in (self.u, self.u_n, self.v, self.a))
        a_n = a_n.copy()
        a = self._newmark(u, u_n, v, a_n, dt)
        momentum = mass.momentum().ravel()
        n = len(momentum)
        rate = self._momentum_of(((1 - p.alpha_m) * a + p.alpha_m * a_n)[:n])
        before = v[:n] @ momentum
        v += dt * ((1 - p.gamma) * a_n + p.gamma * a)
        after = v[:n] @ mass.momentum().ravel()
        self.a.x.array[:] = a
        return float((after - before) / 2 - rate @ (u - u_n)[:n])

    def serialize(self, archive: Archive, ids: GlobalInts) -> None:
        """Serialize the acceleration too, see `Rates.serialize`."""
        super().serialize(archive, ids)
        serialize_nodal(archive, "a", self.a, ids)
        self._known = archive.same("a_is_known", self._known)
