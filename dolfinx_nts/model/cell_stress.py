"""Cauchy stress and strain energy density of bodies at points of their cells."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import deformation_gradient
from dolfinx_nts.fem.jit import compile_expression
from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.rigid_body import RigidBody

__all__ = ["CellStress", "StressState"]


class StressState(NamedTuple):
    """Stress and strain energy density at p points of each of c cells.

    Attributes:
        cauchy: Cauchy stress, shape ``(c, p, 3, 3)`` [Pa].
        energy_density: Strain energy per reference volume, shape ``(c, p)`` [J/m^3].
    """

    cauchy: Floats
    energy_density: Floats

    def von_mises(self) -> Floats:
        """Von Mises stress, shape ``(c, p)`` [Pa]. Local."""
        mean = np.trace(self.cauchy, axis1=2, axis2=3) / 3
        deviator = self.cauchy - mean[..., None, None] * np.eye(3)
        stress: Floats = np.sqrt(1.5 * np.einsum("cpij,cpij->cp", deviator, deviator))
        return stress


class CellStress:
    """Stress of a displacement field. Construction is collective, `evaluate` is local.

    In the plane the stress includes the component along z, which vanishes in plane stress. In
    axisymmetric meshes the last component is the hoop stress.

    Args:
        bodies: Bodies that fill the mesh; rigid ones have no stress.
        u: The displacement [m].
        points: Points on the reference cell, shape ``(p, d)``.
        remembered: Function ``remembered(material, parameters, C)`` that returns the second
            Piola-Kirchhoff stress [Pa] and the energy [J/m^3] due to internal variables, UFL.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        u: fem.Function,
        points: Floats,
        remembered: Callable[[Hyperelastic, Any, Any], tuple[Any, Any]],
    ) -> None:
        self._mesh, self._num_points = u.function_space.mesh, len(points)
        self._num_cells = self._mesh.topology.index_map(self._mesh.topology.dim).size_local
        F = deformation_gradient(u, on_axis=True)

        @cache
        def of(material: Hyperelastic) -> fem.Expression:
            # Constants, since numbers would be compiled into the code.
            parameters = {k: fem.Constant(self._mesh, v) for k, v in material.parameters.items()}
            C = F.T * F
            J = ufl.det(F) * material.thickness_stretch(C, **parameters)
            some = parameters | dict.fromkeys(material.remembered_terms, 0.0)
            S, energy = material.stress(C, **some), material.psi(C, **some)
            if material.remembers:
                added, stored = remembered(material, parameters, C)
                S, energy = S + added, energy + stored
            sigma = F * S * F.T / J
            parts = [sigma[i, j] for i in range(3) for j in range(3)]
            return compile_expression(ufl.as_vector([*parts, energy]), points)

        soft = (body for body in bodies if not isinstance(body, RigidBody))
        self._parts = [(body.cells, of(body.material)) for body in soft]

    def evaluate(self) -> StressState:
        """Stress of the current displacement in the owned cells, in their order."""
        values = np.zeros((self._num_cells, self._num_points, 10))
        for cells, expression in self._parts:
            values[cells] = expression.eval(self._mesh, cells).reshape(-1, self._num_points, 10)
        return StressState(values[..., :9].reshape(*values.shape[:2], 3, 3), values[..., 9])
