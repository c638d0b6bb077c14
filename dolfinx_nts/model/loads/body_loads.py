"""Loads on the volume of bodies: force per volume, weight."""

from collections.abc import Sequence
from typing import Any

import ufl
from dolfinx import fem

from dolfinx_nts.common.arguments import as_call, instances
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.model.loads.load import LoadOnBody, LoadWithValue

__all__ = ["BodyForce", "Gravity"]


class BodyForce(LoadOnBody):
    """Force per reference volume of a body. Collective.

    Args:
        body: The body.
        value: Force, shape ``(3,)`` [N/m^3], a function of the time [s] that returns it, or a
            UFL expression, also of the reference position.

    Raises:
        TypeError: ``body`` is not a Body.
        ValueError: The value has the wrong shape or is not finite.

    Example:
        >>> nts.BodyForce(body, (0.0, 0.0, 5.0))  # N/m^3
        BodyForce(body=Body(tag=..., ...), value=(0, 0, 5))
        >>> swinging = nts.BodyForce(body, lambda t: (np.sin(t), 0.0, 0.0))
    """

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        work = ufl.inner(self._value, ufl.TestFunction(self.V))
        # The factor rho selects the quadrature of inertia; it is divided out again.
        one = fem.Constant(self.V.mesh, self._body.material.rho)
        return bulk_form([self._body], lambda material, parameters, rho: rho / one * work)


class Gravity(LoadWithValue):
    """Weight of bodies. Collective.

    Args:
        bodies: A body, or several of one space.
        g: Acceleration, shape ``(3,)`` [m/s^2], a function of the time [s] that returns it, or
            a UFL expression, also of the reference position.

    Raises:
        TypeError: Something in the list is not a body.
        ValueError: There are no bodies, or ``g`` has the wrong shape, is not finite, or in an
            axisymmetric mesh is not along the axis.

    Example:
        >>> nts.Gravity([body, other], (0.0, 0.0, -9.81))  # m/s^2
        Gravity(num_bodies=2, g=(0, 0, -9.81))
    """

    def __init__(self, bodies: Body | Sequence[Body], g: Any) -> None:
        self._bodies = instances(Body, [bodies] if isinstance(bodies, Body) else bodies)
        if not self._bodies:
            raise ValueError("expected at least one Body, given none")
        super().__init__(self._bodies[0].V, g)

    def __repr__(self) -> str:
        """Constructor call with the number of bodies and the acceleration. Local."""
        return as_call(self, num_bodies=len(self._bodies), g=self._described())

    def acts_on(self, body: Body) -> bool:
        return body in self._bodies

    def _set(self, value: Any) -> None:
        super()._set(value)
        if is_axisymmetric(self.V.mesh) and self._value.value[0] != 0:
            raise ValueError(
                f"expected Gravity along the axis y of an axisymmetric mesh, given {value}: a "
                "BodyForce may be radial"
            )

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        work = ufl.inner(self._value, ufl.TestFunction(self.V))
        return bulk_form(self._bodies, lambda material, parameters, rho: rho * work)
