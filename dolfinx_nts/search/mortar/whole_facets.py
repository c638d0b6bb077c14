"""Whole facets in mortar contact; a facet of degree 2 consists of several segments.

Node-to-segment contact uses segments. Mortar contact integrates over facets with all their nodes,
in the order of Basix: vertices, midpoints of edges, midpoint. Multipliers belong to vertices, and
are conjugate to fields that are linear on the facet.
"""

from functools import cache

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["HatFunctions", "linear_functions", "whole_facets"]

# Vertices at the ends of the edges of facets, in the order of Basix, by number of vertices.
_EDGES = {2: [(0, 1)], 3: [(1, 2), (0, 2), (0, 1)], 4: [(0, 1), (0, 2), (1, 3), (2, 3)]}


def whole_facets(segments: Ints, degree: int) -> Ints:
    """Nodes of the facet of each segment. Local.

    Args:
        segments: Vertices of the segments, facet by facet, see `Surface`, shape ``(s, k)``.
        degree: Degree of the displacement.

    Returns:
        Shape ``(s, n)``; the segments themselves at degree 1.
    """
    if degree == 1:
        return segments
    k = segments.shape[1]
    parts = 2 if k == 2 else 4
    # Sub-triangles at the vertices come first: node j of sub-triangle i is between vertices i and
    # j.
    corners = segments.reshape(-1, parts, k)[:, :k]
    nodes = [corners[:, i, i] for i in range(k)] + [corners[:, i, j] for i, j in _EDGES[k]]
    if k == 4:
        nodes.append(corners[:, 0, 3])
    return np.repeat(np.stack(nodes, axis=1), parts, axis=0)


@cache
def linear_functions(k: int) -> Floats:
    """Linear functions of the vertices at the nodes of a facet of degree 2, ``(n, k)``."""
    rows = [np.eye(k), *((np.eye(k)[[i]] + np.eye(k)[[j]]) / 2 for i, j in _EDGES[k])]
    if k == 4:
        rows.append(np.full((1, 4), 1 / 4))
    return np.concatenate(rows)


class HatFunctions:
    """Fields on facets of degree 2 that are linear, given by vertex values (hat functions).

    Args:
        scatter: Map that contains all nodes of the facets around owned nodes.
        facets: Nodes of the facets, shape ``(f, n)``.
        k: Vertices of a facet.
    """

    def __init__(self, scatter: NodalScatter, facets: Ints, k: int) -> None:
        self._scatter = scatter
        # Vertices, and nodes that are on no facet, keep their value.
        self.parents = np.repeat(np.arange(scatter.num_local, dtype=np.int32)[:, None], k, axis=1)
        self.weights = np.zeros((scatter.num_local, k))
        self.weights[:, 0] = 1
        for node, weights in zip(facets.T[k:], linear_functions(k)[k:], strict=True):
            self.parents[node], self.weights[node] = facets[:, :k], weights

    def spread(self, values: Floats) -> Floats:
        """Evaluate a field at the owned nodes by its values at vertices, ``(n, 3)``. Collective."""
        n = len(values)
        there = self._scatter.forward(values)[self.parents[:n]]
        field: Floats = np.einsum("nk,nki->ni", self.weights[:n], there)
        return field

    def gather(self, forces: Floats) -> Floats:
        """Vertex forces conjugate to linear fields, from nodal forces, ``(n, 3)``. Collective.

        The result is 0 at mid-nodes.
        """
        n, total = len(forces), np.zeros_like(forces)
        parts = self.weights[:n, :, None] * forces[:, None]
        self._scatter.add(total, self.parents[:n], parts)
        return total
