"""Loads that users give as UFL forms."""

from collections.abc import Callable
from inspect import signature
from typing import Any

import ufl
from dolfinx import fem

from dolfinx_nts.common.arguments import as_call
from dolfinx_nts.common.symbols import Symbol, call_with_symbols
from dolfinx_nts.model.loads.load import Load
from dolfinx_nts.parallel.errors import agreed

__all__ = ["FormLoad"]


class FormLoad(Load):
    r"""A load given as a UFL form, such as a spring or a follower force. Collective.

    The sign is as on the right-hand side of a DOLFINx problem: ``inner(f, eta) * dx`` is a force
    along f. ``update`` of the stepper may set functions and constants in the form; it is also
    called for the time of the load. The load may act on all bodies. In an axisymmetric mesh the
    form must include the factor 2 pi x[0].

    Args:
        V: Space of the displacement.
        work: Form that is linear in the test function of V; or a function ``work(u, eta, t)``
            that returns it. Its arguments are the displacement in the middle of a step (at its end
            in `QuasiStatic` and `CentralDifference`, in between in `GeneralizedAlpha`), a test
            function, and the time of the load, a ``fem.Constant`` [s]. UFL derives the tangent.

    Attributes:
        V: The space.

    Raises:
        TypeError: ``work`` is not a form and does not return one, or converts its time to a number.
        ValueError: The form is not linear in the test function of V.

    Example:
        >>> springs = lambda u, eta, t: -200.0 * ufl.inner(u, eta) * ufl.ds  # N/m^3
        >>> load = nts.FormLoad(V, springs)
    """

    def __init__(self, V: fem.FunctionSpace, work: ufl.Form | Callable[..., ufl.Form]) -> None:
        self.V, self._work = V, work
        self._t = _Time(V.mesh, 0.0)
        u = fem.Function(V)
        with agreed(V.mesh.comm, "make a FormLoad"):
            form: Any = self.form(u, u)
        if not isinstance(form, ufl.Form):
            raise TypeError(f"expected a form of virtual work, given {type(form).__name__}")
        try:
            spaces = [argument.ufl_function_space() for argument in form.arguments()]
        except ValueError as error:
            raise ValueError(f"expected a form linear in one test function, {error}") from error
        if len(spaces) != 1 or spaces[0] != V:
            raise ValueError(
                "expected a form linear in the test function of the bodies' space, "
                f"given one with {len(spaces)} arguments"
            )

    def __repr__(self) -> str:
        """Name of the function, or of the class of the form. Local."""
        return as_call(self, work=self._work)

    def update(self, t: float) -> None:
        self._t.value = t

    def given(self, form: ufl.Form) -> list[Any]:
        return [value for value in super().given(form) if value is not self._t]

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        # Forms are callable, so test for them first.
        if isinstance(self._work, ufl.Form) or not callable(self._work):
            return self._work
        arguments = (u_n + u) / 2, ufl.TestFunction(self.V), self._t
        try:
            signature(self._work).bind(*arguments)
        except TypeError as error:
            raise TypeError(f"expected a function work(u, eta, t), {error}") from None
        return call_with_symbols("a virtual work", self._work, *arguments, symbol=self._t)


class _Time(fem.Constant, Symbol):  # type: ignore[misc]
    @fem.Constant.value.getter  # type: ignore[misc]
    def value(self) -> Any:
        self.was_taken = True
        return self._cpp_object.value
