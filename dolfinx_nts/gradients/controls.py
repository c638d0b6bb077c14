"""Controls of a gradient: numbers and fields on which a run depends."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from ufl.algorithms import expand_derivatives

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.jit import assembled, compile_form
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined

__all__ = ["Control", "FormDerivative", "InitialControl", "ParameterControl", "control_of"]


class FormDerivative:
    """Derivative of forms with respect to a Constant or a Function. Collective.

    Args:
        mesh: The mesh.
        forms: Forms without or with a test function, with derivatives applied.
        control: The Constant or Function.
        names: Objects that represent it in the forms: itself and a copy.
    """

    def __init__(
        self, mesh: Mesh, forms: Sequence[ufl.Form], control: Any, names: Sequence[Any]
    ) -> None:
        self._control, self._comm = control, mesh.comm
        self.is_constant = isinstance(control, fem.Constant)
        self._direction: Any
        if self.is_constant:
            direction = self._direction = fem.Constant(mesh, np.zeros_like(control.value))
            pairs = [(form, name) for form in forms for name in names]
            found = [_by_constant(form, name, mesh, direction) for form, name in pairs]
        else:
            W = control.function_space
            self._direction = fem.Function(W)
            has_test = any(form.arguments() for form in forms)
            direction = self._direction if has_test else ufl.TestFunction(W)
            found = [ufl.derivative(form, name, direction) for form in forms for name in names]
        kept = [form for form in map(expand_derivatives, found) if not form.empty()]
        self._forms = [compile_form(form) for form in kept]

    @property
    def exists(self) -> bool:
        """Whether any of the forms depends on the control. Local."""
        return len(self._forms) > 0

    def along(self, values: Floats) -> Floats | float:
        """Derivative of linear forms along a change of the control, at the owned dofs."""
        if self.is_constant:
            self._direction.value[...] = values.reshape(self._direction.value.shape)
        else:
            _assign(self._direction, values)
        return sum((assembled(form) for form in self._forms), 0.0)

    def gradient(self) -> Floats:
        """Gradient of functionals with respect to all values of the control."""
        if not self.is_constant:
            owned = _num_owned(self._control.function_space)
            return _gathered(
                self._control, sum((assembled(form) for form in self._forms), np.zeros(owned))
            )
        values = self._direction.value.reshape(-1)
        gradient = np.zeros(values.size)
        for i in range(values.size):
            values[:] = np.arange(values.size) == i
            gradient[i] = sum(map(fem.assemble_scalar, self._forms))
        total: Floats = reductions.total(self._comm, gradient)
        return total


def _by_constant(form: ufl.Form, constant: Any, mesh: Mesh, direction: Any) -> ufl.Form:
    """Derivative of a form with respect to a Constant; the direction is a Constant, too.

    UFL differentiates with respect to Functions only, so a Function replaces the Constant.
    """
    if constant not in form.constants():
        return ufl.Form([])
    stand_in = fem.Function(fem.functionspace(mesh, ("DG", 0, constant.ufl_shape)))
    derivative = ufl.derivative(ufl.replace(form, {constant: stand_in}), stand_in, direction)
    return ufl.replace(expand_derivatives(derivative), {stand_in: constant})


class Control(ABC):
    """Values on which a run depends. Collective, as are its methods.

    Attributes:
        size: Number of values on all ranks.
    """

    size: int

    @abstractmethod
    def get(self) -> Floats:
        """Current values, the same on all ranks, shape ``(size,)``."""

    @abstractmethod
    def set(self, values: Floats) -> None:
        """Set the values, shape ``(size,)``."""


class ParameterControl(Control):
    """A Constant or Function in a material, a density, a load, a support or an objective.

    Args:
        value: The Constant or Function.
        name: Its name in messages.
    """

    def __init__(self, value: fem.Constant | fem.Function, name: str = "a control") -> None:
        self.value, self.name = value, name
        is_constant = isinstance(value, fem.Constant)
        self.size = value.value.size if is_constant else _size(value.function_space)

    def get(self) -> Floats:
        value = self.value
        if isinstance(value, fem.Constant):
            numbers: Floats = np.array(value.value, dtype=float).ravel()
            return numbers
        return _gathered(value, value.x.array[: _num_owned(value.function_space)])

    def holds(self, values: Floats) -> bool:
        """Whether the control has the given values, shape ``(size,)``. Local."""
        value = self.value
        if isinstance(value, fem.Constant):
            return np.array_equal(value.value.ravel(), values)
        own = value.x.array[: _num_owned(value.function_space)]
        return np.array_equal(own, _owned_values(value, values))

    def set(self, values: Floats) -> None:
        if isinstance(self.value, fem.Constant):
            self.value.value[...] = values.reshape(self.value.value.shape)
        else:
            _assign(self.value, values)


class InitialControl(Control):
    """Displacement or velocity at the start of the run.

    Args:
        function: ``u`` or ``v`` of the stepper.
        stepper: The stepper.
    """

    def __init__(self, function: fem.Function, stepper: Any) -> None:
        self._stepper, self.function = stepper, function
        self.size = _size(function.function_space)
        self.is_velocity = function is stepper.v
        self._given = fem.Function(function.function_space)

    def get(self) -> Floats:
        return self.gathered(self.function.x.array[: _num_owned(self.function.function_space)])

    def set(self, values: Floats) -> None:
        _assign(self._given, values)
        stepper = self._stepper
        assign = stepper.set_velocity if self.is_velocity else stepper.set_displacement
        for body in stepper.bodies:
            assign(body, self._given)

    def gathered(self, values: Floats) -> Floats:
        """Values of all ranks, from values at the owned dofs. Collective."""
        return _gathered(self.function, values)

    def owned(self, values: Floats) -> Floats:
        """Part of values of all ranks at the owned dofs. Local."""
        return _owned_values(self.function, values)


def control_of(value: Any, stepper: Any, place: str) -> Control:
    """Control for a Constant or Function in the list of a user. Local.

    Args:
        value: The Constant or Function.
        stepper: The stepper.
        place: Its place in the list, for messages.

    Raises:
        TypeError: It is neither a Constant nor a Function.
    """
    if value is stepper.u or value is stepper.v:
        return InitialControl(value, stepper)
    if isinstance(value, fem.Constant | fem.Function):
        return ParameterControl(
            value, f"{place} a {type(value).__name__} of shape {value.ufl_shape}"
        )
    raise TypeError(
        "expected as control a fem.Constant or fem.Function in a material, load, support, law of "
        f"friction or objective, or stepper.u or stepper.v for the initial state, given {value!r}"
    )


def _size(V: fem.FunctionSpace) -> int:
    return int(V.dofmap.index_map.size_global * V.dofmap.index_map_bs)


def _num_owned(V: fem.FunctionSpace) -> int:
    return int(V.dofmap.index_map.size_local * V.dofmap.index_map_bs)


def _gathered(function: fem.Function, owned: Floats) -> Floats:
    """Values of all ranks, in the order of the ranks, from values at the owned dofs."""
    values: Floats = joined(function.function_space.mesh.comm, owned.ravel().copy())
    return values


def _owned_values(function: fem.Function, values: Floats) -> Floats:
    """Values at the owned dofs, from values of all ranks. Local."""
    V = function.function_space
    start = V.dofmap.index_map.local_range[0] * V.dofmap.index_map_bs
    return values[start : start + _num_owned(V)]


def _assign(function: fem.Function, values: Floats) -> None:
    function.x.array[: _num_owned(function.function_space)] = _owned_values(function, values)
    function.x.scatter_forward()
