r"""Generalised-alpha method, a dissipative scheme for comparison.

Displacement and velocity follow from the acceleration by Newmark's formulas. The balance of
momentum holds between both ends of a step (J. Chung and G. M. Hulbert, J. Appl. Mech. 60, 1993):

.. math:: M [(1 - \alpha_m) a_{n+1} + \alpha_m a_n]
   + f_{int}(F_{n+1-\alpha_f}) + \sum \lambda_N \nabla g_{n+1} = f_{ext}.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arguments import finite, kind_of, positive
from dolfinx_nts.common.arrays import Floats, GlobalInts
from dolfinx_nts.common.declaration import SetOnce
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.integrators.implicit.implicit_stepper import ImplicitStepper
from dolfinx_nts.integrators.rates import ConsistentMass, Rates
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.integrators.state import State, serialize_nodal
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.loads.load import Load
from dolfinx_nts.solvers.rigid.rigid_motion import RigidMotion

__all__ = ["GeneralizedAlpha", "Newmark", "NewmarkRates"]

# Difference of parameters that counts as round-off [-].
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Newmark:
    """Parameters of the generalised-alpha method and related methods such as HHT.

    Attributes:
        alpha_m: Weight of the start of a step in the inertia [-]; 0 in HHT.
        alpha_f: Weight of the start of a step in stress and loads [-]. A custom `Scheme` has 1 -
            alpha_f as ``stress_share`` and ``load_point``, and uses it in ``stress``.
        beta: Newmark's parameter of the displacement [-].
        gamma: Newmark's parameter of the velocity [-]: 1/2 - alpha_m + alpha_f for second order;
            larger values dissipate, smaller ones gain energy.

    Raises:
        TypeError: A parameter is not a number.
        ValueError: A parameter is not finite, ``beta`` is not positive, ``gamma`` is so small
            that the energy grows, or steps of some length are unstable: ``beta`` is less than
            ``gamma``/2, ``gamma`` less than 1/2, or a weight more than 1/2.

    Example:
        >>> average_acceleration = nts.Newmark(alpha_m=0.0, alpha_f=0.0, beta=0.25, gamma=0.5)
    """

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            finite(name, value)
        positive("beta of Newmark", self.beta)
        least = 0.5 - self.alpha_m + self.alpha_f
        if self.gamma < least - _ROUNDING:
            raise ValueError(
                f"expected gamma of Newmark >= 1/2 - alpha_m + alpha_f = {least:g}, below which "
                f"the energy grows, given {self.gamma:g}"
            )
        if self.beta < self.gamma / 2 - _ROUNDING or self.gamma < 0.5 - _ROUNDING:
            raise ValueError(
                "expected beta of Newmark >= gamma/2 and gamma >= 1/2, as otherwise only short "
                f"steps are stable, given {self.beta:g} and {self.gamma:g}: use larger parameters, "
                "or CentralDifference for short steps"
            )
        if max(self.alpha_m, self.alpha_f) > 0.5 + _ROUNDING:
            raise ValueError(
                "expected alpha_m and alpha_f of Newmark <= 1/2, above which the energy grows, "
                f"given {self.alpha_m:g} and {self.alpha_f:g}"
            )

    @classmethod
    def of(cls, rho_inf: float) -> "Newmark":
        """Optimal parameters of Chung and Hulbert for a spectral radius."""
        alpha_m, alpha_f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
        beta = (1 - alpha_m + alpha_f) ** 2 / 4
        return cls(alpha_m, alpha_f, beta, 0.5 - alpha_m + alpha_f)


class GeneralizedAlpha(ImplicitStepper):
    """Advances bodies by the generalised-alpha method, which damps high frequencies.

    It is of second order in the step and conserves the linear momentum, but neither the energy
    nor the angular momentum. Contact acts at the end of a step: by springs, the default, or by
    ``LagrangeMultiplier("plastic")`` with g = 0, which dissipates the impact energy of nodes.
    Further attributes: see `EnergyMomentum`. Collective, as are all its methods.

    Args:
        bodies: Bodies of one space, which fill the mesh.
        pairs: Contact pairs with `Penalty`, the default, or ``LagrangeMultiplier("plastic")``.
        dt: Length of a step [s].
        rho_inf: Spectral radius at infinite frequency, from 0 (frequencies that the step does not
            resolve vanish in one step) to 1 (no damping).
        bcs: See `EnergyMomentum`.
        loads: Loads on the bodies.
        update: See `EnergyMomentum`.
        petsc_options: See `EnergyMomentum`.

    Attributes:
        rho_inf: The spectral radius.
        a: Acceleration at t [m/s^2], a Function; initially from the balance of momentum, with the
            forces of contact springs, but not of multipliers, which do not follow from a state.

    Raises:
        TypeError: An argument has the wrong type, or a subclass has another ``scheme``.
        ValueError: As in `EnergyMomentum`; or ``rho_inf`` is not in [0, 1], or a pair has
            elastic impact, or multipliers at nodes of rigid bodies.

    Example:
        >>> stepper = nts.GeneralizedAlpha(bodies, dt=0.01, rho_inf=0.5)
        >>> stepper.set_velocity(other, (0.0, 0.0, 1.0))
        >>> stepper.advance().newton_iterations
        0
    """

    rho_inf = SetOnce[float]()
    _rates: "NewmarkRates"

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
        if not 0 <= finite("rho_inf", rho_inf) <= 1:
            raise ValueError(f"expected a spectral radius rho_inf in [0, 1], given {rho_inf}")
        if isinstance(getattr(self, "scheme", None), Scheme):
            raise TypeError(
                f"expected no attribute scheme of {type(self).__name__}, as rho_inf determines "
                "that of GeneralizedAlpha: derive from ImplicitStepper for another scheme"
            )
        parameters = Newmark.of(rho_inf)
        self.scheme = Scheme(
            contact="static",
            stress=partial(_stress, parameters.alpha_f),
            rates=partial(NewmarkRates, parameters),
            stress_share=1 - parameters.alpha_f,
            load_point=1 - parameters.alpha_f,
        )
        super().__init__(
            bodies, pairs, dt=dt, bcs=bcs, loads=loads, update=update, petsc_options=petsc_options
        )
        self.rho_inf, self.a = float(rho_inf), self._rates.a


def _stress(alpha_f: float, material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
    F_m = (1 - alpha_f) * F + alpha_f * F_n
    return F_m * material.stress(right_cauchy_green(F_m), **parameters)


class NewmarkRates(Rates):
    """Newmark's formulas, with the acceleration as part of the state.

    Args:
        parameters: Parameters of the method.
        state: State of the stepper; like ``dt`` and ``bodies``, the stepper passes it.
        dt: Length of a step, a constant [s].
        bodies: The bodies.

    Attributes:
        a: Acceleration at t [m/s^2].
        parameters: The argument.
        is_known: Whether the acceleration belongs to the state; otherwise the next step computes it
            from the balance of momentum.
        force_time: Time of stress and loads, 1 - alpha_f [-].

    Raises:
        TypeError: ``parameters`` is not a `Newmark`.

    Example:
        >>> from functools import partial
        >>> rates = partial(nts.NewmarkRates, nts.Newmark(0.0, 0.1, 0.3025, 0.6))
    """

    def __init__(
        self, parameters: Newmark, state: State, dt: fem.Constant, bodies: Sequence[Body]
    ) -> None:
        if not isinstance(parameters, Newmark):
            raise TypeError(
                "expected rates=partial(NewmarkRates, Newmark(alpha_m, alpha_f, beta, gamma)), "
                f"given {kind_of(parameters)} as parameters"
            )
        self.parameters = p = parameters
        self.force_time = 1 - p.alpha_f
        u_n, u, v = state.u_n, state.u, state.v
        self.a = fem.Function(u.function_space, name="acceleration")
        self._mass_times_a, self._mass_times_v = (ConsistentMass(bodies, f) for f in (self.a, v))
        self.acceleration = (1 - p.alpha_m) * self._newmark(u, u_n, v, self.a, dt)
        self.acceleration += p.alpha_m * self.a
        super().__init__(state, dt, bodies)

    def _newmark(self, u: Any, u_n: Any, v: Any, a: Any, dt: Any) -> Any:
        """Acceleration at the end of a step, for UFL expressions or arrays."""
        beta = self.parameters.beta
        return ((u - u_n) / dt - v) / (beta * dt) - (1 / (2 * beta) - 1) * a

    def forget(self) -> None:
        super().forget()
        self.is_known = False

    def begin(
        self,
        forces: Callable[[], Floats],
        free: Floats | None,
        rigid: RigidMotion,
        is_unchanged: Callable[[], bool],
        prescribed: Callable[[], Floats],
    ) -> None:
        """After the state was set, compute its acceleration from M a = f."""
        if self.is_known:
            return
        p, mass = self.parameters, self._mass_times_a
        # The residual at u = u_n contains an inertia term, which is removed.
        self.a.x.array[:] = 0
        factor = (p.alpha_m - 1) / (p.beta * float(self.dt.value))
        force = factor * self._mass_times_v.momentum().ravel() - forces()
        unknown = np.ones_like(force) if free is None else free.ravel()
        n, d = len(force), rigid.dim

        def projected(r: Floats) -> Floats:
            return rigid.nearest_free((unknown * r).reshape(-1, d)).ravel()

        turning: Floats = np.zeros(n)
        if rigid.exists:
            turning = rigid.centripetal(self.v.x.array[:n].reshape(-1, d)).ravel()
            force -= mass.times(turning)
        mass.times(turning + mass.solve(force, projected))
        self.is_known = True

    def _set_velocity(self) -> float:
        """Set the velocity; returns the energy error of the formulas [J]."""
        p, dt, mass = self.parameters, float(self.dt.value), self._mass_times_v
        u, u_n, v, a_n = (f.x.array for f in (self.u, self.u_n, self.v, self.a))
        a_n = a_n.copy()
        a = self._newmark(u, u_n, v, a_n, dt)
        momentum = mass.momentum().ravel()
        n = len(momentum)
        rate = self._mass_times_a.times(((1 - p.alpha_m) * a + p.alpha_m * a_n)[:n])
        before = v[:n] @ momentum
        v += dt * ((1 - p.gamma) * a_n + p.gamma * a)
        after = v[:n] @ mass.momentum().ravel()
        self.a.x.array[:] = a
        return float((after - before) / 2 - rate @ (u - u_n)[:n])

    def serialize(self, archive: Archive, ids: GlobalInts) -> None:
        super().serialize(archive, ids)
        serialize_nodal(archive, "a", self.a, ids)
        self.is_known = archive.same("a_is_known", self.is_known)
