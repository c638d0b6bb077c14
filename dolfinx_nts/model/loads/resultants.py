"""Resultant force and moment on a body, such as on a guided tool."""

from typing import Any

from mpi4py import MPI

import ufl
from dolfinx import fem

from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.components import deformation_gradient, gradient
from dolfinx_nts.fem.jit import compile_quickly
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.model.loads.load import LoadOnBody
from dolfinx_nts.parallel import reductions

__all__ = ["Force", "Moment"]


class _Resultant(LoadOnBody):
    """Load on a body, distributed in proportion to mass.

    Args:
        body: The body.
        value: As for `LoadWithValue`.
    """

    def __init__(self, body: Body, value: Any) -> None:
        super().__init__(body, value)
        comm: MPI.Comm = body.V.mesh.comm
        form = compile_quickly(bulk_form([body], lambda material, parameters, rho: rho))
        self._mass: float = reductions.total(comm, float(fem.assemble_scalar(form)))

    def _spread(self, work: Any) -> ufl.Form:
        """Mass-weighted mean over the body of a virtual work, linear in the test function."""
        mass = fem.Constant(self.V.mesh, self._mass)
        return bulk_form([self._body], lambda material, parameters, rho: rho / mass * work)


class Force(_Resultant):
    """Dead force on a body as a whole, distributed like its weight. Collective.

    Args:
        body: The body, such as a rigid one with a guide that is free along the force.
        value: Resultant, shape ``(3,)``, in the plane ``(2,)`` [N], a function of the time [s]
            that returns it, or a UFL expression.

    Raises:
        TypeError: ``body`` is not a Body.
        ValueError: The value has the wrong shape, is not finite, or in an axisymmetric mesh is not
            along the axis.

    Example:
        >>> nts.Force(body, (0.0, 0.0, -800.0))  # N
        Force(body=Body(tag=..., ...), value=(0, 0, -800))
        >>> rising = nts.Force(body, lambda t: (0.0, 0.0, -100.0 * t))
    """

    def _set(self, value: Any) -> None:
        super()._set(value)
        if is_axisymmetric(self.V.mesh) and self._value.value[0] != 0:
            raise ValueError(
                f"expected a Force along the axis y of an axisymmetric mesh, given {value}: a "
                "BodyForce may be radial"
            )

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        return self._spread(ufl.inner(self._value, ufl.TestFunction(self.V)))


class Moment(_Resultant):
    r"""Moment on a body as a whole, with a fixed direction and no resultant force. Collective.

    Its work on a rigid body in a step is :math:`M \cdot \theta` with the Cayley vector
    :math:`\theta`, 2 tan(angle/2) along the axis of rotation. A moment with a fixed direction has
    no potential. On a deformable body it acts on the mass-weighted mean rotation.

    Args:
        body: The body, such as a rigid one with a guide that is free to rotate.
        value: Moment, shape ``(3,)`` [N m], in the plane a number, a function of the time [s] that
            returns it, or a UFL expression.

    Raises:
        TypeError: ``body`` is not a Body.
        ValueError: The mesh is axisymmetric, or the value has the wrong shape or is not finite.

    Example:
        >>> nts.Moment(body, (0.0, 2.0, 0.0))  # N m
        Moment(body=Body(tag=..., ...), value=(0, 2, 0))
    """

    def _shape_in(self, dim: int) -> tuple[int, ...]:
        if is_axisymmetric(self.V.mesh):
            raise ValueError(
                f"expected no Moment in an axisymmetric mesh, given one on {self._body.name}: "
                "bodies of revolution do not rotate; use a mesh in space"
            )
        return () if dim == 2 else (3,)

    def form(self, u_n: fem.Function, u: fem.Function) -> ufl.Form:
        # A rotation theta about the mean state has the displacement gradient theta x there.
        F = deformation_gradient((u_n + u) / 2)
        spin = gradient(ufl.TestFunction(self.V)) * ufl.inv(F)
        pairs = ((2, 1), (0, 2), (1, 0))
        axial = ufl.as_vector([(spin[i, j] - spin[j, i]) / 2 for i, j in pairs])
        value = self._value if self._shape else ufl.as_vector([0, 0, self._value])
        return self._spread(ufl.inner(value, axial))
