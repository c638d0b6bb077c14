"""Loads that users write as forms: sources, springs, followers."""

from collections.abc import Callable
from typing import Any

import ufl
from dolfinx import fem

from dolfinx_nts.loads import Load

__all__ = ["FormLoad"]


class FormLoad(Load):
    r"""A load given by the form of its virtual work.

    As on the right-hand side of a DOLFINx problem, ``inner(f, eta) * dx``
    pushes along f. Functions and constants in it may be set by ``update``
    of the stepper. Its work in a step, the form at :math:`u_{n+1} - u_n`,
    is in the ledger with that of the other loads.

    Args:
        V: Space of the displacement.
        work: Form, linear in the test function of V; or function
            ``work(u, eta, t)`` that returns it for a displacement
            (in the middle of a step; at its end in `QuasiStatic`, where
            it is in `CentralDifference`), a test function, and the time
            there, a `fem.Constant` [s]. The derivative by u is taken
            care of.

    Attributes:
        V: The space.

    Raises:
        TypeError: ``work`` is, or returns, no form.
        ValueError: The form is on another mesh, or not linear in the test
            function of V.
    """

    def __init__(self, V: fem.FunctionSpace, work: ufl.Form | Callable[..., ufl.Form]) -> None:
        """Check the form, a function at rest."""
        self.V, self._work = V, work
        self._t = fem.Constant(V.mesh, 0.0)
        u = fem.Function(V)
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

    def update(self, t: float) -> None:
        """Set the time, see `Load.update`."""
        self._t.value = t

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        """Virtual work in a step, see `Load.form`."""
        # Forms are callable too, with other arguments.
        if isinstance(self._work, ufl.Form) or not callable(self._work):
            return self._work
        return self._work((u_n + u) / 2, ufl.TestFunction(self.V), self._t)
