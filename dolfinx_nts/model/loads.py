r"""Loads on bodies: forms of virtual work.

A load is a linear form of virtual work, evaluated once per step, so that its
work in the step is the form at u_{n+1} - u_n. Values that are functions of
time are taken at the middle of the step.

Loads that users write as forms: sources, springs, followers.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arguments import instances
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.model.surfaces import Surface

__all__ = ["BodyForce", "FormLoad", "Gravity", "Load", "LoadWithValue", "Pressure", "Traction"]


class Load(ABC):
    """A load on bodies of one space; use one of the classes below. Local.

    Attributes:
        V: Space of the displacement.
    """

    V: fem.FunctionSpace

    @abstractmethod
    def update(self, t: float) -> None:
        """Take the value at a time.

        Args:
            t: Time [s].
        """

    @abstractmethod
    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        """Virtual work in a step, linear in the test function [N m].

        Args:
            u_n: Displacement at the start of the step [m].
            u: Displacement at its end [m].
        """


class LoadWithValue(Load):
    """A load with its value; use one of the classes below.

    Args:
        V: Space of the displacement.
        value: Number or vector; or function of the time [s] that returns
            it; or UFL expression, of the reference position for instance.

    Attributes:
        V: The space.

    Raises:
        ValueError: The value has the wrong shape or is not finite.
    """

    _shape: ClassVar[tuple[int, ...]] = (3,)

    def __init__(self, V: fem.FunctionSpace, value: Any) -> None:
        """Check the value; a function of time is tried at 0."""
        self.V = V
        self._in_time: Callable[[float], Any] | None = None
        self._value = value
        if isinstance(value, ufl.core.expr.Expr):
            self._check(value.ufl_shape)
        else:
            self._value = fem.Constant(V.mesh, np.zeros(self._shape))
            self._in_time = value if callable(value) else None
            self._set(value(0.0) if callable(value) else value)

    def update(self, t: float) -> None:
        """Take the value at a time; nothing if it does not depend on it.

        Args:
            t: Time [s].

        Raises:
            ValueError: The value has the wrong shape or is not finite.
        """
        if self._in_time is not None:
            self._set(self._in_time(t))

    def _set(self, value: Any) -> None:
        value = np.asarray(value, dtype=np.float64)
        self._check(value.shape)
        if not np.isfinite(value).all():
            raise ValueError(f"expected a finite {type(self).__name__}, given {value}")
        self._value.value = value

    def _check(self, shape: tuple[int, ...]) -> None:
        if shape != self._shape:
            raise ValueError(
                f"expected a {type(self).__name__} of shape {self._shape}, given shape {shape}"
            )


class BodyForce(LoadWithValue):
    """Force per reference volume of a body. Local.

    Args:
        body: The body.
        value: Force, shape ``(3,)`` [N/m^3]; or
            function of the time [s] that returns it; or UFL expression, of
            the reference position for instance.

    Raises:
        TypeError: ``body`` is no body.
        ValueError: The value has the wrong shape or is not finite.
    """

    def __init__(self, body: Body, value: Any) -> None:
        """Check the body and the value."""
        self.bodies = instances(Body, [body])
        super().__init__(body.V, value)

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        """Virtual work in a step, see `Load.form`."""
        work = ufl.inner(self._value, ufl.TestFunction(self.V))
        (body,) = self.bodies
        # The rule of inertia, whose terms have the density.
        one = fem.Constant(self.V.mesh, body.material.rho)
        return bulk_form([body], lambda material, parameters, rho: rho / one * work)


class Gravity(LoadWithValue):
    """Weight of bodies. Local.

    Args:
        bodies: The bodies, of one space.
        g: Acceleration, shape ``(3,)`` [m/s^2]; or
            function of the time [s] that returns it; or UFL expression, of
            the reference position for instance.

    Raises:
        TypeError: Something in the list is no body.
        ValueError: No bodies; ``g`` has the wrong shape or is not finite.
    """

    def __init__(self, bodies: Sequence[Body], g: Any) -> None:
        """Check the bodies and the value."""
        self.bodies = instances(Body, bodies)
        if not self.bodies:
            raise ValueError("expected at least one Body, given none")
        super().__init__(self.bodies[0].V, g)

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        """Virtual work in a step, see `Load.form`."""
        work = ufl.inner(self._value, ufl.TestFunction(self.V))
        return bulk_form(self.bodies, lambda material, parameters, rho: rho * work)


class Traction(LoadWithValue):
    """Force per reference area that keeps its direction (dead load). Local.

    Args:
        surface: Where it acts.
        value: Force, shape ``(3,)`` [Pa]; or
            function of the time [s] that returns it; or UFL expression, of
            the reference position for instance.

    Raises:
        TypeError: ``surface`` is no surface.
        ValueError: The value has the wrong shape or is not finite.
    """

    def __init__(self, surface: Surface, value: Any) -> None:
        """Check the surface and the value."""
        (self.surface,) = instances(Surface, [surface])
        super().__init__(surface.V, value)

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        """Virtual work in a step, see `Load.form`."""
        return ufl.inner(self._value, ufl.TestFunction(self.V)) * _ds(self.surface)


class Pressure(LoadWithValue):
    r"""Pressure on the current area along the current normal (follower). Local.

    The force per reference area is that of the mean of cof F on the
    straight path of the step, :math:`-p \int_0^1 \mathrm{cof} F\,ds\, N =
    -p\, (\mathrm{cof} F_m + \mathrm{cof} \Delta F / 12)\, N`, exact as
    cof F is quadratic: a constant pressure on the closed surface of a
    cavity does the work :math:`p\,\Delta V` of its volume, and has no
    resultant. Its moment vanishes only to second order of the step.

    Args:
        surface: Where it acts.
        value: Pressure, a number [Pa], > 0 against the surface; or
            function of the time [s] that returns it; or UFL expression, of
            the reference position for instance.

    Raises:
        TypeError: ``surface`` is no surface.
        ValueError: The value is no number or not finite.
    """

    _shape = ()

    def __init__(self, surface: Surface, value: Any) -> None:
        """Check the surface and the value."""
        (self.surface,) = instances(Surface, [surface])
        super().__init__(surface.V, value)

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        """Virtual work in a step, see `Load.form`."""
        F_mid, dF = ufl.Identity(3) + ufl.grad(u_n + u) / 2, ufl.grad(u - u_n)
        N = ufl.FacetNormal(self.V.mesh)
        area = _cofactor(F_mid) * N + _cofactor(dF) * N / 12
        return -self._value * ufl.inner(area, ufl.TestFunction(self.V)) * _ds(self.surface)


def _ds(surface: Surface) -> ufl.Measure:
    """Measure of a surface; exact for a constant pressure on it."""
    return surface.measure(Element.of(surface.V).mass_degree)


def _cofactor(A: Any) -> Any:
    """Cofactor of a (3, 3) tensor, also where it is singular."""
    a, b, c = (A[:, i] for i in range(3))
    columns = ufl.cross(b, c), ufl.cross(c, a), ufl.cross(a, b)
    return ufl.as_matrix([[column[i] for column in columns] for i in range(3)])


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
