"""Derivatives of prescribed displacements with respect to controls."""

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
from dolfinx import fem, la

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import Floats, Ints, indices
from dolfinx_nts.contact.friction.limits import coefficients_of
from dolfinx_nts.gradients.controls import ParameterControl
from dolfinx_nts.integrators.implicit.implicit_stepper import StepEquations
from dolfinx_nts.parallel import reductions

__all__ = ["PrescribedDerivative"]

# Change of a Constant in differences of the values that ``update`` sets, relative to the Constant,
# and absolute if the Constant is 0 [-]. Larger: curvature of the prescribed motion in the control;
# smaller: round-off.
_CHANGE = 1e-5


class PrescribedDerivative:
    """Derivative of the displacements of supports in a step with respect to a control. Collective.

    A Function is the value of a condition. A Constant is the value of a condition, or ``update``
    computes such values from it; then they are differentiated by central differences of ``update``.

    Args:
        equations: Equations of the steps.
        control: The Constant or Function.

    Attributes:
        may_act: Whether displacements may depend on the control.
        acts: Whether they have depended on it in a step so far.
    """

    def __init__(self, equations: StepEquations, control: ParameterControl) -> None:
        self._equations, self._control = equations, control
        self._supports, self._size = equations.bulk.supports, equations.bulk.num_owned
        value = control.value
        given = [bc.g is compat.cpp_object(value) for bc in self._supports.conditions]
        self.acts = any(given)
        self.may_act = self.acts or (equations.updates and isinstance(value, fem.Constant))
        # Derivatives of the owned dofs with respect to a Constant, or owned dofs and dofs of a
        # Function that is their value.
        self._rows: Floats = np.zeros((0, self._size))
        self._dofs: Ints = np.empty(0, dtype=np.int32)
        self._sources: Ints = self._dofs
        if self.acts and isinstance(value, fem.Function):
            sources = self._sources_of(value, given)
            self._dofs = indices(sources >= 0)
            self._sources = sources[self._dofs]
        self._others = self._other_data()

    def _sources_of(self, value: fem.Function, given: Sequence[bool]) -> Ints:
        """Dof of a Function that prescribes each owned dof, or -1, shape ``(d n,)``. Local."""
        kept = value.x.array.copy()
        value.x.array[:] = np.arange(len(kept))
        found = np.full(len(self._equations.bulk.u.x.array), np.nan)
        for bc, is_given in zip(self._supports.conditions, given, strict=True):
            each = np.full_like(found, np.nan)
            bc.set(each)
            has = np.isfinite(each)
            found[has] = each[has] if is_given else -1
        value.x.array[:] = kept
        sources: Ints = np.nan_to_num(found, nan=-1)[: self._size].astype(np.int32)
        return sources

    def _other_data(self) -> list[Any]:
        """Data of forms and friction that must not depend on the control. Collective."""
        known = self._equations.in_forms(self._control.value)
        forms, contacts = self._equations.bulk.forms, self._equations.contacts
        of_forms = ((*form.constants(), *form.coefficients()) for form in forms)
        of_friction = (coefficients_of(each.pair.friction, each.pair.nodes) for each in contacts)
        found = dict.fromkeys(chain(*of_forms, *of_friction))
        return [each for each in found if all(each is not one for one in known)]

    def take(self, t_n: float, dt: float) -> None:
        """Compute the derivative in a step of length dt from t_n, both [s].

        The data of the step have to be set again afterwards.

        Raises:
            ValueError: ``update`` computes anything but values of conditions from the control, or
                anything from a Function.
        """
        control, equations = self._control, self._equations
        is_constant = isinstance(control.value, fem.Constant)
        if not (equations.updates or (self.acts and is_constant)):
            return
        values, rows = control.get(), []
        for direction in np.eye(len(values)) if is_constant else np.ones((1, len(values))):
            h = _CHANGE * (np.abs(direction * values).max() or 1.0)
            ends, others = [], []
            for sign in (1, -1):
                control.set(values + sign * h * direction)
                if equations.updates:
                    equations.set_data(t_n, dt)
                ends.append(self._supports.applied(np.zeros_like(equations.bulk.u.x.array)))
                others.append([_array(each).copy() for each in self._others])
            control.set(values)
            both = zip(*others, strict=True)
            rows.append(np.subtract(*ends)[: self._size] / (2 * h))
            is_wrong = not all(np.array_equal(*pair) for pair in both)
            if not is_constant:
                is_wrong |= not np.allclose(rows.pop(), self.along(direction), rtol=1e-6)
            if reductions.anywhere(equations.bulk.comm, is_wrong):
                raise ValueError(
                    "expected update to compute only displacements of bcs from controls, and only "
                    f"from a Constant, given other data computed from {control.name}: a load may "
                    "contain the control itself, as in FormLoad, with a factor that depends on t"
                )
        if is_constant:
            self._rows = np.array(rows)
            self.acts |= reductions.anywhere(equations.bulk.comm, bool(self._rows.any()))

    def along(self, values: Floats) -> Floats:
        """Change of prescribed displacements by a change of the control, ``(d n,)`` [m].

        ``values`` are the change, shape ``(size,)``.
        """
        change = np.zeros(self._size)
        if len(self._rows):
            change += values @ self._rows
        elif self.acts:
            function = fem.Function(self._control.value.function_space)
            ParameterControl(function).set(values)
            change[self._dofs] = function.x.array[self._sources]
        return change

    def gradient(self, costate: Floats) -> Floats:
        """Gradient with respect to the control from the gradient for displacements, ``(d n,)``."""
        if len(self._rows):
            total: Floats = reductions.total(self._equations.bulk.comm, self._rows @ costate)
            return total
        if not self.acts:
            return np.zeros(self._control.size)
        function = fem.Function(self._control.value.function_space)
        np.add.at(function.x.array, self._sources, costate[self._dofs])
        function.x.scatter_reverse(la.InsertMode.add)
        return ParameterControl(function).get()


def _array(value: Any) -> Floats:
    """Values of a Constant or a Function. Local."""
    array: Floats = value.x.array if isinstance(value, fem.Function) else np.asarray(value.value)
    return array
