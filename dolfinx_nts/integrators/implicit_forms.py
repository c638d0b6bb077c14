"""Forms of an implicit step: the balance of momentum, its tangent, and damping."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import ufl
from dolfinx import fem

from dolfinx_nts.fem.components import deformation_gradient, gradient
from dolfinx_nts.integrators.memory import Memory
from dolfinx_nts.integrators.rates import Rates
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.model.bodies import Body, bulk_form

__all__ = ["StepForms"]


class StepForms:
    """Makes the forms of a step from u_n to u, whose value is virtual work in the step. Local.

    Args:
        bodies: Bodies of one space.
        rates: Displacements, acceleration, and length of the step.
        scheme: Gives the stress of a step.
        memory: Memory of materials; None where no material has any.
        inertia: Whether forms have the inertia, and with it damping.
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
        """Build the deformation gradients at both ends of the step."""
        self._bodies, self._scheme, self._memory = bodies, scheme, memory
        self._acceleration = rates.acceleration if inertia else None
        self._u_n, self._u, self._dt = rates.u_n, rates.u, rates.dt
        self._F_n, self._F = map(deformation_gradient, (rates.u_n, rates.u))

    def residual(self) -> ufl.Form:
        """Balance of momentum without loads and contact, linear in a test function [J]."""
        return self._balance(None if self._memory is None else self._memory.work)

    def elastic_residual(self) -> ufl.Form:
        """The same while materials keep the memory that they have at the end of a step."""
        return self._balance(None if self._memory is None else self._memory.elastic_work)

    def _balance(self, remembered: Callable[..., Any] | None) -> ufl.Form:
        """Balance of momentum with what materials add to the stress, by their memory."""
        eta = ufl.TestFunction(self._u.function_space)

        def integrand(material: Hyperelastic, parameters: dict[str, Any], rho: Any) -> Any:
            P = self._scheme.stress(material, parameters, self._F_n, self._F)
            work = ufl.inner(P, gradient(eta))
            if self._acceleration is not None:
                work += rho * ufl.inner(self._acceleration, eta)
                work += self._damping(material, parameters, rho, eta)
            return work

        if remembered is None:
            return bulk_form(self._bodies, integrand)
        return bulk_form(self._bodies, integrand, partial(remembered, eta=eta))

    def nearby_tangent(self) -> ufl.Form:
        """Tangent at u_n without initial stress, with the moduli at C = 1, for preconditioners.

        It is always definite. Cells that are pressed or far from balance make the exact tangent
        indefinite, which spoils incomplete factorisations.
        """
        V, dt = self._u.function_space, self._dt
        eta, du = ufl.TestFunction(V), ufl.TrialFunction(V)
        F_n, G = self._F_n, gradient(du)

        def integrand(material: Hyperelastic, parameters: dict[str, Any], rho: Any) -> Any:
            share = self._scheme.stress_share
            if self._acceleration is not None:
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
        """Energy that damping and materials with a memory take in the step [J], or None."""
        moves, memory = self._acceleration is not None, self._memory
        remembers = memory is not None
        laws = [(body, body.material) for body in self._bodies]
        some = [b for b, law in laws if (moves and law.is_damped) or (remembers and law.remembers)]
        if not some:
            return None

        def integrand(material: Hyperelastic, parameters: dict[str, Any], rho: Any) -> Any:
            eta = self._u - self._u_n
            return self._damping(material, parameters, rho, eta) if moves else 0

        return bulk_form(some, integrand, None if memory is None else memory.dissipation)

    def _damping(self, material: Hyperelastic, parameters: Any, rho: Any, eta: Any) -> Any:
        """Virtual work of damping per reference volume, which is >= 0 for u - u_n."""
        u, u_n, dt = self._u, self._u_n, self._dt
        mesh, work = u.function_space.mesh, 0
        if material.mass_damping > 0:
            alpha = fem.Constant(mesh, material.mass_damping)
            work += alpha * rho / dt * ufl.inner(u - u_n, eta)
        if material.stiffness_damping > 0:
            beta = fem.Constant(mesh, material.stiffness_damping)
            F_n, F = self._F_n, self._F
            strain = (right_cauchy_green(F) - right_cauchy_green(F_n)) / 2
            P = (F_n + F) / 2 * material.linear_stress(strain, **parameters)
            work += beta / dt * ufl.inner(P, gradient(eta))
        return work


def _nearby_stress(material: Hyperelastic, parameters: dict[str, Any], F: Any, G: Any) -> Any:
    """Stress of a gradient G by the moduli at C = 1; of what flows those of space, as it is now."""
    if not material.remembered_terms:
        return F * material.linear_stress(ufl.sym(F.T * G), **parameters)
    F_inv = ufl.inv(F)
    return material.linear_stress(ufl.sym(G * F_inv), **parameters) * F_inv.T
