"""Numbers of cells, by which files and fields show what points remember."""

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh

from dolfinx_nts.common.arrays import Floats, Ints

__all__ = ["CellValues"]


class CellValues:
    """Numbers that are constant in cells. Collective, but for `set`.

    Args:
        mesh: The mesh.
        cells: Owned cells that have numbers, shape ``(c,)``.
        size: How many numbers a cell has.

    Attributes:
        function: The numbers, a Function with 0 in all other cells.
    """

    def __init__(self, mesh: Mesh, cells: Ints, size: int) -> None:
        space = fem.functionspace(mesh, ("Discontinuous Lagrange", 0, (size,)))
        self.function = fem.Function(space)
        self._rows, self._size = space.dofmap.list[cells, 0], size

    def set(self, values: Floats) -> None:
        """Set the numbers of the cells, shape ``(c, k)``. Local."""
        self.function.x.array.reshape(-1, self._size)[self._rows] = np.asarray(values)
