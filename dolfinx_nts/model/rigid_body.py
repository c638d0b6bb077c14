"""Rigid bodies: meshed regions with mass and inertia that do not deform, free or guided."""

from collections.abc import Iterable

import numpy as np
from dolfinx import fem
from dolfinx.mesh import MeshTags

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.components import dimension, in_space, possible_motions
from dolfinx_nts.materials.mass_only import Rigid
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.guide import Guide

__all__ = ["RigidBody", "guided"]


class RigidBody(Body):
    """A body that does not deform, and moves freely or along a guide. Collective.

    Mass, centre of mass and inertia are computed on its mesh. Contact treats its surface like that
    of a deformable body. Deformable bodies that share nodes with it are bonded to it. It has six
    degrees of freedom, in the plane three, and in an axisymmetric mesh one, along the axis.

    Args:
        V: Space of the displacement, see `Body`.
        cells: Cell tags of the mesh.
        tag: Value of the tag.
        rho: Reference density [kg/m^3].
        guide: Free and prescribed motions; None for a free body.
        name: Name in messages, columns and legends, see `Body`.

    Attributes:
        material: Inertia without strain energy.
        guide: The argument.

    Raises:
        TypeError: ``V`` is not a function space, ``cells`` not MeshTags, ``tag`` not an integer, or
            ``guide`` not a Guide.
        ValueError: The space, the tag or the axes of the guide do not fit; in an axisymmetric mesh
            the guide allows or prescribes a motion other than along the axis; or the density is
            not positive.

    Example:
        >>> hammer = nts.RigidBody(V, cells, tag["upper"], rho=7800.0)  # kg/m^3
        >>> stepper = nts.EnergyMomentum([body, hammer], [pair], dt=0.01)
        >>> stepper.set_velocity(hammer, (0.0, 0.0, -1.0))
        >>> stepper.advance().num_active
        0
    """

    is_rigid = True

    def __init__(
        self,
        V: fem.FunctionSpace,
        cells: MeshTags,
        tag: int,
        rho: float,
        guide: Guide | None = None,
        *,
        name: str = "",
    ) -> None:
        super().__init__(V, cells, tag, Rigid(rho), name=name)
        if not (guide is None or isinstance(guide, Guide)):
            raise TypeError(f"expected a Guide of a rigid body, given {type(guide).__name__}")
        if guide is not None:
            guide.check(dimension(V))
            if is_axisymmetric(V.mesh):
                guide.check_axis()
        self.guide = guide

    def free(self) -> Floats:
        """Basis of the free translations and rotations, see `Guide.free`, ``(k, 6)``. Local."""
        if self.guide is not None:
            return self.guide.free(dimension(self.V))
        possible = possible_motions(self.V)
        return np.eye(len(possible))[possible]

    def prescribed(self, point: Floats, t_n: float, t: float) -> Floats:
        """Prescribed motion of the body between two times, see `Guide.prescribed`. Local.

        Args:
            point: Guided point in the reference configuration, shape ``(d,)`` [m].
            t_n: Time at the start of the step [s].
            t: Time at its end [s].

        Raises:
            ValueError: The motion is not along the axis of an axisymmetric mesh.
        """
        if self.guide is None:
            return np.zeros(self.free().shape[1])
        prescribed = self.guide.prescribed(in_space(point), t_n, t, len(point))
        if is_axisymmetric(self.V.mesh) and prescribed[0]:
            raise ValueError(
                "expected a motion along the axis y of a guide in an axisymmetric mesh, given "
                f"{self.guide.motion!r}, which has other components at t = {t:g}"
            )
        return prescribed


def guided(bodies: Iterable[Body]) -> list[RigidBody]:
    """Rigid bodies with a guide, in the order of ``bodies``. Local."""
    # `is_rigid` first, which is faster than `isinstance`.
    rigid = (body for body in bodies if body.is_rigid and isinstance(body, RigidBody))
    return [body for body in rigid if body.guide is not None]
