"""Closed boundaries of whole bodies, made of triangles.

In the plane a boundary consists of edges, which are extruded along z into triangles.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from basix import CellType, topology
from dolfinx import fem, la
from dolfinx.mesh import exterior_facet_indices

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.bodies import Body, common_space
from dolfinx_nts.model.segments import area_vectors, diameters
from dolfinx_nts.parallel import reductions

__all__ = [
    "ClosedBoundary",
    "boundary_of_mesh",
    "closed_boundaries",
    "outward_triangles",
    "raised",
    "triangles_at",
    "wall_height",
    "walls",
]

# Triangles and edges of a segment, by its number of vertices in Basix order.
_TRIANGLES = {
    2: np.array([[0, 1]]),
    3: np.array([[0, 1, 2]]),
    4: np.array([[0, 1, 2], [1, 3, 2]]),
}
# Height of the extrusion of a boundary in the plane, relative to its extent [-].
_HEIGHT = 1e3
_EDGES = {
    len(topology(cell)[0]): np.array(topology(cell)[1])
    for cell in (CellType.interval, CellType.triangle, CellType.quadrilateral)
}


@dataclass(frozen=True)
class ClosedBoundary:
    """Owned part of the boundary of bodies that share nodes.

    Attributes:
        bodies: The bodies.
        nodes: Nodes on the boundary, owned local block indices of V, shape ``(n,)``.
        triangles: Vertices of triangles with outward normals, local block indices of V, shape
            ``(t, 3)``. A quadrilateral gives two triangles. In the plane edges, ``(t, 2)``.
        edges: Vertices of the edges of segments, shape ``(e, 2)``.
        cells: Nodes of the cells of the bodies, shape ``(c, k)``.
        size: Longest diameter of a segment of any rank in the reference configuration [m].
    """

    bodies: tuple[Body, ...]
    nodes: Ints
    triangles: Ints
    edges: Ints
    cells: Ints
    size: float


def closed_boundaries(groups: Sequence[Sequence[Body]]) -> list[ClosedBoundary]:
    """Find the boundaries of groups of bodies. Collective.

    Args:
        groups: Bodies that share nodes, see `bodies.connected`, with every cell of the mesh in
            one of them.

    Returns:
        The boundary of each group.
    """
    V = common_space([body for group in groups for body in group])
    X, index_map = reference_positions(V), V.dofmap.index_map
    segments, orientation, cell = _segments(V)
    marker = la.vector(index_map)
    marker.array[segments.ravel()] = 1
    marker.scatter_reverse(la.InsertMode.add)
    on_boundary = marker.array[: index_map.size_local] > 0
    k = segments.shape[1]
    of_groups = [np.concatenate([body.cells for body in group]) for group in groups]
    group_of = np.full(len(V.dofmap.list), len(groups))
    for number, cells in enumerate(of_groups):
        group_of[cells] = number
    order = np.argsort(group_of[cell], kind="stable")
    first = np.searchsorted(group_of[cell][order], np.arange(len(groups) + 1))
    boundaries = []
    for number, (group, cells) in enumerate(zip(groups, of_groups, strict=True)):
        mine = order[first[number] : first[number + 1]]
        some, size = segments[mine], diameters(X[segments[mine]]).max(initial=0.0)
        nodes = np.unique(np.concatenate([body.nodes for body in group]))
        nodes = nodes[nodes < index_map.size_local]
        boundaries.append(
            ClosedBoundary(
                tuple(group),
                nodes[on_boundary[nodes]],
                outward_triangles(some, orientation[mine]),
                np.unique(np.sort(some[:, _EDGES[k]].reshape(-1, 2), axis=1), axis=0),
                V.dofmap.list[cells],
                float(reductions.largest(V.mesh.comm, float(size))),
            )
        )
    return boundaries


def boundary_of_mesh(V: fem.FunctionSpace) -> Ints:
    """Triangles with outward normals, or in the plane edges, of the boundary of the mesh. Local.

    The triangles or edges belong to cells of this rank, as in `ClosedBoundary`.
    """
    segments, orientation, _ = _segments(V)
    return outward_triangles(segments, orientation)


def outward_triangles(segments: Ints, orientation: Floats) -> Ints:
    """Split segments into triangles with outward normals. Local.

    Args:
        segments: Vertices in Basix order, shape ``(s, k)``.
        orientation: +1 where a_1 x a_2 points outward, otherwise -1, shape ``(s,)``.

    Returns:
        Vertices of the triangles, two for a quadrilateral, shape ``(t, 3)``.
    """
    triangles: Ints = segments[:, _TRIANGLES[segments.shape[1]]]
    inward = orientation < 0
    triangles[inward] = triangles[inward, :, ::-1]
    return triangles.reshape(-1, triangles.shape[-1])


def triangles_at(comm: MPI.Comm, x: Floats, triangles: Ints) -> Floats:
    """Positions of triangles, in the plane of the triangles of extruded edges. Collective.

    The extrusion is so high that its ends do not affect rays and solid angles. The height is the
    same on all ranks.

    Args:
        comm: Communicator.
        x: Positions of the nodes, shape ``(l, 3)`` [m].
        triangles: Triangles or edges of a `ClosedBoundary`.

    Returns:
        Shape ``(t, 3, 3)`` [m], two triangles for each edge.
    """
    if triangles.shape[1] == 2:
        height = wall_height(comm, x[triangles])
        x, triangles = raised(x, height), walls(triangles, len(x))
    corners: Floats = x.take(triangles, axis=0)
    return corners


def wall_height(comm: MPI.Comm, x: Floats) -> float:
    """Height of the extrusion for positions of shape ``(..., 3)`` [m]. Collective."""
    extent = float(np.ptp(x.reshape(-1, 3), axis=0).max()) if x.size else 0.0
    return _HEIGHT * reductions.largest(comm, extent)


def raised(x: Floats, height: float) -> Floats:
    """Positions ``(l, 3)`` shifted by -height, then by +height along z: ``(2 l, 3)`` [m]. Local."""
    up = np.array([0.0, 0.0, height])
    return np.concatenate([x - up, x + up])


def walls(edges: Ints, num_nodes: int) -> Ints:
    """Triangles of extruded edges, as rows of `raised` positions. Local.

    Args:
        edges: Ends of the edges, oriented outward, shape ``(t, 2)``.
        num_nodes: Number of positions in the plane.

    Returns:
        Shape ``(2 t, 3)``.
    """
    (a, b), n = edges.T, num_nodes
    corners: Ints = np.column_stack([a, b, b + n, a, b + n, a + n]).astype(np.int32)
    return corners.reshape(-1, 3)


def _segments(V: fem.FunctionSpace) -> tuple[Ints, Floats, Ints]:
    """Owned segments of the boundary of the mesh, their orientations and cells."""
    mesh_topology, X, dofs = V.mesh.topology, reference_positions(V), V.dofmap.list
    tdim = mesh_topology.dim
    both = (tdim - 1, tdim), (tdim, tdim - 1)
    for dims in both:
        mesh_topology.create_connectivity(*dims)
    to_cell, to_facet = (mesh_topology.connectivity(*dims) for dims in both)
    facets = exterior_facet_indices(mesh_topology)
    cells = to_cell.array[to_cell.offsets[facets]]
    sides = Element.of(V).sides
    number = (to_facet.array.reshape(-1, len(sides))[cells] == facets[:, None]).argmax(axis=1)
    parts = []
    for i, (segments, pieces) in enumerate(sides):
        some = cells[number == i]
        x, behind = X[dofs[some][:, segments]], X[dofs[some][:, pieces]]
        outward = x.mean(axis=2) - behind.mean(axis=2)
        vertices = x.reshape(-1, *x.shape[2:])
        normal = area_vectors(vertices, np.ones(len(vertices)))
        sense = np.sign(np.einsum("si,si->s", normal, outward.reshape(-1, 3)))
        rows = dofs[some][:, segments].reshape(-1, segments.shape[1])
        parts.append((rows, sense, np.repeat(some, len(segments))))
    segments, orientation, cell = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return segments, orientation, cell
