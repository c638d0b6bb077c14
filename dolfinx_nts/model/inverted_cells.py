"""Search for inverted cells, in which the volume ratio det F is not positive."""

from functools import cached_property, partial

import basix
import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.fem.components import deformation_gradient, in_space, nodal
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.jit import compile_expression, compile_form
from dolfinx_nts.parallel import reductions

__all__ = ["VolumeRatio"]


class VolumeRatio:
    """Finds inverted cells, with det F <= 0 at a quadrature point of the energy.

    Collective, as are all its methods.

    Args:
        u: Displacement [m], watched from now on.
    """

    def __init__(self, u: fem.Function) -> None:
        """Compile the volume of inverted cells."""
        mesh = u.function_space.mesh
        cell = basix.CellType[mesh.topology.cell_name()]
        degree = Element.of(u.function_space).stress_degree
        points, _ = basix.make_quadrature(cell, degree)
        ratio = ufl.det(deformation_gradient(u))
        self._u = u
        # Few runs need it.
        self._compile_ratio = partial(compile_expression, ratio, points)
        dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": degree})
        self._inverted_volume = compile_form(ufl.conditional(ufl.gt(ratio, 0), 0.0, 1.0) * dx)
        num_cells = mesh.topology.index_map(mesh.topology.dim).size_local
        self._cells = np.arange(num_cells, dtype=np.int32)

    @cached_property
    def _expression(self) -> fem.Expression:
        """The value of det F at the quadrature points. Collective at the first use."""
        return self._compile_ratio()

    def inverted(self) -> str:
        """Describe the cell with the least det F, if it is inverted. Collective.

        Returns:
            Number in the mesh as read, current place and det F of the cell; empty if no cell is
            inverted. The same on all ranks.
        """
        V = self._u.function_space
        mesh, worst, text = V.mesh, np.inf, ""
        is_inverted = bool(fem.assemble_scalar(self._inverted_volume) > 0)
        if not reductions.anywhere(mesh.comm, is_inverted):
            return ""
        expression = self._expression
        if is_inverted:
            ratio = expression.eval(mesh, self._cells).min(axis=1)
            cell = int(np.argmin(ratio))
            worst = float(ratio[cell])
            if not worst > 0:
                x = V.tabulate_dof_coordinates() + in_space(nodal(self._u))
                middle = x[V.dofmap.cell_dofs(cell)].mean(axis=0)
                number = mesh.topology.original_cell_index[cell]
                place = " ".join(f"{value:.4g}" for value in middle)
                text = f"cell {number} near [{place}] is inverted, det F = {worst:.3g}"
        _, text = min(mesh.comm.allgather((worst, text)))
        return text
