"""Moduli of undeformed bodies at points of their cells, also of materials that vary in space."""

from collections.abc import Iterator

import basix
import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives
from ufl.checks import is_cellwise_constant

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.jit import compile_expression
from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.materials.strain_energy import strain_basis

__all__ = ["CellModuli"]

# Number of cells that are evaluated together [-], to save memory.
_BLOCK = 4096


class CellModuli:
    """Moduli 4 psi''(1) of a material in cells. Construction is collective, calls are local.

    Points are as in the forms: one per cell for a material that is constant in each cell, and the
        quadrature points of the strain energy for other materials with fields.

    Args:
        V: Space of the bodies.
        material: The material.
    """

    def __init__(self, V: fem.FunctionSpace, material: Hyperelastic) -> None:
        self._mesh, self._material = V.mesh, material
        if not material.has_fields:
            return
        element = Element.of(V)
        # Constants, since numbers would be compiled into the code.
        parameters = {k: fem.Constant(V.mesh, v) for k, v in material.parameters.items()}
        self._strain = fem.Constant(V.mesh, np.zeros((3, 3)))
        stress = expand_derivatives(material.linear_stress(self._strain, **parameters))
        degree = 1 if is_cellwise_constant(stress) else element.stress_degree
        points, _ = basix.make_quadrature(basix.CellType[element.cell], degree)
        values = ufl.as_vector([stress[i, j] for i in range(3) for j in range(3)])
        self._stress, self._num_points = compile_expression(values, points), len(points)

    def __call__(self, cells: Ints) -> Floats:
        """Moduli at p points of cells, for the strains listed in `StrainEnergy.moduli`.

        Args:
            cells: Local indices of cells, shape ``(c,)``.

        Returns:
            Shape ``(c, p, 6, 6)`` [Pa].
        """
        if not self._material.has_fields:
            return np.broadcast_to(self._material.moduli, (len(cells), 1, 6, 6))
        basis = strain_basis()
        moduli: Floats = np.empty((len(cells), self._num_points, 6, 6))
        for b, strain in enumerate(basis):
            self._strain.value[:] = strain
            stress = self._stress.eval(self._mesh, cells).reshape(*moduli.shape[:2], 3, 3)
            moduli[..., b] = np.einsum("aij,cpij->cpa", basis, stress)
        return moduli

    def blocks(self, cells: Ints) -> Iterator[tuple[Ints, Floats]]:
        """Yield blocks of cells with their moduli; nothing without cells."""
        for start in range(0, len(cells), _BLOCK):
            block = cells[start : start + _BLOCK]
            yield block, self(block)
