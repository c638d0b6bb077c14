"""Thickness of bodies behind the segments of a surface."""

import weakref

import numpy as np
from dolfinx import fem

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.closed_boundaries import boundary_of_mesh, outward_triangles, triangles_at
from dolfinx_nts.model.segments import area_vectors, diameters
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined

__all__ = ["wall_thickness"]

# Depth of the start of a ray below its facet, relative to the facet [-].
_BELOW = 1e-6
# Boundaries of the parts of meshes on this rank, by the `id` of a space; an entry is deleted with
# its space.
_KNOWN: dict[int, _kernels.Boundaries] = {}


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
    comm = V.mesh.comm
    boundary, X = _boundary(V), reference_positions(V)
    triangles = outward_triangles(segments, surface.orientation)
    corners: Floats = X[triangles]
    normal = area_vectors(corners, np.ones(len(corners)))
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    inward = -normal / np.where(length > 0, length, np.inf)
    begin = corners.mean(axis=1) + _BELOW * diameters(corners)[:, None] * inward
    if triangles.shape[1] == 2:
        # Rays that hit the edges between triangles of an extruded boundary could miss both.
        begin[:, 2] += farthest
    paths = joined(comm, np.hstack([begin, begin + farthest * inward]))
    cut, places = boundary.cuts(paths, np.zeros(len(paths), dtype=np.int32))
    nearest: Floats = np.ones(len(paths))
    np.minimum.at(nearest, cut[:, 0], places)
    nearest = reductions.least(comm, nearest)
    first = comm.exscan(len(corners)) or 0
    own = nearest[first : first + len(corners)]
    num_triangles = 2 if segments.shape[1] == 4 else 1
    thickness: Floats = farthest * own.reshape(-1, num_triangles).min(axis=1, initial=1.0)
    return thickness


def _boundary(V: fem.FunctionSpace) -> _kernels.Boundaries:
    """Boundary of the cells of this rank in the reference configuration. Collective."""
    if id(V) not in _KNOWN:
        corners = triangles_at(V.mesh.comm, reference_positions(V), boundary_of_mesh(V))
        rows = np.arange(3 * len(corners), dtype=np.int32)
        boundary = _kernels.Boundaries([rows], [rows.reshape(-1, 3)])
        boundary.move(corners.reshape(-1, 3))
        _KNOWN[id(V)] = boundary
        weakref.finalize(V, _KNOWN.pop, id(V))
    return _KNOWN[id(V)]
