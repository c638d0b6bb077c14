"""Objectives: sums of functionals of displacement and velocity, and of functions of forces."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives
from ufl.algorithms.analysis import extract_type
from ufl.constantvalue import ConstantValue
from ufl.core.expr import Expr
from ufl.core.multiindex import MultiIndex
from ufl.core.terminal import Terminal

from dolfinx_nts.common.arguments import kind_of
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.jit import assembled, compile_form
from dolfinx_nts.gradients.controls import FormDerivative
from dolfinx_nts.parallel import reductions

__all__ = ["Objective", "Term"]

# Parts of expressions that have a value without a mesh.
_EVALUATED = fem.Constant, ConstantValue, MultiIndex


class Term(ABC):
    """A term of an objective at the end of a step. Collective, as are its methods."""

    @abstractmethod
    def value(self) -> float:
        """Value in the current state."""

    @abstractmethod
    def add_slopes(self, slopes: Sequence[Floats]) -> None:
        """Add derivatives with respect to the functions of the state, each ``(n, d)``."""

    @abstractmethod
    def gradients(self) -> list[Floats | float]:
        """Gradients with respect to the parameters; 0.0 for parameters not in the term."""


class _Functional(Term):
    """A functional of the state.

    Args:
        form: The functional.
        state: Displacement, velocity, and acceleration if it is part of the state.
        parameters: Constants and Functions among the controls, then the forces.
    """

    def __init__(
        self, form: ufl.Form, state: Sequence[fem.Function], parameters: Sequence[Any]
    ) -> None:
        mesh = state[0].function_space.mesh
        self._comm = mesh.comm
        form = expand_derivatives(form)
        self._value = compile_form(form)
        eta = ufl.TestFunction(state[0].function_space)
        slopes = [expand_derivatives(ufl.derivative(form, f, eta)) for f in state]
        self._slopes = [None if slope.empty() else compile_form(slope) for slope in slopes]
        self._of_parameters = [FormDerivative(mesh, [form], value, [value]) for value in parameters]

    def value(self) -> float:
        return float(reductions.total(self._comm, fem.assemble_scalar(self._value)))

    def add_slopes(self, slopes: Sequence[Floats]) -> None:
        for form, values in zip(self._slopes, slopes, strict=True):
            if form is not None:
                values += assembled(form).reshape(values.shape)

    def gradients(self) -> list[Floats | float]:
        return [each.gradient() if each.exists else 0.0 for each in self._of_parameters]


class _Number(Term):
    """A function of forces and Constants, evaluated without integration.

    Args:
        expression: Scalar expression of Constants.
        parameters: Constants and Functions among the controls, then the forces.

    Raises:
        ValueError: It depends on something else, or it is not a scalar.
    """

    def __init__(self, expression: Expr, parameters: Sequence[Any]) -> None:
        terminals = extract_type(expression, Terminal)
        others = [each for each in terminals if not isinstance(each, _EVALUATED)]
        if expression.ufl_shape or others:
            kinds = sorted({kind_of(each) for each in others})
            raise ValueError(
                "expected an objective without integral to be a scalar of forces and Constants, "
                f"given one of shape {expression.ufl_shape}"
                f"{' with ' * bool(kinds)}{' and '.join(kinds)}: integrate fields, as in "
                "field * ufl.dx"
            )
        self._expression = expression
        self._constants = [each for each in terminals if isinstance(each, fem.Constant)]
        self._slopes = [self._components(each) for each in parameters]

    def _components(self, value: Any) -> list[Expr]:
        """Derivatives with respect to the components of a Constant, none if it does not occur."""
        if value not in self._constants:
            return []
        variable = ufl.variable(value)
        replaced = ufl.replace(self._expression, {value: variable})
        slope = expand_derivatives(ufl.diff(replaced, variable))
        shape = slope.ufl_shape
        return [slope[i] for i in np.ndindex(shape)] if shape else [slope]

    def _evaluated(self, expression: Expr) -> float:
        known = {each: each.value if each.ufl_shape else float(each) for each in self._constants}
        return float(expression((), known))

    def value(self) -> float:
        return self._evaluated(self._expression)

    def add_slopes(self, slopes: Sequence[Floats]) -> None:
        """Do nothing: the term depends on the state only through the forces."""

    def gradients(self) -> list[Floats | float]:
        return [np.array([*map(self._evaluated, each)]) if each else 0.0 for each in self._slopes]


class Objective:
    """Sum of functionals of the states of a run. Collective, as are its methods.

    Args:
        given: A form, which is evaluated at the end of the run; or a function of the time [s] at
            the end of each step, and of the forces, that returns a form, a scalar of forces, or
            None.
        state: Displacement, velocity, and acceleration if it is part of the state.
        parameters: Constants and Functions among the controls.
        forces: Constants with the forces of a step.

    Raises:
        TypeError: ``given`` is neither, or the function returns something else.
        ValueError: A form has a test function.
    """

    def __init__(
        self,
        given: ufl.Form | Callable[..., ufl.Form | Expr | None],
        state: Sequence[fem.Function],
        parameters: Sequence[Any],
        forces: Sequence[fem.Constant],
    ) -> None:
        # Forms are callable, so test for them first.
        if not (isinstance(given, ufl.Form) or callable(given)):
            raise TypeError(
                "expected as objective a UFL form of stepper.u and stepper.v, or a function of the "
                f"time that returns one or None, given {kind_of(given)}"
            )
        if forces and isinstance(given, ufl.Form):
            raise TypeError(
                "expected as objective with forces a function of the time and of each force, as in "
                "lambda t, force: force[0] ** 2, given a form"
            )
        self._given, self._state, self._forces = given, state, forces
        self._parameters = [*parameters, *forces]
        self._terms: dict[ufl.Form | Expr, Term] = {}

    def term(self, t: float, *, is_end: bool) -> Term | None:
        """Term of a state, or None.

        Args:
            t: Time of the state [s].
            is_end: Whether it is the end of the run.
        """
        given = self._given
        term: Any = given
        if isinstance(given, ufl.Form):
            term = given if is_end else None
        else:
            term = given(t, *self._forces)
        if term is None:
            return None
        if not isinstance(term, ufl.Form | Expr):
            raise TypeError(
                "expected the objective to return a form, a scalar of the forces or None, given "
                f"{kind_of(term)}"
            )
        if term not in self._terms:
            self._terms[term] = self._new(term)
        return self._terms[term]

    def _new(self, term: ufl.Form | Expr) -> Term:
        if not isinstance(term, ufl.Form):
            return _Number(term, self._parameters)
        if term.arguments():
            raise ValueError("expected an objective without a test function, given a linear form")
        return _Functional(term, self._state, self._parameters)

    def zeros(self) -> list[Floats]:
        """Arrays for the slopes of a term, each ``(n, d)``. Local."""
        V = self._state[0].function_space
        shape = V.dofmap.index_map.size_local, V.dofmap.index_map_bs
        return [np.zeros(shape) for _ in self._state]
