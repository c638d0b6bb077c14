"""Objectives: sums of UFL functionals of displacement and velocity at the ends of steps."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

from dolfinx_nts.common.arguments import kind_of
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.jit import assembled, compile_form
from dolfinx_nts.gradients.controls import FormDerivative
from dolfinx_nts.parallel import reductions

__all__ = ["Objective", "Term"]


class Term:
    """A functional of the state at the end of a step. Collective, as are its methods.

    Args:
        form: The functional.
        state: Displacement, velocity, and acceleration if it is part of the state.
        parameters: Constants and Functions among the controls.
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
        self.of_parameters = [FormDerivative(mesh, [form], value, [value]) for value in parameters]

    def value(self) -> float:
        """Value in the current state."""
        return float(reductions.total(self._comm, fem.assemble_scalar(self._value)))

    def add_slopes(self, slopes: Sequence[Floats]) -> None:
        """Add derivatives with respect to the functions of the state, each ``(n, d)``."""
        for form, values in zip(self._slopes, slopes, strict=True):
            if form is not None:
                values += assembled(form).reshape(values.shape)


class Objective:
    """Sum of functionals of the states of a run. Collective, as are its methods.

    Args:
        given: A form, which is evaluated at the end of the run; or a function of the time [s] at
            the end of each step that returns a form, or None.
        state: Displacement, velocity, and acceleration if it is part of the state.
        parameters: Constants and Functions among the controls.

    Raises:
        TypeError: ``given`` is neither, or the function returns something else.
        ValueError: A form has a test function.
    """

    def __init__(
        self,
        given: ufl.Form | Callable[[float], ufl.Form | None],
        state: Sequence[fem.Function],
        parameters: Sequence[Any],
    ) -> None:
        # Forms are callable, so test for them first.
        if not (isinstance(given, ufl.Form) or callable(given)):
            raise TypeError(
                "expected as objective a UFL form of stepper.u and stepper.v, or a function of the "
                f"time that returns one or None, given {kind_of(given)}"
            )
        self._given, self._state, self._parameters = given, state, parameters
        self._terms: dict[ufl.Form, Term] = {}

    def term(self, t: float, *, is_end: bool) -> Term | None:
        """Functional of a state, or None.

        Args:
            t: Time of the state [s].
            is_end: Whether it is the end of the run.
        """
        given = self._given
        form: Any = given
        if isinstance(given, ufl.Form):
            form = given if is_end else None
        else:
            form = given(t)
        if form is None:
            return None
        if not isinstance(form, ufl.Form):
            raise TypeError(f"expected a form or None from the objective, given {kind_of(form)}")
        if form.arguments():
            raise ValueError("expected an objective without a test function, given a linear form")
        if form not in self._terms:
            self._terms[form] = Term(form, self._state, self._parameters)
        return self._terms[form]

    def zeros(self) -> list[Floats]:
        """Arrays for the slopes of a term, each ``(n, d)``. Local."""
        V = self._state[0].function_space
        shape = V.dofmap.index_map.size_local, V.dofmap.index_map_bs
        return [np.zeros(shape) for _ in self._state]
