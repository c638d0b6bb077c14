"""Derivative of the acceleration that the first step of a run computes."""

from collections.abc import Sequence

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.gradients.controls import FormDerivative, ParameterControl
from dolfinx_nts.gradients.step_derivative import MotionState, StepRecord
from dolfinx_nts.integrators.implicit.generalized_alpha import NewmarkRates
from dolfinx_nts.integrators.implicit.implicit_stepper import StepEquations
from dolfinx_nts.integrators.rates import ConsistentMass, Rates
from dolfinx_nts.solvers.nodal_sum import NodalSum

__all__ = ["StartDerivative", "start_derivative"]


class StartDerivative:
    """Derivative of the acceleration at the start, from M a = f. Collective, as are its methods.

    Args:
        equations: Equations of the steps.
        rates: Rates of the stepper.
        controls: Parameters of the forms.
    """

    def __init__(
        self, equations: StepEquations, rates: NewmarkRates, controls: Sequence[ParameterControl]
    ) -> None:
        self._equations, self._rates, bulk = equations, rates, equations.bulk
        V, self._size = rates.u.function_space, bulk.num_owned
        self._mass = ConsistentMass(equations.bodies, fem.Function(V))
        # Forces without motion in the step. Their inertia contains a velocity in place of the
        # acceleration.
        forms = [ufl.replace(form, {rates.u: rates.u_n}) for form in bulk.forms]
        self._change, self._costate = fem.Function(V), fem.Function(V)
        actions = [ufl.action(form, self._costate) for form in forms]
        eta = ufl.TestFunction(V)
        self._along = self._sum(forms, self._change)
        self._transposed = self._sum(actions, eta)
        self._of_controls = []
        for control in controls:
            value = control.value
            names = equations.in_forms(value)
            both = (FormDerivative(V.mesh, each, value, names) for each in (forms, actions))
            self._of_controls.append(tuple(both))

    def _sum(self, forms: Sequence[ufl.Form], direction: fem.Function) -> NodalSum:
        """Sum of the derivatives of forms with respect to the displacement at the start."""
        V, u_n = self._rates.u.function_space, self._rates.u_n
        return NodalSum([expand_derivatives(ufl.derivative(f, u_n, direction)) for f in forms], V)

    def _take(self, step: StepRecord) -> None:
        """Set functions and data to the start of the first step."""
        rates, p = self._rates, self._rates.parameters
        self._equations.set_start(step.t_n, step.dt)
        factor = -p.beta * step.dt / (1 - p.alpha_m)
        rates.u_n.x.array[:] = rates.u.x.array[:] = step.start.u
        rates.v.x.array[:], rates.a.x.array[:] = factor * step.start.rates[1], 0.0

    def _solved(self, force: Floats) -> Floats:
        """Acceleration due to a force, both ``(n, d)``; 0 at prescribed displacements."""
        free = ~self._equations.bulk.is_prescribed
        return self._mass.solve(force.ravel(), lambda r: free * r).reshape(force.shape)

    def _set(self, function: fem.Function, values: Floats) -> None:
        function.x.array[: self._size] = values.ravel()
        function.x.scatter_forward()

    def tangent(
        self, step: StepRecord, start: MotionState, changes: Sequence[Floats]
    ) -> MotionState:
        """Perturbation of the start, including the acceleration, see `StepDerivative.tangent`."""
        self._take(step)
        self._set(self._change, start.u)
        force = self._along.assembled().reshape(start.u.shape)
        for (forms, _), change in zip(self._of_controls, changes, strict=True):
            force += np.reshape(forms.along(change), force.shape) if forms.exists else 0.0
        v, _, mean = start.rates
        return start._replace(rates=[v, self._solved(-force), mean])

    def adjoint(
        self, step: StepRecord, start: MotionState, gradients: Sequence[Floats]
    ) -> MotionState:
        """Costate of the start without the acceleration, see `StepDerivative.adjoint`."""
        self._take(step)
        self._set(self._costate, self._solved(start.rates[1]))
        for (_, forms), gradient in zip(self._of_controls, gradients, strict=True):
            if forms.exists:
                gradient -= forms.gradient()
        u = start.u - self._transposed.assembled().reshape(start.u.shape)
        return start._replace(u=u)


def start_derivative(
    equations: StepEquations, controls: Sequence[ParameterControl]
) -> StartDerivative | None:
    """Derivative of the start, None if the rates of the scheme need none. Collective."""
    rates: Rates = equations.rates
    return StartDerivative(equations, rates, controls) if isinstance(rates, NewmarkRates) else None
