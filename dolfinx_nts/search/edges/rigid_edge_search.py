"""Search for crossings with edges of a faceted rigid obstacle, which exists on all ranks."""

from weakref import WeakKeyDictionary

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.obstacles.rigid_surface import RigidSurface
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.search.edges.current_edges import Edges, pairs_within
from dolfinx_nts.search.edges.rigid_edge_candidates import RigidEdgeCandidates
from dolfinx_nts.search.edges.sharp_edges import SharpEdges, sharp_between
from dolfinx_nts.search.obstacle_candidates import ObstacleSearch

__all__ = ["RigidEdgeSearch", "num_sharp_edges"]

# Search radius relative to the requested one [-].
_MARGIN = 1.5
# Largest distance of edges, in longest facets of the nodal surface [-], if the reach is infinite.
_FARTHEST = 4.0


class RigidEdgeSearch(ObstacleSearch):
    """Search for edges of an obstacle near the edges of a surface. Collective.

    Args:
        obstacle: The obstacle.
        nodes: Surface whose nodes carry the multipliers.
    """

    def __init__(self, obstacle: RigidSurface, nodes: Surface) -> None:
        super().__init__(obstacle, nodes)
        own = SharpEdges.of(nodes)
        self._scatter, self._ends = own.scatter, own.ends
        corners, other = _rigid_edges(obstacle)
        first = own.scatter.num_local
        self._corners, self._num_others = corners, len(other.key)
        self._edges = (
            Edges(own.nodes, own.facets, own.key, own.thickness),
            Edges(other.ends + first, other.facets + first, other.key, other.thickness),
        )
        self._farthest = _FARTHEST * nodes.size
        # Positions of nodes at the last search, and its reach [m].
        self._covered: tuple[Floats, float] | None = None

    def is_near(self, x: Floats, reach: float) -> bool:
        return super().is_near(x, reach + self._nodes.size)

    def update(self, x: Floats, reach: float) -> tuple[Candidates, bool]:
        reach = min(reach, self._farthest)
        none = np.empty((0, 3))
        if self._covered is not None:
            before, covered = self._covered
            if self.approach(x, (before, none)) + reach <= covered:
                return self.candidates, False
        self._find(x, _MARGIN * reach)
        self.num_searches += 1
        return self.candidates, True

    def _find(self, x: Floats, reach: float) -> None:
        """Pair edges whose boxes are within the search radius [m]."""
        self._covered = self.positions(x)[0], reach
        x, (own, other) = np.concatenate([self._scatter.forward(x), self._corners]), self._edges
        found = pairs_within(own, other, self._num_others, x, reach)
        edges = self._scatter, own, other, *found, x
        self.candidates = RigidEdgeCandidates(self._corners, self.frame, *edges)

    def serialize(self, archive: Archive, name: str) -> None:
        covered = self._covered
        arrays = None if covered is None else (covered[0], np.array(covered[1]))
        stored = archive.local(name, arrays)
        if not archive.restores:
            return
        self._covered = None
        if stored is not None:
            x_nodes, reach = stored
            x = np.zeros((len(reference_positions(self._nodes.V)), 3))
            x[self._nodes.nodes] = x_nodes
            self._find(x, float(reach))


def num_sharp_edges(surface: Surface | Obstacle) -> int:
    """Number of convex edges of 30 degrees or more of a surface, on all ranks. Collective."""
    if isinstance(surface, Surface):
        return SharpEdges.of(surface).total
    return len(_rigid_edges(surface)[1].key) if isinstance(surface, RigidSurface) else 0


# Cache of the edges of obstacles.
_KNOWN: WeakKeyDictionary[RigidSurface, tuple[Floats, Edges]] = WeakKeyDictionary()


def _rigid_edges(obstacle: RigidSurface) -> tuple[Floats, Edges]:
    """Unique vertices of an obstacle, ``(n, 3)`` [m], and its edges. Local.

    Facets from files often do not share vertices.
    """
    if obstacle not in _KNOWN:
        points, facets, orientation = obstacle.facets
        corners, place = np.unique(points, axis=0, return_inverse=True)
        facets = np.ascontiguousarray(place.ravel()[facets], dtype=np.int32)
        ends, _, outward = sharp_between(corners, facets, orientation, np.arange(len(corners)))
        key = np.arange(len(ends), dtype=np.int64)
        thickness = np.full(len(ends), np.inf)
        _KNOWN[obstacle] = corners, Edges(ends, outward, key, thickness)
    return _KNOWN[obstacle]
