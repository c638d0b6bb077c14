"""Check for inverted cells, in which the volume ratio det F is not positive."""

import basix
import numpy as np
from dolfinx import fem

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Ints
from dolfinx_nts.fem.components import in_space, nodal
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.parallel import reductions

__all__ = ["VolumeRatio"]


class VolumeRatio:
    """Check of det F > 0 at the quadrature points of the energy. Collective.

    Args:
        u: Displacement [m].
        cells: Owned cells to be checked; None for all.
    """

    def __init__(self, u: fem.Function, cells: Ints | None = None) -> None:
        V = u.function_space
        self._u, self._X, element = u, reference_positions(V), Element.of(V)
        cell = basix.CellType[element.cell]
        points, _ = basix.make_quadrature(cell, element.stress_degree)
        values, *gradients = element.basix.tabulate(1, points)[..., 0]
        self._shapes = values, np.stack(gradients, axis=-1), element.is_axisymmetric
        owned = V.mesh.topology.index_map(V.mesh.topology.dim).size_local
        self._numbers = np.arange(owned) if cells is None else cells
        self._cells: Ints = V.dofmap.list[self._numbers]
        self._volumes = _kernels.cell_volumes(*self._shapes, self._X, self._cells)

    def inverted(self) -> str:
        """Describe the cell with the least det F, if it is inverted. Collective.

        Returns:
            Input number, current position and det F of the cell; "" if no cell is inverted. The
            same on all ranks.
        """
        mesh, x = self._u.function_space.mesh, self._X + in_space(nodal(self._u))
        worst, cell = _kernels.least_volume_ratio(*self._shapes, x, self._volumes, self._cells)
        is_inverted, text = not worst > 0, ""
        if not reductions.anywhere(mesh.comm, is_inverted):
            return ""
        if is_inverted:
            middle = x[self._cells[cell]].mean(axis=0)
            number = mesh.topology.original_cell_index[self._numbers[cell]]
            place = " ".join(f"{value:.4g}" for value in middle)
            text = f"cell {number} near [{place}] is inverted, det F = {worst:.3g}"
        _, text = min(mesh.comm.allgather((worst, text)))
        return text
