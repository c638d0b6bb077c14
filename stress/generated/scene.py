"""Bodies from grids of quadrilaterals, hexahedra, triangles or tetrahedra."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
from dolfinx import fem
from dolfinx.mesh import create_mesh, meshtags

import dolfinx_nts as nts
from stress.generated.judge import Array, Boundary, Ints, boundary_of_cells

__all__ = ["Grid", "Scene", "grid"]


@dataclass(frozen=True)
class Grid:
    """Nodes ``(n, d)`` [m], and quadrilaterals or hexahedra in tensor order ``(c, 2^d)``."""

    X: Array
    cells: Ints

    def moved(self, move: Callable[..., Any]) -> "Grid":
        """Move the nodes by a function of their d coordinates."""
        return replace(self, X=np.asarray(np.broadcast_arrays(*move(*self.X.T))).T.copy())

    def joined(self, other: "Grid") -> "Grid":
        """Union of both grids, without common nodes."""
        cells = np.concatenate([self.cells, len(self.X) + other.cells])
        return Grid(np.concatenate([self.X, other.X]), cells)

    def simplices(self) -> Ints:
        """Two triangles or six tetrahedra of each cell."""
        dim = self.X.shape[1]
        ways = [np.cumsum([0, *(1 << a for a in order)]) for order in permutations(range(dim))]
        return self.cells[:, ways].reshape(-1, dim + 1)


def grid(corner: Sequence[float], size: Sequence[float], cells: Sequence[int]) -> Grid:
    """Grid of a rectangle or box."""
    axes = [c + np.linspace(0, s, n + 1) for c, s, n in zip(corner, size, cells, strict=True)]
    return from_axes(*axes)


def from_axes(*axes: Array) -> Grid:
    """Tensor-product grid of given coordinates along each axis."""
    X = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    shape = [len(axis) for axis in axes]
    ids = np.arange(len(X)).reshape(shape)
    corners = [
        ids[tuple(slice(b, n - 1 + b) for b, n in zip(bits[::-1], shape, strict=True))].ravel()
        for bits in product((0, 1), repeat=len(axes))
    ]
    return Grid(X, np.column_stack(corners))


class Scene:
    """A mesh of grids, its space and bodies.

    Args:
        grids: Grids by name.
        simplices: Whether cells are cut into triangles or tetrahedra.
        degree: Of the displacement.
        material: Of all bodies, or by name.

    Attributes:
        V: Space of the displacement.
        bodies: Bodies by name.
        X: Nodes of the space, shape ``(n, d)`` [m].
        dim: Dimension d.
    """

    def __init__(
        self,
        grids: Mapping[str, Grid],
        material: nts.Hyperelastic | Mapping[str, nts.Hyperelastic],
        simplices: bool = False,
        degree: int = 1,
    ) -> None:
        """Make the mesh and the bodies."""
        self.dim = dim = next(iter(grids.values())).X.shape[1]
        X, cells, owner, first = [], [], [], 0
        for number, some in enumerate(grids.values()):
            own = some.simplices() if simplices else some.cells
            X.append(some.X)
            cells.append(first + own)
            owner.append(np.full(len(own), number))
            first += len(some.X)
        kind = {
            (2, False): "quadrilateral",
            (2, True): "triangle",
            (3, False): "hexahedron",
            (3, True): "tetrahedron",
        }[dim, simplices]
        # As of meshes by gmsh, with which they share kernels.
        variant = basix.LagrangeVariant.equispaced
        element = basix.ufl.element("Lagrange", kind, 1, variant, shape=(dim,))
        mesh = create_mesh(comm=MPI.COMM_SELF, cells=np.vstack(cells), x=np.vstack(X), e=element)
        mesh.topology.create_connectivity(dim - 1, dim)
        tags = np.concatenate(owner)[mesh.topology.original_cell_index].astype(np.int32)
        cell_tags = meshtags(mesh, dim, np.arange(len(tags), dtype=np.int32), tags)
        self.V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
        self.X = self.V.tabulate_dof_coordinates()[:, :dim].copy()
        self._degree, self._owner, self._names = degree, tags, list(grids)
        if not isinstance(material, Mapping):
            material = dict.fromkeys(grids, material)
        self.bodies = {
            name: nts.Body(self.V, cell_tags, number, material[name])
            for number, name in enumerate(grids)
        }
        vertices = cells[0].shape[1]
        dofs = self.V.dofmap.list.reshape(len(tags), -1)
        self._cell_nodes, self.cells = dofs.astype(np.int64), dofs[:, :vertices].astype(np.int64)

    def cells_of(self, name: str) -> Ints:
        """Nodes at the vertices of the cells of a body, shape ``(c, k)``."""
        return self.cells[self._owner == self._names.index(name)]

    def surface(self, name: str, where: Callable[[Array], Any] | None = None) -> nts.Surface:
        """Boundary of a body, or its part where a function of positions holds."""
        if where is None:
            return nts.boundary_of(self.bodies[name])
        return nts.boundary_of(self.bodies[name], where=lambda x: where(x[: self.dim]))

    def nodes(self, name: str, where: Callable[[Array], Any] | None = None) -> Ints:
        """Nodes of a body, or only the nodes where a function of positions ``(d, n)`` holds."""
        own = np.unique(self._cell_nodes[self._owner == self._names.index(name)])
        return own if where is None else own[np.asarray(where(self.X[own].T))]

    def held(
        self, name: str, where: Callable[[Array], Any] | None = None, value: Any = None
    ) -> fem.DirichletBC:
        """Clamp the nodes of a body, or only the nodes where a function holds."""
        value = np.zeros(self.dim) if value is None else value
        dofs = self.nodes(name, where).astype(np.int32)
        if isinstance(value, fem.Constant):
            return fem.dirichletbc(value, dofs, self.V)
        return fem.dirichletbc(np.asarray(value, dtype=float), dofs, self.V)

    def guided(self, name: str, axis: int) -> fem.DirichletBC:
        """Fix one displacement component of all nodes of a body."""
        dofs = self.nodes(name).astype(np.int32) * self.dim + axis
        return fem.dirichletbc(np.float64(0.0), dofs, self.V.sub(axis))

    def boundary(self, name: str, where: Callable[[Array], Any] | None = None) -> Boundary:
        """Boundary of the cells of a body, or of its cells with centres ``(d, c)`` in a region."""
        cells = self.cells_of(name)
        if where is not None:
            cells = cells[np.asarray(where(self.X[cells].mean(axis=1).T))]
        return boundary_of_cells(self.X, cells, self.nodes(name), self._degree)

    def positions(self, stepper: Any) -> Array:
        """Positions of the nodes, shape ``(n, d)`` [m]."""
        return np.asarray(stepper.x)[:, : self.dim].copy()
