"""Derivatives of the balance of momentum of a step, without contact, by UFL."""

from collections.abc import Sequence

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.integrators.rates import Rates
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.nodal_sum import NodalSum

__all__ = ["BulkDerivatives"]


class BulkDerivatives:
    """Products of the derivatives of the residual R with vectors. Collective, as are its methods.

    Nodal vectors have the shape ``(n, d)`` at the owned nodes. All functions have the values of
    the step.

    Args:
        bulk: The residual.
        rates: Displacements of the step.
        carried: Rates at the start of the step.

    Attributes:
        forms: Residual of the bodies, and of each load, linear in the test function.
        adjoint_forms: The forms with `costate` in place of the test function.
        costate: A Function of the space.
    """

    def __init__(self, bulk: Bulk, rates: Rates, carried: Sequence[fem.Function]) -> None:
        self._bulk, V = bulk, rates.u.function_space
        self._dim, self._size = dimension(V), bulk.num_owned
        self.forms = [expand_derivatives(form) for form in bulk.forms]
        self.costate, eta = fem.Function(V), ufl.TestFunction(V)
        self.adjoint_forms = [ufl.action(form, self.costate) for form in self.forms]
        start = [rates.u_n, *carried]
        self._directions = [fem.Function(V) for _ in start]
        self._along = self._sum(self.forms, start, self._directions, V)
        self._of_end = self._sum(self.adjoint_forms, [rates.u], [eta], V)
        self._of_start = [self._sum(self.adjoint_forms, [f], [eta], V) for f in start]

    def _sum(
        self,
        forms: Sequence[ufl.Form],
        functions: Sequence[fem.Function],
        directions: Sequence[object],
        V: fem.FunctionSpace,
    ) -> NodalSum | None:
        """Sum of the derivatives of forms with respect to functions in directions, None if 0."""
        derivatives = []
        for form in forms:
            each = (ufl.derivative(form, *by) for by in zip(functions, directions, strict=True))
            derivatives.append(expand_derivatives(sum(each, ufl.Form([]))))
        return None if derivatives[0].empty() else NodalSum(derivatives, V)

    def along_start(self, directions: Sequence[Floats]) -> Floats:
        """Derivative of R along changes of the displacement and the rates at the start [N]."""
        for function, values in zip(self._directions, directions, strict=True):
            self._set(function, values)
        return self._assembled(self._along)

    def transposed(self, costate: Floats) -> Floats:
        """Product of the transposed tangent with a costate, also at prescribed displacements."""
        self._set(self.costate, costate)
        return self._assembled(self._of_end)

    def transposed_start(self, costate: Floats) -> list[Floats]:
        """Products of the transposed derivatives for displacement and rates at the start."""
        self._set(self.costate, costate)
        return [self._assembled(each) for each in self._of_start]

    def _assembled(self, derivative: NodalSum | None) -> Floats:
        values = np.zeros(self._size) if derivative is None else derivative.assembled()
        return values.reshape(-1, self._dim)

    def _set(self, function: fem.Function, values: Floats) -> None:
        function.x.array[: self._size] = values.ravel()
        function.x.scatter_forward()

    def free(self, values: Floats) -> Floats:
        """Copy with zeros at prescribed displacements. Local."""
        return np.where(self._bulk.is_prescribed.reshape(values.shape), 0.0, values)
