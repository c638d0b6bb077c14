"""Thickness of bodies: distances straight through them."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined

__all__ = ["least_thickness"]

# Depth of the start of a ray below its triangle, relative to the triangle [-].
_BELOW = 1e-6
# Length of the first rays relative to the largest triangle, and growth of the length of further
# rays [-].
_FIRST_REACH, _LONGER = 4.0, 4.0


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
    normal = area_vectors(triangles, np.ones(len(triangles)))
    area = np.linalg.norm(normal, axis=1, keepdims=True)
    inward = -normal / np.where(area > 0, area, np.inf)
    begin = triangles.mean(axis=1) + _BELOW * np.sqrt(area) * inward
    begin, inward = joined(comm, begin), joined(comm, inward)
    rows = np.arange(3 * len(triangles), dtype=np.int32)
    surface = _kernels.Boundaries([rows], [rows.reshape(-1, 3)])
    surface.move(triangles.reshape(-1, 3))
    # Only the shortest ray is needed; rays are lengthened until one of them leaves the body.
    widest = float(reductions.largest(comm, float(area.max(initial=0.0))))
    reach = min(_FIRST_REACH * widest**0.5, longest) or longest
    while True:
        paths = np.hstack([begin, begin + reach * inward])
        _, places = surface.cuts(paths, np.zeros(len(paths), dtype=np.int32))
        nearest = float(reductions.least(comm, float(places.min(initial=np.inf))))
        if nearest <= 1 or reach >= longest:
            return reach * min(nearest, 1.0)
        reach = min(_LONGER * reach, longest)
