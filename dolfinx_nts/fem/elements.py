"""Elements of degree 1 and 2, and checks of the spaces and tags of users.

Contact, output and pictures only use the positions of nodes. They divide a cell of degree 2 into
cells of degree 1 on its nodes, called *pieces*: a hexahedron of 27 nodes into eight hexahedra, each
of its faces into four quadrilaterals; a tetrahedron of 10 nodes into eight tetrahedra, each of its
faces into four triangles. In the plane quadrilaterals and triangles are divided in the same manner
as these faces, and each edge into two.
"""

from functools import cache, cached_property

import basix
import numpy as np
from dolfinx import fem
from dolfinx.mesh import MeshTags

from dolfinx_nts import compat
from dolfinx_nts.common.arguments import kind_of
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.collective_calls import meet

__all__ = ["Element", "check_space", "check_tag"]

# Supported cells by the dimension of the mesh.
_CELLS = {2: ("triangle", "quadrilateral"), 3: ("tetrahedron", "hexahedron")}
# Distance on the reference cell [-] below which two points coincide: far larger than round-off, and
# far smaller than the distance of two nodes, 1/2.
_COINCIDENT = 1e-6
# Pieces of simplices of degree 2: one at each corner; in a tetrahedron four more around the
# diagonal between the midpoints of the edges 02 and 13, in a triangle one more. Each node is the
# midpoint of the two given vertices.
_PIECES = {
    "tetrahedron": (
        *(tuple(f"{i}{j}" for j in range(4)) for i in range(4)),
        *(("02", "13", *ring) for ring in (("01", "12"), ("12", "23"), ("23", "03"), ("03", "01"))),
    ),
    "triangle": (*(tuple(f"{i}{j}" for j in range(3)) for i in range(3)), ("01", "12", "02")),
}


class Element:
    """Lagrange element with its nodes and quadrature degrees. Local.

    Args:
        cell: ``"tetrahedron"``, ``"hexahedron"``, ``"triangle"`` or ``"quadrilateral"``.
        degree: 1 or 2.
        is_axisymmetric: Whether the mesh is axisymmetric, so that integrals have the radius as a
            weight.

    Attributes:
        cell, degree, is_axisymmetric: The arguments.
        basix: The scalar element in Basix.
        points: Positions of the nodes on the reference cell, shape ``(n, d)``.
        mass_degree: Quadrature degree of inertia and of loads on facets, exact for the consistent
            mass of straight cells.
        stress_degree: Quadrature degree of the strain energy: 2 x 2 x 2 points in a hexahedron of
            degree 1, 3 x 3 x 3 in one of degree 2, 4 points in a tetrahedron; 2 x 2 in a
            quadrilateral, 3 in a triangle. There are no zero-energy modes.
        locks: Whether full integration locks at constant volume, so that volumetric terms need
            reduced integration: hexahedra and quadrilaterals of degree 1.
        is_simplex: Whether the cell is a tetrahedron or a triangle.
    """

    def __init__(self, cell: str, degree: int, is_axisymmetric: bool = False) -> None:
        self.cell, self.degree, self.is_axisymmetric = cell, degree, is_axisymmetric
        self.basix = basix.create_element(
            basix.ElementFamily.P, basix.CellType[cell], degree, basix.LagrangeVariant.gll_warped
        )
        self.points: Floats = self.basix.points
        self.is_simplex = cell in ("tetrahedron", "triangle")
        # Rules on quadrilaterals have an odd degree, one more than needed.
        self.mass_degree = 2 * degree + (self.is_simplex and is_axisymmetric)
        self.stress_degree = 2 if self.is_simplex else 2 * degree
        self.locks = not self.is_simplex and degree == 1

    @classmethod
    def of(cls, V: fem.FunctionSpace) -> "Element":
        """Element of a space, one object for all spaces with the same element."""
        mesh = V.mesh
        return _created(mesh.topology.cell_name(), V.ufl_element().degree, is_axisymmetric(mesh))

    @classmethod
    def known(cls, cell: str, degree: int, is_axisymmetric: bool = False) -> "Element":
        """Element with the given attributes, always the same object."""
        return _created(cell, degree, is_axisymmetric)

    @cached_property
    def diagonals(self) -> list[Ints]:
        """Pairs of vertices with the midpoint at each node, by node, shape ``(d, 2)``.

        A node on an edge has one pair, on a quadrilateral two, inside a hexahedron four. A vertex
        is paired with itself.
        """
        vertices = basix.geometry(basix.CellType[self.cell])
        middles = (vertices[:, None] + vertices[None]) / 2
        pairs = []
        for point in self.points:
            i, j = np.nonzero(np.abs(middles - point).max(axis=-1) < _COINCIDENT)
            pairs.append(np.column_stack([i, j])[i <= j].astype(np.int32))
        return pairs

    @cached_property
    def pieces(self) -> Ints:
        """Nodes of each piece in Basix order, shape ``(p, k)``."""
        if self.degree == 1:
            return np.arange(len(self.points), dtype=np.int32)[None]
        vertices = basix.geometry(basix.CellType[self.cell])
        if self.is_simplex:
            corners = [
                np.array([(vertices[int(ij[0])] + vertices[int(ij[1])]) / 2 for ij in piece])
                for piece in _PIECES[self.cell]
            ]
        else:
            corners = [(vertices + shift) / 2 for shift in vertices]
        distance = np.abs(np.array(corners)[:, :, None] - self.points).max(axis=-1)
        return np.asarray(distance.argmin(axis=-1), dtype=np.int32)

    @property
    def middles(self) -> Floats:
        """Midpoints of the sub-cells on the reference cell, shape ``(p, 3)``."""
        middles: Floats = self.points[self.pieces].mean(axis=1)
        return middles

    @cached_property
    def sides(self) -> list[tuple[Ints, Ints]]:
        """Facets of sub-cells on each facet of the cell: a list with two arrays per facet.

        These are the nodes of each facet of a sub-cell, shape ``(s, k)``, and the nodes of that
        sub-cell, ``(s, m)``, in Basix order.
        """
        dim = self.points.shape[1] - 1
        facets = np.array(basix.topology(basix.CellType[self.cell])[dim])
        sides = self.pieces[:, facets]
        found = []
        for closure in self.basix.entity_closure_dofs[dim]:
            piece, side = np.nonzero(np.isin(sides, closure).all(axis=-1))
            found.append((sides[piece, side], self.pieces[piece]))
        return found


