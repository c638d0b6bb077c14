"""Nodes of a surface on its convex edges and corners."""

from itertools import combinations

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.obstacles.rims import SHARP
from dolfinx_nts.model.segments import area_vectors, diameters
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.nodal_facets import NodalFacets

__all__ = ["nodes_on_kinks"]


def nodes_on_kinks(surface: Surface) -> tuple[Flags, Floats]:
    """Find the owned nodes at which the surface turns by 30 degrees or more. Collective.

    Two facets around such a node have normals that differ by at least this angle in the reference
    configuration, and one of them is behind the plane of the other one. Facets beyond a free edge
    of the surface are unknown.

    Args:
        surface: The surface.

    Returns:
        Flags of the owned nodes, shape ``(n,)``, and diameter of the smallest facet around each,
        shape ``(n,)`` [m].
    """
    around = NodalFacets(surface).around
    x = around.scatter.forward(reference_positions(surface.V))
    corners = x[around.vertices]
    vectors = area_vectors(corners, around.orientation)
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    normals, centres = vectors / np.where(length > 0, length, 1.0), corners.mean(axis=1)
    n, most = len(around.counts), int(around.counts.max(initial=0))
    # Facets of each node, with rows padded by the first facet.
    first = np.cumsum([0, *around.counts])[:-1]
    place = np.minimum(np.arange(most), around.counts[:, None] - 1)
    table = around.facets[first[:, None] + place] if n else np.empty((0, most), dtype=np.int32)
    flags = np.zeros(n, dtype=bool)
    for i, j in combinations(range(most), 2):
        normal, beyond = normals[table[:, i]], centres[table[:, j]] - x[around.nodes]
        turns = np.einsum("ni,ni->n", normal, normals[table[:, j]]) < SHARP
        flags |= turns & (np.einsum("ni,ni->n", normal, beyond) < 0)
    smallest = diameters(corners)[table].min(axis=1) if n else np.empty(0)
    return flags, smallest
