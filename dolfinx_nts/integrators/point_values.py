"""Numbers at the points of the quadrature of stress, which a material remembers."""

from collections.abc import Sequence

import basix.ufl
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.elements import Element

__all__ = ["PointValues"]


class PointValues:
    """Numbers at the points of some cells, at both ends of a step.

    Args:
        V: Space of the displacement.
        cells: Owned cells, sorted, shape ``(c,)``.
        values: Numbers with which all points begin, shape ``(k,)``.

    Attributes:
        start: Numbers at the start of the last step, a Function of points.
        end: Numbers at its end.
        cells: As given.
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
        """Begin a step with the numbers that were accepted last. Local."""
        self.start.x.array[:] = self.end.x.array

    def of(self, function: fem.Function) -> Floats:
        """Numbers of `start` or `end` at the points, shape ``(c, p, k)``. Local."""
        values: Floats = function.x.array.reshape(-1, self._size)[self._dofs]
        return values

    def set(self, function: fem.Function, values: Floats) -> None:
        """Set the numbers of `start` or `end`, shape ``(c, p, k)``. Local."""
        function.x.array.reshape(-1, self._size)[self._dofs] = values

    def serialize(self, archive: Archive, name: str) -> None:
        """Serialize the numbers by those of the cells in the mesh as read."""
        for end, function in (("start", self.start), ("end", self.end)):
            self.set(function, archive.nodal(f"{name}/{end}", self._ids, self.of(function)))
