"""Elements of degree 1 and 2: nodes of a cell, and the cells of degree 1 between.

Contact, output and pictures see positions of nodes only. For them a cell of
degree 2 is eight cells of degree 1 on its nodes, its *pieces*: a hexahedron
of 27 nodes is cut into eight hexahedra, each face into four quadrangles; a
tetrahedron of 10 nodes into eight tetrahedra, each face into four triangles.

Spaces that the package works in, and tags on their meshes: checks.
"""

from functools import cache, cached_property

import basix
import numpy as np
from dolfinx import fem
from dolfinx.mesh import MeshTags

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import Floats, Ints

__all__ = ["Element", "check_space", "check_tag"]


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

_CELLS = ("tetrahedron", "hexahedron")


def check_space(V: fem.FunctionSpace) -> None:
    """Raise unless V is a space that this package works in. Local.

    Args:
        V: Space of the displacement.

    Raises:
        ValueError: Mesh or element is another.
    """
    mesh = V.mesh
    cell = mesh.topology.cell_name()
    element = V.ufl_element()
    if cell not in _CELLS:
        raise ValueError(f"expected a mesh of tetrahedra or hexahedra, given {cell} cells")
    degree = compat.geometry_degree(mesh)
    if mesh.geometry.dim != 3 or degree != 1:
        raise ValueError(
            "expected a mesh of degree 1 in three dimensions, given degree "
            f"{degree} in {mesh.geometry.dim}; displacements on it may be of "
            "degree 2"
        )
    if (
        element.family_name not in ("P", "Q")
        or element.degree not in (1, 2)
        or V.dofmap.index_map_bs != 3
        or element.discontinuous
    ):
        raise ValueError(
            "expected the space functionspace(mesh, ('Lagrange', 1, (3,))), or of degree 2, given "
            f"{element} with block size {V.dofmap.index_map_bs}"
        )


def check_tag(V: fem.FunctionSpace, tags: MeshTags, tag: int, dim: int, name: str) -> None:
    """Raise on all ranks unless ``tags`` has entities of value ``tag``.

    Collective.

    Args:
        V: Space of the displacement.
        tags: Tags of the mesh.
        tag: Value that is looked for.
        dim: Dimension that the tags should have.
        name: What the message calls the tags.

    Raises:
        TypeError: ``tags`` is no MeshTags, or ``tag`` no integer.
        ValueError: The dimension is wrong, or no rank has the tag.
    """
    if not isinstance(tags, MeshTags):
        raise TypeError(f"expected MeshTags as {name}, given {type(tags).__name__}")
    if isinstance(tag, bool) or not isinstance(tag, int | np.integer):
        raise TypeError(f"expected an integer tag, given {tag!r}")
    if tags.dim != dim:
        raise ValueError(f"expected {name} of dimension {dim}, given dimension {tags.dim}")
    comm = V.mesh.comm
    values = sorted(set().union(*comm.allgather(set(tags.values.tolist()))))
    if tag not in values:
        raise ValueError(f"expected a tag out of {values} in {name}, given {tag}")
