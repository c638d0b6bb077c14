"""Nodes that meet an obstacle, in the place of a search for segments.

What a contact pair asks of a neighbourhood, answered by an `Obstacle`.
"""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, GlobalInts, Ints
from dolfinx_nts.model.obstacles import Contact, Obstacle
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["ObstacleCandidates"]


class ObstacleCandidates:
    """An obstacle as `SegmentCandidates` and `GlobalSearch` in one.

    Segments are the obstacle's facets; pairs consist of the node alone, so
    that d = 3 and no rank needs anything of another. Local, but for `approach`.

    Args:
        obstacle: The obstacle.
        nodes: Surface whose nodes meet it.

    Attributes:
        obstacle: The obstacle.
        index_map: That of the nodes' space.
        num_local: Owned nodes.
        key: Number of each facet, shape ``(f,)``.
        size: Longest facet of the nodes' surface, shape ``(f,)`` [m].
    """

    def __init__(self, obstacle: Obstacle, nodes: Surface) -> None:
        """Keep both."""
        self.obstacle, self._nodes = obstacle, nodes
        self.index_map = nodes.V.dofmap.index_map
        self.num_local = int(self.index_map.size_local)
        self.key = obstacle.key
        self.size = np.full(len(self.key), nodes.size)

    def update(self, x: Floats, reach: float) -> tuple["ObstacleCandidates", bool]:
        """Itself: there is nothing to search."""
        return self, False

    def places(self, x: Floats) -> tuple[Floats, Floats]:
        """Positions of this rank's nodes, and of no vertices, for `approach`."""
        return x[self._nodes.nodes], np.empty((0, 3))

    def approach(self, x: Floats, before: Sequence[Floats]) -> float:
        """By how much any node may be closer than it was [m]. Collective."""
        moved = _kernels.farthest(x.take(self._nodes.nodes, axis=0), before[0])
        return float(reductions.largest(self._nodes.V.mesh.comm, moved))

    @property
    def candidates(self) -> "ObstacleCandidates":
        """Itself."""
        return self

    def serialize(self, archive: Archive, name: str) -> None:
        """Nothing: an obstacle has no state."""

    def find(self, key: GlobalInts) -> Ints:
        """Facet of each key, -1 where there is none."""
        return key.astype(np.int32)

    def with_ghosts(self, owned: Floats) -> Floats:
        """The owned values."""
        return owned

    def add_to_owners(self, total: Floats, dofs: Ints, values: Floats) -> None:
        """Add values of some nodes, each once, to all. Local."""
        total[dofs[:, 0]] += values[:, 0]

    def to_owners(self, values: Floats) -> Floats:
        """The values, as no other rank has any for owned nodes."""
        return values

    def dofs(self, nodes: Ints, segment: Ints) -> Ints:
        """Nodes of pairs, shape ``(m, 1)``."""
        return nodes[:, None].astype(np.int32)

    def pair(
        self,
        x: Floats,
        nodes: Ints,
        current: Ints,
        reach: float,
        slack: float = _kernels.HYSTERESIS,
    ) -> tuple[Ints, Floats]:
        """Facet of each node or -1, and gap [m], NaN without; shape ``(n,)``."""
        found, gap = self.obstacle.find(x[nodes], current, slack, reach)
        return found, np.where(found >= 0, gap, np.nan)

    def penalty_forces(
        self,
        x: Floats,
        numbers: Ints,
        nodes: Ints,
        current: Ints,
        reach: float,
        stiffness: Floats,
    ) -> tuple[Ints, Floats, _kernels.Springs]:
        """Springs of nodes inside, see `SegmentCandidates.press`."""
        segment, gap = self.pair(x, nodes, current, reach)
        (inside,) = (gap < 0).nonzero()
        nodes, facet, depth = nodes[inside], segment[inside], gap[inside]
        lambda_N, gradient = stiffness[inside] * depth, self.gap_gradient(x, nodes, facet)
        force = -lambda_N[:, None, None] * gradient[:, None]
        springs = _kernels.Springs(
            numbers[inside], self.key[facet], nodes[:, None], force, lambda_N * depth / 2
        )
        return segment, gap, springs

    def near(self, x: Floats, nodes: Ints, reach: float) -> Ints:
        """Nodes within reach of a facet, at least; positions in ``nodes``."""
        return self.obstacle.near(x[nodes], reach)

    def gap(self, x: Floats, nodes: Ints, segment: Ints) -> Floats:
        """Gap of nodes to given facets, shape ``(m,)`` [m]."""
        return self.contact("static", x, x, nodes[:, None], segment)[1]

    def gap_gradient(self, x: Floats, nodes: Ints, segment: Ints) -> Floats:
        """Gradient of the gap of nodes, shape ``(m, 3)``."""
        return self.contact("static", x, x, nodes[:, None], segment)[3]

    def contact(self, scheme: str, x_n: Floats, x: Floats, dofs: Ints, segment: Ints) -> Contact:
        """Contact of nodes, see `Obstacle.contact`."""
        return self.obstacle.contact(scheme, x_n[dofs[:, 0]], x[dofs[:, 0]], segment)

    def slip(self, x_n: Floats, x: Floats, dofs: Ints, segment: Ints) -> Contact:
        """Slip of nodes, see `Obstacle.slip`."""
        return self.obstacle.slip(x_n[dofs[:, 0]], x[dofs[:, 0]], segment)
