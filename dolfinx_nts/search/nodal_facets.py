"""Facets around the nodes of a surface, also those of other ranks."""

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.facing import Facing
from dolfinx_nts.model.surfaces import NEIGHBOURS, Surface
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.points import NodalPoints

__all__ = ["NodalFacets"]

# Reach of the search for the facets around a node, relative to the longest facet [-]: they are
# at no distance but for round-off.
_AROUND = 1e-6


class NodalFacets:
    """Facets around the owned nodes of a surface, which tell what they face. Collective.

    Args:
        surface: The surface.
    """

    def __init__(self, surface: Surface) -> None:
        """Find the facets around each node, and their angles there."""
        X = surface.V.tabulate_dof_coordinates()
        near, _ = GlobalSearch(surface, surface).update(X, _AROUND * surface.size)
        self._scatter, self._nodes = near.scatter, surface.nodes
        number = np.full(near.scatter.num_local, -1, dtype=np.int32)
        number[surface.nodes] = np.arange(len(surface.nodes), dtype=np.int32)
        node = number[near.segments].ravel()
        order = np.argsort(node, kind="stable")[np.count_nonzero(node < 0) :]
        facet, _ = np.divmod(order, near.segments.shape[1])
        counts = np.bincount(node[order], minlength=len(surface.nodes))
        self._kernel = _kernels.NodeFacets(
            near.segments,
            near.orientation,
            np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
            facet.astype(np.int32),
            _angles(near.scatter.forward(X)[near.segments]).ravel()[order],
        )
        self._numbers: Ints = np.arange(len(surface.nodes), dtype=np.int32)

    def points(self, x: Floats) -> NodalPoints:
        """Make contact points of the nodes that face what they do at positions x. Collective.

        ``x`` are positions of the local nodes of the space, owned and ghost, ``(l, 3)`` [m].
        """
        # The positions stay, whatever becomes of x.
        facing = Facing(self._kernel, self._scatter.forward(x).copy(), self._numbers)
        return NodalPoints(self._nodes, facing)


def _angles(x: Floats) -> Floats:
    """Angles of facets at their vertices, ``(f, k)``, by positions ``(f, k, 3)``."""
    if x.shape[1] == 2:  # both edges at a node count alike
        return np.ones(x.shape[:2])
    neighbours = np.array(NEIGHBOURS[x.shape[1]])
    a, b = (x[:, neighbours[:, side]] - x for side in (0, 1))
    sine = np.linalg.norm(np.cross(a, b), axis=2)
    angles: Floats = np.arctan2(sine, np.einsum("fki,fki->fk", a, b))
    return angles
