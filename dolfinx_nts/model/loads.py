r"""Loads on bodies, written as forms of virtual work.

The form of a load is linear in the test function. Its value at u_{n+1} - u_n is the work of the
load in a step, which the energy ledger counts. A value that is a function of time is taken once
per step, at the time that the integrator chooses: the middle of the step, its end in
`QuasiStatic` and `CentralDifference`, and :math:`t_{n+1-\alpha_f}` in `GeneralizedAlpha`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arguments import as_call, instances, real_array
from dolfinx_nts.fem.axisymmetry import is_axisymmetric, of_rings
from dolfinx_nts.fem.components import deformation_gradient, dimension, gradient
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.errors import agreed

__all__ = [
    "BodyForce",
    "FormLoad",
    "Gravity",
    "Load",
    "LoadOnBody",
    "LoadWithValue",
    "Pressure",
    "Traction",
]


class Load(ABC):
    """Base of all loads; a load of your own derives from it or is a `FormLoad`.

    A stepper takes the form once, when it is made, and calls `update` in every step. Local,
    except where a method says otherwise.

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
        """What tables call the load: its class, and where it acts if that is one place. Local."""
        return type(self).__name__

    @abstractmethod
    def update(self, t: float) -> None:
        """Set the value of the load to that at a time.

        Args:
            t: Time [s].
        """

    @abstractmethod
    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        """Virtual work in a step, linear in the test function [N m].

        Args:
            u_n: Displacement at the start of the step [m]; in `GeneralizedAlpha` both are UFL
                expressions, shifted so that their mean is that at the time of the load.
            u: Displacement at the end of the step [m].

        Returns:
            Form on the reference configuration.
        """

    def acts_on(self, body: Body) -> bool:
        """Whether the load may act on a body, which then never sleeps. Collective.

        A class that does not override this method may act on all bodies.

        Args:
            body: A body in the space of the load.

        Returns:
            The same answer on all ranks.
        """
        return True


class LoadWithValue(Load):
    """A load with a value that is constant, or depends on time or on place.

    Args:
        V: Space of the displacement.
        value: Number or vector, a function of the time [s] that returns it, or a UFL
            expression.

    Raises:
        ValueError: The value has the wrong shape or is not finite.
    """

    # Whether the value is a vector.
    _is_vector: ClassVar[bool] = True

    def __init__(self, V: fem.FunctionSpace, value: Any) -> None:
        """Check shape and value; a function of time is evaluated at 0."""
        self.V = V
        self._shape = self._shape_in(dimension(V))
        self._in_time: Callable[[float], Any] | None = None
        self._value = value
        if isinstance(value, ufl.core.expr.Expr):
            self._check(value.ufl_shape)
        else:
            self._value = fem.Constant(V.mesh, np.zeros(self._shape))
            self._in_time = value if callable(value) else None
            with agreed(V.mesh.comm, f"make a {type(self).__name__}"):
                self._set(value(0.0) if callable(value) else value)

    def _shape_in(self, dim: int) -> tuple[int, ...]:
        """Shape of the value in two or three dimensions."""
        return (dim,) if self._is_vector else ()

    def update(self, t: float) -> None:
        """Set the value to that at a time, if it depends on the time.

        Args:
            t: Time [s].

        Raises:
            ValueError: The value has the wrong shape or is not finite.
        """
        if self._in_time is not None:
            self._set(self._in_time(t))

    def _described(self) -> Any:
        """What ``repr`` tells of the value: the function, the expression or numbers."""
        if self._in_time is not None:
            return self._in_time
        if not isinstance(self._value, fem.Constant):
            return self._value
        return np.array(self._value.value) if self._shape else float(self._value.value)

    def _set(self, value: Any) -> None:
        value = real_array(f"a {type(self).__name__}", value)
        self._check(value.shape)
        if not np.isfinite(value).all():
            raise ValueError(f"expected a finite {type(self).__name__}, given {value}")
        self._value.value = value

    def _check(self, shape: tuple[int, ...]) -> None:
        if shape != self._shape:
            raise ValueError(
                f"expected a {type(self).__name__} of shape {self._shape}, given shape {shape}"
            )


