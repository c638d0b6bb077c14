"""Elements of degree 1 and 2: nodes of a cell, and the cells of degree 1 between.

Contact, output and pictures see positions of nodes only. For them a cell of
degree 2 is eight cells of degree 1 on its nodes, its *pieces*: a hexahedron
of 27 nodes is cut into eight hexahedra, each face into four quadrangles; a
tetrahedron of 10 nodes into eight tetrahedra, each face into four triangles.
"""

from functools import cache, cached_property

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import fem

__all__ = ["Element"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]

# Pieces of a tetrahedron of degree 2: four at the corners, four around the
# diagonal from the middle of edge 02 to that of 13. Nodes as pairs of
# vertices whose middle they are.
_TETRAHEDRA = (
    *(tuple(f"{i}{j}" for j in range(4)) for i in range(4)),
    *(("02", "13", *ring) for ring in (("01", "12"), ("12", "23"), ("23", "03"), ("03", "01"))),
)


class Element:
    """Lagrange element on tetrahedra or hexahedra.

    Args:
        cell: ``"tetrahedron"`` or ``"hexahedron"``.
        degree: 1 or 2.

    Attributes:
        cell: The cell.
        degree: The degree.
        basix: The element in Basix, with one value a node.
        points: Reference positions of the nodes, shape ``(n, 3)``.
        mass_degree: Of the rule for inertia, and for loads on facets: exact
            for the consistent mass of straight cells.
        stress_degree: Of the rule for the energy: 2 x 2 x 2 points in a
            hexahedron of degree 1 and 3 x 3 x 3 in one of degree 2, 4 points
            in a tetrahedron. No deformation of a cell goes unseen.
    """

    def __init__(self, cell: str, degree: int) -> None:
        """Create the element."""
        self.cell, self.degree = cell, degree
        self.basix = basix.create_element(
            basix.ElementFamily.P,
            basix.CellType[cell],
            degree,
            basix.LagrangeVariant.gll_warped,
        )
        self.points: Floats = self.basix.points
        self.mass_degree = 2 * degree
        self.stress_degree = 2 if cell == "tetrahedron" else 2 * degree

    @classmethod
    def of(cls, V: fem.FunctionSpace) -> "Element":
        """Element of a space; one object for all spaces that have it."""
        return _created(V.mesh.topology.cell_name(), V.ufl_element().degree)

    @cached_property
    def diagonals(self) -> list[Ints]:
        """Pairs of vertices in whose middle each node is, shape ``(d, 2)``.

        One of an edge, two of a quadrangle, four of a hexahedron; a vertex
        is in the middle of itself and itself.
        """
        vertices = basix.geometry(basix.CellType[self.cell])
        middles = (vertices[:, None] + vertices[None]) / 2
        pairs = []
        for point in self.points:
            i, j = np.nonzero(np.abs(middles - point).max(axis=-1) < 1e-6)
            pairs.append(np.column_stack([i, j])[i <= j].astype(np.int32))
        return pairs

    @cached_property
    def pieces(self) -> Ints:
        """Nodes of the cells of degree 1 between the nodes, shape ``(p, k)``.

        In Basix order, as all vertices.
        """
        if self.degree == 1:
            return np.arange(len(self.points), dtype=np.int32)[None]
        vertices = basix.geometry(basix.CellType[self.cell])
        if self.cell == "hexahedron":
            corners = [(vertices + shift) / 2 for shift in vertices]
        else:
            corners = [
                np.array([(vertices[int(ij[0])] + vertices[int(ij[1])]) / 2 for ij in piece])
                for piece in _TETRAHEDRA
            ]
        distance = np.abs(np.array(corners)[:, :, None] - self.points).max(axis=-1)
        return np.asarray(distance.argmin(axis=-1), dtype=np.int32)

    @cached_property
    def sides(self) -> list[tuple[Ints, Ints]]:
        """Sides of the pieces on each facet of the cell, by facet.

        Nodes of the sides, shape ``(s, k)``, and of their pieces, ``(s, m)``.
        """
        facets = np.array(basix.topology(basix.CellType[self.cell])[2])
        sides = self.pieces[:, facets]
        found = []
        for closure in self.basix.entity_closure_dofs[2]:
            piece, side = np.nonzero(np.isin(sides, closure).all(axis=-1))
            found.append((sides[piece, side], self.pieces[piece]))
        return found


_created = cache(Element)
