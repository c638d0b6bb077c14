"""Meshes of boxes from arrays, so that a test can renumber nodes and cells and choose owners."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import graph
from dolfinx.mesh import GhostMode, Mesh, MeshTags, create_mesh, meshtags

from dolfinx_nts import compat
from helpers.models.coordinates import coordinates
from reference.bulk import box

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Input:
    """A mesh before it is distributed.

    Attributes:
        cell: "hexahedron" or "tetrahedron".
        X: Nodes (n, 3).
        cells: Vertices in tensor order (c, 8), or (c, 4).
        body: Number of the body of each cell (c,).
        surfaces: Nodes of each surface by name.
        numbers: Number of each node before it was permuted (n,).
    """

    cell: str
    X: Array
    cells: Ints
    body: Ints
    surfaces: dict[str, Ints]
    numbers: Ints

    def permuted(self, rng: np.random.Generator) -> "Input":
        """Renumber nodes and cells, and the vertices within each cell."""
        node, cell = rng.permutation(len(self.X)), rng.permutation(len(self.cells))
        new = np.argsort(node)
        orders = _vertex_orders(self.cell)
        cells = np.array([c[orders[rng.integers(len(orders))]] for c in self.cells[cell]])
        return replace(
            self,
            X=self.X[node],
            cells=new[cells],
            body=self.body[cell],
            surfaces={name: new[nodes] for name, nodes in self.surfaces.items()},
            numbers=self.numbers[node],
        )


def _vertex_orders(cell: str) -> list[list[int]]:
    """Vertex orders that describe the same cell, mirrored ones included."""
    if cell == "tetrahedron":
        return [list(order) for order in permutations(range(4))]
    cube = np.arange(8).reshape(2, 2, 2)
    return [
        cube[flips].transpose(axes).ravel().tolist()
        for axes in permutations(range(3))
        for flips in np.ndindex(2, 2, 2)
        for flips in [tuple(slice(None, None, 1 - 2 * f) for f in flips)]
    ]


def boxes(
    shapes: Sequence[tuple[int, int, int]],
    sizes: Sequence[tuple[float, float, float]],
    cell: str = "hexahedron",
) -> Input:
    """Return boxes, each with a corner at the origin.

    Surfaces ``bottom i`` and ``top i``. Tetrahedra: six from each
    hexahedron, one for each path along its edges from the lowest corner
    to the highest.
    """
    X, cells, body, surfaces, first = [], [], [], {}, 0
    for number, (shape, size) in enumerate(zip(shapes, sizes, strict=True)):
        nodes, hexahedra = box(shape, size)
        surfaces[f"bottom {number}"] = first + np.flatnonzero(nodes[:, 2] == 0)
        surfaces[f"top {number}"] = first + np.flatnonzero(nodes[:, 2] == nodes[:, 2].max())
        if cell == "tetrahedron":
            chains = [[0, 1 << a, (1 << a) + (1 << b), 7] for a, b, _ in permutations(range(3))]
            hexahedra = hexahedra[:, chains].reshape(-1, 4)
        X.append(nodes)
        cells.append(first + hexahedra)
        body.append(np.full(len(hexahedra), number))
        first += len(nodes)
    return Input(
        cell, np.vstack(X), np.vstack(cells), np.concatenate(body), surfaces, np.arange(first)
    )


def distribute(
    comm: MPI.Comm,
    data: Input,
    *,
    owner: Callable[[Array], Ints] | None = None,
    ghosts: GhostMode = GhostMode.none,
) -> tuple[Mesh, MeshTags, MeshTags, dict[str, int]]:
    """Distribute a mesh; tags as from `read_mesh`. Collective.

    Args:
        comm: Communicator.
        data: The mesh, the same on all ranks.
        owner: Rank of each cell from the cell midpoints (c, 3).
        ghosts: Ghost mode, where ``owner`` is not given.
    """
    root = comm.rank == 0
    rows = slice(None) if root else slice(0)
    partitioner = compat.cell_partitioner(ghosts)
    if owner is not None:
        ranks = np.asarray(owner(data.X[data.cells].mean(axis=1)), dtype=np.int32)[rows, None]

        def partitioner(*_: Any) -> Any:
            return compat.cpp_object(graph.adjacencylist(ranks))

    mesh = create_mesh(
        comm=comm,
        cells=data.cells[rows],
        x=data.X[rows],
        e=coordinates(data.cell),
        partitioner=partitioner,
    )
    topology, nodes = mesh.topology, compat.geometry_nodes(mesh)
    for dims in ((2, 0), (2, 3), (3, 2)):
        topology.create_connectivity(*dims)
    body = data.body[topology.original_cell_index].astype(np.int32)
    cells = meshtags(mesh, 3, np.arange(len(body), dtype=np.int32), body)

    ids = np.empty(
        topology.index_map(0).size_local + topology.index_map(0).num_ghosts, dtype=np.int64
    )
    to_vertex = topology.connectivity(3, 0).array.reshape(nodes.shape)
    ids[to_vertex] = mesh.geometry.input_global_indices[nodes]
    k = {"hexahedron": 4, "tetrahedron": 3}[data.cell]
    facet_ids = ids[topology.connectivity(2, 0).array.reshape(-1, k)]
    tag = {f"body {number}": number for number in np.unique(data.body).tolist()}
    values = np.zeros(len(facet_ids), dtype=np.int32)
    for value, (name, nodes) in enumerate(data.surfaces.items(), start=1):
        tag[name] = value
        values[np.isin(facet_ids, nodes).all(axis=1)] = value
    tagged = np.flatnonzero(values).astype(np.int32)
    return mesh, cells, meshtags(mesh, 2, tagged, values[tagged]), tag


def in_numbers(data: Array, numbers: Ints) -> Array:
    """Rows of a permuted mesh in the numbers that it had before."""
    result = np.empty_like(data)
    result[numbers] = data
    return result