class LoadOnBody(LoadWithValue):
    """Base class of loads on one body. Collective.

    Args:
        body: The body.
        value: As for `LoadWithValue`.
    """

    def __init__(self, body: Body, value: Any) -> None:
        """Check the body and the value."""
        (self._body,) = instances(Body, [body])
        super().__init__(body.V, value)

    @property
    def name(self) -> str:
        """Class and body. Local."""
        return f"{type(self).__name__} {self._body.name}"

    def __repr__(self) -> str:
        """Body and value in one line. Local."""
        return as_call(self, body=self._body, value=self._described())

    def acts_on(self, body: Body) -> bool:
        """Whether the body is the one that was given. Local."""
        return body is self._body


class BodyForce(LoadOnBody):
    """Force per reference volume of a body. Collective.

    Args:
        body: The body.
        value: Force, shape ``(3,)`` [N/m^3], a function of the time [s] that returns it, or a
            UFL expression, also of the reference position.

    Raises:
        TypeError: ``body`` is no body.
        ValueError: The value has the wrong shape or is not finite.

    Example:
        >>> nts.BodyForce(body, (0.0, 0.0, 5.0))  # N/m^3
        BodyForce(body=Body(tag=..., ...), value=(0, 0, 5))
        >>> swinging = nts.BodyForce(body, lambda t: (np.sin(t), 0.0, 0.0))
    """

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        """Virtual work in a step, see `Load.form`."""
        work = ufl.inner(self._value, ufl.TestFunction(self.V))
        # Terms with the density have the quadrature of inertia, so it is divided out.
        one = fem.Constant(self.V.mesh, self._body.material.rho)
        return bulk_form([self._body], lambda material, parameters, rho: rho / one * work)


class Gravity(LoadWithValue):
    """Weight of bodies. Collective.

    Args:
        bodies: The bodies, of one space.
        g: Acceleration, shape ``(3,)`` [m/s^2], a function of the time [s] that returns it, or
            a UFL expression, also of the reference position.

    Raises:
        TypeError: Something in the list is no body.
        ValueError: There are no bodies, or ``g`` has the wrong shape, is not finite, or in an
            axisymmetric mesh is not along the axis.

    Example:
        >>> nts.Gravity([body, other], (0.0, 0.0, -9.81))  # m/s^2
        Gravity(num_bodies=2, g=(0, 0, -9.81))
    """

    def __init__(self, bodies: Sequence[Body], g: Any) -> None:
        """Check the bodies and the acceleration."""
        self._bodies = instances(Body, bodies)
        if not self._bodies:
            raise ValueError("expected at least one Body, given none")
        super().__init__(self._bodies[0].V, g)

    def __repr__(self) -> str:
        """Number of bodies and acceleration [m/s^2] in one line. Local."""
        return as_call(self, num_bodies=len(self._bodies), g=self._described())

    def acts_on(self, body: Body) -> bool:
        """Whether the body is one of those that were given. Local."""
        return body in self._bodies

    def _set(self, value: Any) -> None:
        super()._set(value)
        if is_axisymmetric(self.V.mesh) and self._value.value[0] != 0:
            raise ValueError(
                f"expected Gravity along the axis y of an axisymmetric mesh, given {value}: a "
                "BodyForce may be radial"
            )

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        """Virtual work in a step, see `Load.form`."""
        work = ufl.inner(self._value, ufl.TestFunction(self.V))
        return bulk_form(self._bodies, lambda material, parameters, rho: rho * work)


class _SurfaceLoad(LoadWithValue):
    """A load with a value on a surface.

    Args:
        surface: Where it acts.
        value: As for `LoadWithValue`.
    """

    def __init__(self, surface: Surface, value: Any) -> None:
        """Check the surface and the value."""
        (self._surface,) = instances(Surface, [surface])
        super().__init__(surface.V, value)

    @property
    def name(self) -> str:
        """Class and surface. Local."""
        return f"{type(self).__name__} {self._surface.name}"

    def __repr__(self) -> str:
        """Surface and value [Pa] in one line. Local."""
        return as_call(self, surface=self._surface, value=self._described())

    def acts_on(self, body: Body) -> bool:
        """Whether the surface has a node of the body on any rank. Collective."""
        inside = bool(np.isin(self._surface.nodes, body.nodes).any())
        return reductions.anywhere(self.V.mesh.comm, inside)

    def _integral(self, work: Any) -> ufl.Form:
        """Integral over the surface, by a rule that is exact for a constant pressure."""
        ds = self._surface.measure(Element.of(self.V).mass_degree)
        return of_rings(work, self.V.mesh) * ds


