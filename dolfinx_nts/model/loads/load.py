r"""Base classes of loads, which are forms of virtual work.

The form of a load is linear in the test function. Its value at u_{n+1} - u_n is the work of the
load in a step, which the energy ledger counts. A value that depends on time, by a function of
time or by ``update`` of the stepper, is evaluated once per step: in the middle of the step, at its
end in `QuasiStatic` and `CentralDifference`, and at :math:`t_{n+1-\alpha_f}` in
`GeneralizedAlpha`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms.analysis import extract_coefficients, extract_constants

from dolfinx_nts.common.arguments import as_call, instances, real_array, with_article
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.parallel.errors import agreed

__all__ = ["Load", "LoadOnBody", "LoadWithValue"]


class Load(ABC):
    """Base class of loads. User-defined loads derive from it or are a `FormLoad`.

    A stepper compiles the form once, and calls `update` in every step. Local, except where a
    method says otherwise.

    Attributes:
        V: Space of the displacement.

    Example:
        >>> load = nts.Gravity([body], (0.0, 0.0, -9.81))  # m/s^2
        >>> isinstance(load, nts.Load), load.acts_on(body), load.acts_on(other)
        (True, True, False)
    """

    V: fem.FunctionSpace

    @property
    def name(self) -> str:
        """Name in tables: the class, and the body or surface if there is one. Local."""
        return type(self).__name__

    @abstractmethod
    def update(self, t: float) -> None:
        """Set the value of the load for a time.

        Args:
            t: Time [s].
        """

    @abstractmethod
    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        """Virtual work in a step, linear in the test function [N m].

        Args:
            u_n: Displacement at the start of the step [m]. With a ``load_point`` of the `Scheme`
                other than 1/2, both arguments are UFL expressions whose mean is the displacement at
                the time of the load.
            u: Displacement at the end of the step [m].

        Returns:
            Form on the reference configuration.
        """

    def given(self, form: ufl.Form) -> list[Any]:
        """Constants and Functions in the form that users may set, by default all. Local.

        Args:
            form: The form as returned by `form`.
        """
        found = [*form.constants(), *form.coefficients()]
        return [value for value in found if isinstance(value, fem.Constant | fem.Function)]

    def acts_on(self, body: Body) -> bool:
        """Whether the load may act on a body. Collective.

        Bodies at rest without contact and loads are left out of a step; a body on which a load may
        act is not. By default a load may act on all bodies.

        Args:
            body: A body in the space of the load.

        Returns:
            The same value on all ranks.
        """
        return True


class LoadWithValue(Load):
    """Load with a value that is constant, or depends on time or position.

    Args:
        V: Space of the displacement.
        value: Number or vector, a function of the time [s] that returns it, or a UFL
            expression.

    Raises:
        ValueError: The value has the wrong shape or is not finite.
    """

    _is_vector: ClassVar[bool] = True

    def __init__(self, V: fem.FunctionSpace, value: Any) -> None:
        self.V = V
        self._shape = self._shape_in(dimension(V))
        self._in_time: Callable[[float], Any] | None = None
        self._value = value
        self._owns_value = not isinstance(value, ufl.core.expr.Expr)
        if not self._owns_value:
            self._check(value.ufl_shape)
        else:
            self._value = fem.Constant(V.mesh, np.zeros(self._shape))
            self._in_time = value if callable(value) else None
            with agreed(V.mesh.comm, f"make {with_article(type(self).__name__)}"):
                self._set(value(0.0) if callable(value) else value)

    def _shape_in(self, dim: int) -> tuple[int, ...]:
        """Shape of the value in two or three dimensions."""
        return (dim,) if self._is_vector else ()

    def update(self, t: float) -> None:
        """Set the value for a time, if it depends on time.

        Args:
            t: Time [s].

        Raises:
            ValueError: The value has the wrong shape or is not finite.
        """
        if self._in_time is not None:
            self._set(self._in_time(t))

    def given(self, form: ufl.Form) -> list[Any]:
        if self._owns_value:
            return []
        of_value = [*extract_constants(self._value), *extract_coefficients(self._value)]
        return [value for value in super().given(form) if value in of_value]

    def _described(self) -> Any:
        """Value as shown by ``repr``: function, expression or numbers."""
        if self._in_time is not None:
            return self._in_time
        if not isinstance(self._value, fem.Constant):
            return self._value
        return np.array(self._value.value) if self._shape else float(self._value.value)

    def _set(self, value: Any) -> None:
        value = real_array(with_article(type(self).__name__), value)
        self._check(value.shape)
        if not np.isfinite(value).all():
            raise ValueError(f"expected a finite {type(self).__name__}, given {value}")
        self._value.value = value

    def _check(self, shape: tuple[int, ...]) -> None:
        if shape != self._shape:
            raise ValueError(
                f"expected {with_article(type(self).__name__)} of shape {self._shape}, given "
                f"shape {shape}"
            )


class LoadOnBody(LoadWithValue):
    """Base class of loads on one body. Collective.

    Args:
        body: The body.
        value: As for `LoadWithValue`.
    """

    def __init__(self, body: Body, value: Any) -> None:
        (self._body,) = instances(Body, [body])
        super().__init__(body.V, value)

    @property
    def name(self) -> str:
        return f"{type(self).__name__} {self._body.name}"

    def __repr__(self) -> str:
        """Constructor call with the body and the value. Local."""
        return as_call(self, body=self._body, value=self._described())

    def acts_on(self, body: Body) -> bool:
        return body is self._body