_created = cache(Element)


def check_space(V: fem.FunctionSpace) -> None:
    """Raise unless the package supports a function space. Local.

    Args:
        V: Space of the displacement.

    Raises:
        TypeError: ``V`` is not a function space.
        ValueError: The mesh does not consist of tetrahedra or hexahedra in space, or of triangles
            or quadrilaterals in the plane; its coordinates are not of 64 bits; the element is not a
            vector of Lagrange elements of degree 1 or 2; or cells are curved and the element has
            another degree.
    """
    if not isinstance(V, fem.FunctionSpace):
        raise TypeError(
            f"expected a function space as the first argument, given {kind_of(V)}: "
            'fem.functionspace(mesh, ("Lagrange", 1, (3,))) makes one, in the plane with (2,); '
            "a body has its own as body.V"
        )
    mesh = V.mesh
    cell = mesh.topology.cell_name()
    element = V.ufl_element()
    dim = mesh.geometry.dim
    if cell not in _CELLS.get(dim, ()):
        raise ValueError(
            "expected a mesh of tetrahedra or hexahedra in space, or of triangles or "
            f"quadrilaterals in the plane, given {cell} cells in {dim} dimensions"
            f"{': read_mesh cuts prisms of gmsh into hexahedra' * (cell == 'prism')}"
            f"{': mesh with tetrahedra or hexahedra alone' * (cell == 'pyramid')}"
        )
    if (kind := mesh.geometry.x.dtype) != np.float64:
        raise ValueError(
            f"expected a mesh with coordinates of 64 bits, given {kind}: make it with "
            "dtype=np.float64, the default of DOLFINx"
        )
    if (
        element.family_name not in ("P", "Q")
        or element.degree not in (1, 2)
        or V.dofmap.index_map_bs != dim
        or element.discontinuous
    ):
        raise ValueError(
            f"expected the space functionspace(mesh, ('Lagrange', 1, ({dim},))), or of degree 2, "
            f"given {'a discontinuous one' if element.discontinuous else 'one'} of the family "
            f"{element.family_name}, degree {element.degree} and values of shape "
            f"{element.reference_value_shape}"
        )
    degree = compat.geometry_degree(mesh)
    if degree not in (1, element.degree):
        if element.degree == 1:
            raise ValueError(
                "expected cells of degree 1, straight ones, for displacements of degree 1, given a "
                f'mesh of degree {degree}: displacements of degree 2, ("Lagrange", 2, ({dim},)), '
                "go with curved cells; gmsh.model.mesh.setOrder(1) makes straight ones"
            )
        raise ValueError(
            f"expected cells of degree 1 or 2, given a mesh of degree {degree}: call "
            "gmsh.model.mesh.setOrder(2) before the mesh is read"
        )


def check_tag(V: fem.FunctionSpace, tags: MeshTags, tag: int, dim: int, name: str) -> None:
    """Raise on all ranks unless entities with a tag exist. Collective.

    Args:
        V: Space of the displacement.
        tags: Tags of the mesh.
        tag: The tag.
        dim: Expected dimension of the tagged entities.
        name: Name of the tags in messages.

    Raises:
        TypeError: ``tags`` is not MeshTags, or ``tag`` not an integer.
        ValueError: The dimension is wrong, the tags belong to another mesh, or the tag does not
            exist on any rank.
    """
    if not isinstance(tags, MeshTags):
        raise TypeError(f"expected MeshTags as {name}, given {type(tags).__name__}")
    if isinstance(tag, bool) or not isinstance(tag, int | np.integer):
        hint = f": read_mesh returns tags by name, tag[{tag!r}]" if isinstance(tag, str) else ""
        raise TypeError(f"expected an integer tag, given {tag!r}{hint}")
    if tags.dim != dim:
        raise ValueError(
            f"expected {name} of dimension {dim}, given tags of dimension {tags.dim}: bodies are "
            "made of tagged cells, surfaces of tagged facets"
        )
    comm = V.mesh.comm
    meet(comm, f"search for tag {tag} in {name}")
    if compat.cpp_object(tags.topology) is not compat.cpp_object(V.mesh.topology):
        raise ValueError(
            f"expected {name} of the mesh of the function space, given those of another mesh: each "
            "call of read_mesh creates a new mesh and its tags"
        )
    if not reductions.anywhere(comm, bool((tags.values == tag).any())):
        values = sorted(set().union(*comm.allgather(set(tags.values.tolist()))))
        raise ValueError(f"expected one of the tags {values} of {name}, given {tag}")
