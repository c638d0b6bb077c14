"""Free edges (rims) of a surface, which belong to one facet only."""

import numpy as np
from basix import CellType, topology

from dolfinx_nts.common.arrays import Flags, Floats, Ints

__all__ = ["FACET_EDGES", "SHARP", "is_nearest_a_rim"]

# Cosine of the angle between facets [-] below which an edge is sharp: 30 degrees, with a margin for
# the round-off of a prism with twelve sides.
SHARP = np.cos(np.radians(30 - 1e-6))
# Vertices at the ends of each edge, by the number of vertices of a facet. In the plane a facet has
# two vertices.
FACET_EDGES = {
    len(topology(cell)[0]): topology(cell)[1]
    for cell in (CellType.triangle, CellType.quadrilateral)
} | {2: [[0, 0], [1, 1]]}


def is_nearest_a_rim(points: Floats, x: Floats, facets: Ints, facet: Ints) -> Flags:
    """Whether the edge of a facet nearest to a point is a free edge of the surface. Local.

    Args:
        points: The points, shape ``(m, 3)`` [m].
        x: Positions of the vertices, shape ``(l, 3)`` [m].
        facets: Vertices of all facets in Basix order, shape ``(s, k)``.
        facet: Facet of each point, shape ``(m,)``.

    Returns:
        Flags, shape ``(m,)``.
    """
    edges = facets[:, FACET_EDGES[facets.shape[1]]]
    begin, end = np.moveaxis(x[edges[facet]], 2, 0)
    along, r = end - begin, points[:, None] - begin
    square = np.einsum("mei,mei->me", along, along)
    part = np.einsum("mei,mei->me", r, along) / np.where(square > 0, square, 1)
    distance = np.linalg.norm(r - np.clip(part, 0, 1)[..., None] * along, axis=2)
    nearest = np.sort(edges[facet, distance.argmin(axis=1)])
    count = (np.sort(edges.reshape(-1, 2))[:, None] == nearest).all(axis=2).sum(axis=0)
    rim: Flags = count == 1
    return rim
