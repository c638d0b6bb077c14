"""Loads on surfaces: dead tractions and follower pressures."""

from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arguments import as_call, instances
from dolfinx_nts.fem.axisymmetry import over_circumference
from dolfinx_nts.fem.components import deformation_gradient, gradient
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.loads.load import LoadWithValue
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["Pressure", "Traction"]


class _SurfaceLoad(LoadWithValue):
    """Load with a value on a surface.

    Args:
        surface: The surface.
        value: As for `LoadWithValue`.
    """

    def __init__(self, surface: Surface, value: Any) -> None:
        (self._surface,) = instances(Surface, [surface])
        super().__init__(surface.V, value)

    @property
    def name(self) -> str:
        return f"{type(self).__name__} {self._surface.name}"

    def __repr__(self) -> str:
        """Constructor call with the surface and the value. Local."""
        return as_call(self, surface=self._surface, value=self._described())

    def acts_on(self, body: Body) -> bool:
        # The surface and the body share a node on any rank.
        inside = bool(np.isin(self._surface.nodes, body.nodes).any())
        return reductions.anywhere(self.V.mesh.comm, inside)

    def _integral(self, work: Any) -> ufl.Form:
        """Integral over the surface by a rule that is exact for a constant pressure."""
        ds = self._surface.measure(Element.of(self.V).mass_degree)
        return over_circumference(work, self.V.mesh) * ds


class Traction(_SurfaceLoad):
    """Dead load: a force per reference area with a fixed direction. Collective.

    Args:
        surface: The surface.
        value: Force, shape ``(3,)`` [Pa], a function of the time [s] that returns it, or a UFL
            expression, also of the reference position.

    Raises:
        TypeError: ``surface`` is not a Surface.
        ValueError: The value has the wrong shape or is not finite.

    Example:
        >>> nts.Traction(surface, (0.0, 0.0, -2.5))  # Pa
        Traction(surface=Surface(tag=..., ...), value=(0, 0, -2.5))
    """

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        return self._integral(ufl.inner(self._value, ufl.TestFunction(self.V)))


class Pressure(_SurfaceLoad):
    r"""Follower load: a pressure on the current area along the current normal. Collective.

    The force per reference area uses the mean of cof F along the straight path of the step,
    :math:`-p \int_0^1 \mathrm{cof} F\,ds\, N = -p\, (\mathrm{cof} F_m + \mathrm{cof} \Delta F /
    12)\, N`. It is exact because cof F is quadratic in s. A constant pressure on the closed
    surface of a cavity does the work :math:`p\,\Delta V` and has no resultant. Its moment vanishes
    to second order in the step only.

    Args:
        surface: The surface.
        value: Pressure [Pa], positive against the surface, a function of the time [s] that
            returns it, or a UFL expression.

    Raises:
        TypeError: ``surface`` is not a Surface.
        ValueError: The value is not a finite number.

    Example:
        >>> nts.Pressure(surface, 100.0)  # Pa
        Pressure(surface=Surface(tag=..., ...), value=100)
        >>> rising = nts.Pressure(surface, lambda t: 50.0 * t)
    """

    _is_vector = False

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        F_mid, dF = deformation_gradient((u_n + u) / 2), gradient(u - u_n)
        N, eta = ufl.FacetNormal(self.V.mesh), ufl.TestFunction(self.V)
        cofactor = _cofactor(F_mid) + _cofactor(dF) / 12
        # In the plane the normal has two components.
        area = [sum(cofactor[i, j] * N[j] for j in range(len(N))) for i in range(len(N))]
        return self._integral(-self._value * ufl.inner(ufl.as_vector(area), eta))


def _cofactor(A: Any) -> Any:
    """Cofactor of a (3, 3) tensor, also of a singular one."""
    a, b, c = (A[:, i] for i in range(3))
    columns = ufl.cross(b, c), ufl.cross(c, a), ufl.cross(a, b)
    return ufl.as_matrix([[column[i] for column in columns] for i in range(3)])
