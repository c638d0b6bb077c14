"""Self-overlaps of bodies.

If no cell is inverted, the winding number of the boundary counts how often the body covers a
point: once just below the boundary, and twice inside another part of the body.
"""

from itertools import product
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats, GlobalInts, Ints
from dolfinx_nts.model.closed_boundaries import ClosedBoundary
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.search.overlap.inside import Insides

__all__ = ["SelfOverlap", "self_overlap"]

# Position of test points near the vertex of a facet, relative to the facet [-]: distance towards
# the midpoint, so that no other facet is as near, and depth below the facet.
_ASIDE, _BELOW = 1e-3, 1e-4
# Depth relative to the longest facet [-] that counts as touching.
_TOUCHING = 1e-3


class SelfOverlap(NamedTuple):
    """Self-overlap of a body.

    Attributes:
        depth: Depth of the deepest node or facet midpoint, in one of six directions [m].
        nodes: Number of nodes on the boundary that are inside.
        cells: Number of cells whose centres are inside another part.
    """

    depth: float
    nodes: int
    cells: int


def self_overlap(
    insides: Insides,
    number: int,
    boundary: ClosedBoundary,
    x: Floats,
    centres: Floats,
    touch: float,
) -> SelfOverlap | None:
    """Self-overlap of a body, or None if it is within the tolerance. Collective.

    Args:
        insides: The boundaries at the current positions.
        number: Number of the boundary among them.
        boundary: The boundary.
        x: Positions of the local nodes of the space, owned and ghost, shape ``(l, 3)`` [m].
        centres: Centres of the cells of this rank, shape ``(c, 3)`` [m].
        touch: Depth that counts as touching [m].
    """
    V = boundary.bodies[0].V
    comm: MPI.Comm = V.mesh.comm
    node, points, frames = _below(boundary.triangles, x)
    ids: GlobalInts = np.full(len(points), -1, dtype=np.int64)
    ids[: len(node)] = V.dofmap.index_map.local_to_global(node)
    ids, points, frames = (joined(comm, some) for some in (ids, points, frames))
    within = insides.times(points, _all(number, points)) > 1
    ids, points, frames = ids[within], points[within], frames[within]
    if not len(ids):
        return None  # on all ranks
    depth = _depth(insides, number, points, frames, boundary.size)
    deep = depth > max(touch, _TOUCHING * boundary.size)
    if not deep.any():
        return None
    centres = joined(comm, centres)
    num_cells = int(np.count_nonzero(insides.times(centres, _all(number, centres)) > 1))
    # Ranks may have found a shared node in different triangles.
    num_nodes = len(np.unique(ids[deep & (ids >= 0)]))
    return SelfOverlap(float(depth.max()), num_nodes, num_cells)


def _depth(insides: Insides, number: int, points: Floats, frames: Floats, size: float) -> Floats:
    """Least distance in six directions to the boundary of the other part, ``(m,)`` [m]. Collective.

    Arguments as for `self_overlap`, and the results of `_below`.
    """
    longest = insides.diameter(number)
    parts = []
    for i, sign in product(range(3), (1.0, -1.0)):
        paths = np.hstack([points, points + sign * longest * frames[:, i]])
        # The first exits of outward rays are the facet of the point, or two facets in contact.
        # Lateral rays may leave the same part of the body at a nearby edge.
        is_outward, is_aside = i == 0 and sign < 0, i > 0
        least = 2 * _ASIDE * size / longest if is_aside else 0.0
        parts.append(insides.exit_fractions(paths, _all(number, paths), int(is_outward), least))
    depth: Floats = longest * np.min(parts, axis=0)
    return depth


def _all(number: int, points: Floats) -> Ints:
    return np.full(len(points), number, dtype=np.int32)


def _below(triangles: Ints, x: Floats) -> tuple[Ints, Floats, Floats]:
    """Points just below the nodes of triangles, and below the middle of each.

    Args:
        triangles: Triangles of a `ClosedBoundary`.
        x: Positions of the local nodes [m].

    Returns:
        The nodes, ``(n,)``; the points, nodes first, ``(m, 3)`` [m]; and inward normals
        and two tangents, ``(m, 3, 3)``. Local.
    """
    node, first = np.unique(triangles, return_index=True)
    vertex = np.concatenate([node, triangles[:, 0]])
    triangle = np.concatenate([first // triangles.shape[1], np.arange(len(triangles))])
    corners = x[triangles[triangle]]
    inward = -_unit(area_vectors(corners, np.ones(len(corners))))
    to_middle = corners.mean(axis=1) - x[vertex]
    size = np.linalg.norm(to_middle, axis=1, keepdims=True)
    along = _unit(to_middle)
    part = np.ones((len(corners), 1))
    part[: len(node)] = _ASIDE
    points = x[vertex] + part * to_middle + _BELOW * size * inward
    frames = np.stack([inward, along, np.cross(inward, along)], axis=1)
    return node.astype(np.int32), points, frames


def _unit(vectors: Floats) -> Floats:
    """Vectors of unit length, ``(m, 3)``, or zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit: Floats = vectors / np.where(length > 0, length, np.inf)
    return unit