class Traction(_SurfaceLoad):
    """Dead load: a force per reference area that never changes its direction. Collective.

    Args:
        surface: Where it acts.
        value: Force, shape ``(3,)`` [Pa], a function of the time [s] that returns it, or a UFL
            expression, also of the reference position.

    Raises:
        TypeError: ``surface`` is no surface.
        ValueError: The value has the wrong shape or is not finite.

    Example:
        >>> nts.Traction(surface, (0.0, 0.0, -2.5))  # Pa
        Traction(surface=Surface(tag=..., ...), value=(0, 0, -2.5))
    """

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        """Virtual work in a step, see `Load.form`."""
        return self._integral(ufl.inner(self._value, ufl.TestFunction(self.V)))


class Pressure(_SurfaceLoad):
    r"""Follower load: a pressure on the current area along the current normal. Collective.

    The force per reference area is that of the mean of cof F on the straight path of the step,
    :math:`-p \int_0^1 \mathrm{cof} F\,ds\, N = -p\, (\mathrm{cof} F_m + \mathrm{cof} \Delta F /
    12)\, N`, which is exact because cof F is quadratic in s. A constant pressure on the closed
    surface of a cavity does the work :math:`p\,\Delta V` of its volume and has no resultant;
    its moment vanishes only to second order of the step.

    Args:
        surface: Where it acts.
        value: Pressure [Pa], positive against the surface, a function of the time [s] that
            returns it, or a UFL expression.

    Raises:
        TypeError: ``surface`` is no surface.
        ValueError: The value is no number or not finite.

    Example:
        >>> nts.Pressure(surface, 100.0)  # Pa
        Pressure(surface=Surface(tag=..., ...), value=100)
        >>> rising = nts.Pressure(surface, lambda t: 50.0 * t)
    """

    _is_vector = False

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        """Virtual work in a step, see `Load.form`."""
        F_mid, dF = deformation_gradient((u_n + u) / 2), gradient(u - u_n)
        N, eta = ufl.FacetNormal(self.V.mesh), ufl.TestFunction(self.V)
        cofactor = _cofactor(F_mid) + _cofactor(dF) / 12
        # In the plane the normal has two components, and the cofactor of F33 is not needed.
        area = [sum(cofactor[i, j] * N[j] for j in range(len(N))) for i in range(len(N))]
        return self._integral(-self._value * ufl.inner(ufl.as_vector(area), eta))


def _cofactor(A: Any) -> Any:
    """Cofactor of a (3, 3) tensor, also where it is singular."""
    a, b, c = (A[:, i] for i in range(3))
    columns = ufl.cross(b, c), ufl.cross(c, a), ufl.cross(a, b)
    return ufl.as_matrix([[column[i] for column in columns] for i in range(3)])


class FormLoad(Load):
    r"""A load given as a UFL form, such as a spring or a follower force. Collective.

    The sign is that of the right-hand side of a DOLFINx problem, so that ``inner(f, eta) * dx``
    pushes along f. Functions and constants in the form may be set by ``update`` of the stepper.
    The load may act on all bodies. In an axisymmetric mesh the form needs the factor 2 pi x[0]
    itself.

    Args:
        V: Space of the displacement.
        work: Form that is linear in the test function of V; or a function ``work(u, eta, t)``
            that returns it. It gets the displacement in the middle of a step (at its end in
            `QuasiStatic` and `CentralDifference`, between both in `GeneralizedAlpha`), a test
            function, and the time of the load, a ``fem.Constant`` [s]. UFL derives the tangent.

    Attributes:
        V: The space.

    Raises:
        TypeError: ``work`` is no form, or returns none.
        ValueError: The form is not linear in the test function of V.

    Example:
        >>> springs = lambda u, eta, t: -200.0 * ufl.inner(u, eta) * ufl.ds  # N/m^3
        >>> load = nts.FormLoad(V, springs)
    """

    def __init__(self, V: fem.FunctionSpace, work: ufl.Form | Callable[..., ufl.Form]) -> None:
        """Check the form; a function is called at the reference state and time 0."""
        self.V, self._work = V, work
        self._t = fem.Constant(V.mesh, 0.0)
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
        """Name of the function, or that it is a form. Local."""
        return as_call(self, work=self._work)

    def update(self, t: float) -> None:
        """Set the time in the form, see `Load.update`."""
        self._t.value = t

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        """Virtual work in a step, see `Load.form`."""
        # Forms can be called as well, with other arguments.
        if isinstance(self._work, ufl.Form) or not callable(self._work):
            return self._work
        return self._work((u_n + u) / 2, ufl.TestFunction(self.V), self._t)
