"""Forms of an implicit step: the balance of momentum, its tangent, and damping."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import ufl
from dolfinx import fem

from dolfinx_nts.fem.components import deformation_gradient, gradient
from dolfinx_nts.integrators.inelastic.memory import Memory
from dolfinx_nts.integrators.rates import Rates
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.model.bodies import Body, bulk_form

__all__ = ["StepForms"]


class StepForms:
    """Forms of virtual work in a step from u_n to u. Local.

    Args:
        bodies: Bodies of one space.
        rates: Displacements, acceleration, and length of the step.
        scheme: Scheme, which defines the stress of a step.
        memory: Internal variables of materials, or None.
        inertia: Whether forms include inertia and mass damping. Without them, `dissipation` only
            contains materials with internal variables.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        rates: Rates,
        scheme: Scheme,
        memory: Memory | None = None,
        *,
        inertia: bool = True,
    ) -> None:
        self._bodies, self._scheme, self._memory = bodies, scheme, memory
        self._acceleration = rates.acceleration if inertia else None
        self._moves = rates.acceleration is not None
        self._u_n, self._u, self._dt = rates.u_n, rates.u, rates.dt
        self._F_n, self._F = map(deformation_gradient, (rates.u_n, rates.u))

    def residual(self) -> ufl.Form:
        """Balance of momentum without loads and contact, linear in a test function [J]."""
        remembered = None if self._memory is None else self._memory.work
        return self._balance(remembered, is_damped=self._moves)

    def undamped_residual(self) -> ufl.Form:
        """Residual without stiffness damping."""
        return self._balance(None if self._memory is None else self._memory.work)

    def elastic_residual(self) -> ufl.Form:
        """Residual with internal variables frozen at the end of the step."""
        return self._balance(None if self._memory is None else self._memory.elastic_work)

    def _balance(
        self, remembered: Callable[..., Any] | None, *, is_damped: bool = False
    ) -> ufl.Form:
        """Balance of momentum, including materials with internal variables."""
        eta = ufl.TestFunction(self._u.function_space)

        def integrand(material: Hyperelastic, parameters: dict[str, Any], rho: Any) -> Any:
            P = self._scheme.stress(material, parameters, self._F_n, self._F)
            work = ufl.inner(P, gradient(eta))
            if self._acceleration is not None:
                work += rho * ufl.inner(self._acceleration, eta)
                work += self._mass_damping(material, rho, eta)
            if is_damped:
                work += self._stiffness_damping(material, parameters, eta)
            return work

        if remembered is None:
            return bulk_form(self._bodies, integrand)
        return bulk_form(self._bodies, integrand, partial(remembered, eta=eta))

    @property
    def has_stiffness_damping(self) -> bool:
        """Whether any body has stiffness damping. Local."""
        return any(body.material.stiffness_damping > 0 for body in self._bodies)

    def stiffness_damping(self, *, factor: float = 1.0, power: int = 1) -> ufl.Form:
        """Virtual work of stiffness damping alone [J].

        Args:
            factor: Factor of the coefficient below [-].
            power: Exponent p; the coefficient beta/dt is replaced by factor (beta/dt)^p.
        """
        eta = ufl.TestFunction(self._u.function_space)
        bodies = [body for body in self._bodies if body.material.stiffness_damping > 0]

        def integrand(material: Hyperelastic, parameters: dict[str, Any], rho: Any) -> Any:
            return self._stiffness_damping(material, parameters, eta, factor, power)

        return bulk_form(bodies, integrand)

    def nearby_tangent(self) -> ufl.Form:
        """Tangent at u_n without initial stress, with the moduli at C = 1, for preconditioners.

        It is always positive definite. The exact tangent of compressed cells, or far from
        equilibrium, may be indefinite, and incomplete factorisations may then fail.
        """
        V, dt = self._u.function_space, self._dt
        eta, du = ufl.TestFunction(V), ufl.TrialFunction(V)
        F_n, G = self._F_n, gradient(du)

        def integrand(material: Hyperelastic, parameters: dict[str, Any], rho: Any) -> Any:
            share = self._scheme.stress_share
            if self._moves:
                share += material.stiffness_damping / dt
            P = share * _nearby_stress(material, parameters, F_n, G)
            work = ufl.inner(P, gradient(eta))
            if self._acceleration is not None:
                rate = ufl.derivative(self._acceleration, self._u, du)
                rate += material.mass_damping / dt * du
                work += rho * ufl.inner(rate, eta)
            return work

        if self._memory is None:
            return bulk_form(self._bodies, integrand)
        stiffness = self._memory.stiffness

        def remembered(material: Hyperelastic, parameters: dict[str, Any]) -> Any:
            P = F_n * stiffness(material, parameters, ufl.sym(F_n.T * G))
            return ufl.inner(P, gradient(eta))

        return bulk_form(self._bodies, integrand, remembered)

    def dissipation(self) -> ufl.Form | None:
        """Energy dissipated by damping and internal variables in the step [J], or None."""
        moves, memory = self._acceleration is not None, self._memory
        remembers = memory is not None
        laws = [(body, body.material) for body in self._bodies]
        some = [b for b, law in laws if (moves and law.is_damped) or (remembers and law.remembers)]
        if not some:
            return None

        def integrand(material: Hyperelastic, parameters: dict[str, Any], rho: Any) -> Any:
            eta = self._u - self._u_n
            if not moves:
                return 0
            work = self._mass_damping(material, rho, eta)
            return work + self._stiffness_damping(material, parameters, eta)

        return bulk_form(some, integrand, None if memory is None else memory.dissipation)

    def _mass_damping(self, material: Hyperelastic, rho: Any, eta: Any) -> Any:
        """Virtual work of mass damping per reference volume; >= 0 for eta = u - u_n."""
        if not material.mass_damping > 0:
            return 0
        alpha = fem.Constant(self._u.function_space.mesh, material.mass_damping)
        return alpha * rho / self._dt * ufl.inner(self._u - self._u_n, eta)

    def _stiffness_damping(
        self,
        material: Hyperelastic,
        parameters: Any,
        eta: Any,
        factor: float = 1.0,
        power: int = 1,
    ) -> Any:
        if not material.stiffness_damping > 0:
            return 0
        mesh, F_n, F = self._u.function_space.mesh, self._F_n, self._F
        beta = fem.Constant(mesh, material.stiffness_damping)
        strain = (right_cauchy_green(F) - right_cauchy_green(F_n)) / 2
        P = (F_n + F) / 2 * material.linear_stress(strain, **parameters)
        return factor * (beta / self._dt) ** power * ufl.inner(P, gradient(eta))


def _nearby_stress(material: Hyperelastic, parameters: dict[str, Any], F: Any, G: Any) -> Any:
    """Linearised stress for a gradient G with the moduli at C = 1.

    For materials with internal variables the moduli act in the current configuration.
    """
    if not material.remembered_terms:
        return F * material.linear_stress(ufl.sym(F.T * G), **parameters)
    F_inv = ufl.inv(F)
    return material.linear_stress(ufl.sym(G * F_inv), **parameters) * F_inv.T
