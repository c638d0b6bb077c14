"""Facets around the nodes of a surface, also those of other ranks."""

from typing import NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.facing import Facing
from dolfinx_nts.model.segments import NEIGHBOURS
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["AroundNodes", "NodalFacets"]

# Reach of the search for the facets around a node, relative to the longest facet [-]: they are
# at no distance but for round-off.
_AROUND = 1e-6


class AroundNodes(NamedTuple):
    """Facets around nodes, see `cpp/nts/search/facing.h`.

    Attributes:
        scatter: Map of the nodes that the facets need.
        nodes: Owned nodes, shape ``(n,)``.
        vertices: Vertices of the facets, nodes of the map, shape ``(f, k)``.
        orientation: +1 where a_1 x a_2 points out of the body, otherwise -1, ``(f,)``.
        counts: Number of facets around each node, shape ``(n,)``.
        facets: These, node by node, shape ``(e,)``.
        angle: Angles of the facets at the nodes, shape ``(e,)`` [rad].
    """

    scatter: NodalScatter
    nodes: Ints
    vertices: Ints
    orientation: Floats
    counts: Ints
    facets: Ints
    angle: Floats


class NodalFacets:
    """Facets around the owned nodes of a surface, which tell what they face. Collective.

    Args:
        surface: The surface.

    Attributes:
        around: The facets.
    """

    def __init__(self, surface: Surface) -> None:
        """Find the facets around each node, and their angles there."""
        X = surface.V.tabulate_dof_coordinates()
        near, _ = GlobalSearch(surface, surface).update(X, _AROUND * surface.size)
        number = np.full(near.scatter.num_local, -1, dtype=np.int32)
        number[surface.nodes] = np.arange(len(surface.nodes), dtype=np.int32)
        node = number[near.segments].ravel()
        order = np.argsort(node, kind="stable")[np.count_nonzero(node < 0) :]
        facet, _ = np.divmod(order, near.segments.shape[1])
        counts = np.bincount(node[order], minlength=len(surface.nodes))
        angle = _angles(near.scatter.forward(X)[near.segments]).ravel()[order]
        facets = near.segments, near.orientation, counts.astype(np.int32), facet.astype(np.int32)
        self._take(AroundNodes(near.scatter, surface.nodes, *facets, angle))

    def _take(self, around: AroundNodes, group: Ints | None = None) -> None:
        """Hand facets over to the kernels.

        ``group`` are those of segments that the nodes may touch, shape ``(n,)``; None: there is
        one.
        """
        self.around, counts = around, around.counts
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        facets = around.vertices, around.orientation, first, around.facets, around.angle
        self._kernel = _kernels.NodeFacets(*facets, group)
        self._numbers: Ints = np.arange(len(counts), dtype=np.int32)

    def points(self, x: Floats) -> NodalPoints:
        """Make contact points of the nodes that face what they do at positions x. Collective.

        ``x`` are positions of the local nodes of the space, owned and ghost, ``(l, 3)`` [m].
        """
        # The positions stay, whatever becomes of x.
        facing = Facing(self._kernel, self.around.scatter.forward(x).copy(), self._numbers)
        return NodalPoints(self.around.nodes, facing)


def _angles(x: Floats) -> Floats:
    """Angles of facets at their vertices, ``(f, k)``, by positions ``(f, k, 3)``."""
    if x.shape[1] == 2:  # both edges at a node count alike
        return np.ones(x.shape[:2])
    neighbours = np.array(NEIGHBOURS[x.shape[1]])
    a, b = (x[:, neighbours[:, side]] - x for side in (0, 1))
    sine = np.linalg.norm(np.cross(a, b), axis=2)
    angles: Floats = np.arctan2(sine, np.einsum("fki,fki->fk", a, b))
    return angles
