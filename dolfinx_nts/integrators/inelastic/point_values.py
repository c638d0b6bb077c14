"""Values at the quadrature points of the stress, and cellwise constant values."""

from collections.abc import Sequence

import basix.ufl
import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.elements import Element

__all__ = ["CellValues", "PointValues"]


class CellValues:
    """Cellwise constant values. Collective, except for `set`.

    Args:
        mesh: The mesh.
        cells: Owned cells with values, shape ``(c,)``.
        size: Number of values of a cell, k.

    Attributes:
        function: Function with the values, 0 in all other cells.
    """

    def __init__(self, mesh: Mesh, cells: Ints, size: int) -> None:
        space = fem.functionspace(mesh, ("Discontinuous Lagrange", 0, (size,)))
        self.function = fem.Function(space)
        self._rows, self._size = space.dofmap.list[cells, 0], size

    def set(self, values: Floats) -> None:
        """Set the values of the cells, shape ``(c, k)``. Local."""
        self.function.x.array.reshape(-1, self._size)[self._rows] = np.asarray(values)


class PointValues:
    """Values at the quadrature points of some cells, at both ends of a step.

    Args:
        V: Space of the displacement.
        cells: Owned cells, sorted, shape ``(c,)``.
        values: Initial values of all points, shape ``(k,)``.

    Attributes:
        start: Values at the start of the last step, a Function of a quadrature element.
        end: Values at its end.
        cells: The argument.
        points: Points on the reference cell, shape ``(p, d)``.
    """

    def __init__(self, V: fem.FunctionSpace, cells: Ints, values: Sequence[float]) -> None:
        mesh, degree = V.mesh, Element.of(V).stress_degree
        cell, self._size = mesh.topology.cell_name(), len(values)
        element = basix.ufl.quadrature_element(cell, value_shape=(self._size,), degree=degree)
        space = fem.functionspace(mesh, element)
        self.start, self.end = fem.Function(space), fem.Function(space)
        for function in (self.start, self.end):
            function.x.array.reshape(-1, self._size)[:] = values
        self.cells = cells
        self.points: Floats = basix.make_quadrature(basix.CellType[cell], degree)[0]
        self._dofs = space.dofmap.list[cells]
        self._ids = mesh.topology.original_cell_index[cells]

    def begin(self) -> None:
        """Begin a step with the last accepted values. Local."""
        self.start.x.array[:] = self.end.x.array

    def of(self, function: fem.Function) -> Floats:
        """Values of `start` or `end` at the points, shape ``(c, p, k)``. Local."""
        values: Floats = function.x.array.reshape(-1, self._size)[self._dofs]
        return values

    def set(self, function: fem.Function, values: Floats) -> None:
        """Set the values of `start` or `end`, shape ``(c, p, k)``. Local."""
        function.x.array.reshape(-1, self._size)[self._dofs] = values

    def serialize(self, archive: Archive, name: str) -> None:
        """Serialize the values by the input numbers of the cells."""
        for end, function in (("start", self.start), ("end", self.end)):
            self.set(function, archive.nodal(f"{name}/{end}", self._ids, self.of(function)))
