"""Thickness of bodies: distances straight through them, along inward normals."""

import weakref

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.closed_boundaries import boundary_of_mesh, outward_triangles, triangles_at
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined

__all__ = ["least_thickness", "wall_thickness"]

# Depth of the start of a ray below its facet, relative to the shortest edge of the facet [-].
_BELOW = 1e-6
# Length of the first rays relative to the largest of these edges, and growth of the length of
# further rays [-].
_FIRST_REACH, _LONGER = 4.0, 4.0
# Reference positions of a space, and the boundary of the cells of this rank at these, by the `id`
# of the space; an entry is deleted with its space.
_KNOWN: dict[int, tuple[Floats, _kernels.Boundaries]] = {}


def least_thickness(comm: MPI.Comm, triangles: Floats) -> float:
    """Least thickness of a body, along inward normals of its surface. Collective.

    Rays start at the midpoint of each triangle. For rays without an exit the size of the surface
    is used.

    Args:
        comm: Communicator.
        triangles: Vertices of the triangles of this rank, oriented outward, ``(t, 3, 3)`` [m].

    Returns:
        The thickness, the same on all ranks [m].
    """
    corners = triangles.reshape(-1, 3).T
    least = np.stack([corners.min(axis=1, initial=np.inf), -corners.max(axis=1, initial=-np.inf)])
    lower, upper = reductions.least(comm, least) * [[1], [-1]]
    longest = float(np.linalg.norm(upper - lower))
    begin, inward = (joined(comm, each) for each in _rays(triangles))
    boundary = _boundary(triangles)
    # Only the shortest ray is needed; rays are lengthened until one of them leaves the body.
    widest = reductions.largest(comm, float(_shortest_edges(triangles).max(initial=0.0)))
    reach = min(_FIRST_REACH * widest, longest) or longest
    while True:
        nearest = float(_exits(comm, boundary, begin, inward, reach).min(initial=np.inf))
        if nearest < reach or reach >= longest:
            return min(nearest, reach)
        reach = min(_LONGER * reach, longest)


def wall_thickness(surface: Surface, farthest: float) -> Floats:
    """Undeformed thickness of the body behind each segment, along its inward normal. Collective.

    Bodies that share nodes count as one.

    Args:
        surface: The surface.
        farthest: Thickness above which it need not be known [m].

    Returns:
        Thickness of the segments of this rank, at most ``farthest``, shape ``(s,)`` [m].
    """
    V, segments = surface.V, surface.segments
    X, comm = reference_positions(V), V.mesh.comm
    triangles: Floats = X[outward_triangles(segments, surface.orientation)]
    begin, inward = _rays(triangles)
    if triangles.shape[1] == 2:
        # Rays that hit the edges between triangles of an extruded boundary could miss both.
        begin[:, 2] += farthest
    if id(V) not in _KNOWN:
        weakref.finalize(V, _KNOWN.pop, id(V))
    # The nodes of some ranks only may have moved.
    if id(V) not in _KNOWN or reductions.anywhere(comm, _KNOWN[id(V)][0] is not X):
        _KNOWN[id(V)] = X, _boundary(triangles_at(comm, X, boundary_of_mesh(V)))
    rays = joined(comm, begin), joined(comm, inward)
    of_all = _exits(comm, _KNOWN[id(V)][1], *rays, farthest)
    first = comm.exscan(len(begin)) or 0
    num_triangles = 2 if segments.shape[1] == 4 else 1
    own = of_all[first : first + len(begin)].reshape(-1, num_triangles)
    thickness: Floats = own.min(axis=1, initial=farthest)
    return thickness


def _rays(facets: Floats) -> tuple[Floats, Floats]:
    """Starts just below facets ``(t, k, 3)``, and inward unit normals, ``(t, 3)`` [m]. Local."""
    normal = _kernels.unit_vectors(area_vectors(facets, np.ones(len(facets))))
    return facets.mean(axis=1) - _BELOW * _shortest_edges(facets)[:, None] * normal, -normal


def _shortest_edges(facets: Floats) -> Floats:
    """Length of the shortest edge of each facet ``(t, k, 3)``, shape ``(t,)`` [m]. Local.

    The other edges of extruded boundaries of a 2-D mesh can be much longer than the body.
    """
    edges = facets - np.roll(facets, 1, axis=1)
    shortest: Floats = np.linalg.norm(edges, axis=2).min(axis=1)
    return shortest


def _boundary(triangles: Floats) -> _kernels.Boundaries:
    """Boundary kernel with the triangles of this rank, ``(t, 3, 3)`` [m]. Local."""
    rows = np.arange(3 * len(triangles), dtype=np.int32)
    boundary = _kernels.Boundaries([rows], [rows.reshape(-1, 3)])
    boundary.move(triangles.reshape(-1, 3))
    return boundary


def _exits(
    comm: MPI.Comm, boundary: _kernels.Boundaries, begin: Floats, inward: Floats, reach: float
) -> Floats:
    """Length of each ray to the boundary of any rank, at most ``reach``, ``(r,)`` [m]. Collective.

    All ranks give the same rays: starts [m] and unit directions, both ``(r, 3)``.
    """
    paths = np.hstack([begin, begin + reach * inward])
    cut, places = boundary.cuts(paths, np.zeros(len(paths), dtype=np.int32))
    nearest: Floats = np.ones(len(paths))
    np.minimum.at(nearest, cut[:, 0], places)
    lengths: Floats = reach * reductions.least(comm, nearest)
    return lengths
