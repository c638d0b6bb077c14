"""Facets of a rigid obstacle as candidates, which need no search."""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts import _kernels, compat
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.obstacles import Obstacle
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.points import ContactPoints, NodalPoints
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["ObstacleCandidates", "ObstacleSearch"]


class ObstacleCandidates:
    """Facets of an obstacle, see `Candidates`; pairs consist of the point alone.

    Collective; its methods are local.

    Args:
        obstacle: The obstacle.
        nodes: Surface whose nodes meet it.

    Attributes:
        scatter: Map of the owned nodes, as no rank needs those of another.
        segments: No vertices, shape ``(f, 0)``.
        key: Number of each facet, shape ``(f,)``.
        size: Longest facet of the nodes' surface, shape ``(f,)`` [m].
    """

    def __init__(self, obstacle: Obstacle, nodes: Surface) -> None:
        """Make a map of the owned nodes only."""
        self._obstacle = obstacle
        none = np.empty(0, dtype=np.int64)
        owned = compat.index_map(
            nodes.V.mesh.comm, nodes.V.dofmap.index_map.size_local, none, none.astype(np.int32)
        )
        self.scatter = NodalScatter(owned, is_local=True)
        self.key = obstacle.key
        self.segments: Ints = np.empty((len(self.key), 0), dtype=np.int32)
        self.size = np.full(len(self.key), nodes.size)

    def find(self, key: GlobalInts) -> Ints:
        """Facet of each key or -1, see `Candidates.find`."""
        return key.astype(np.int32)

    def pair(
        self,
        points: ContactPoints,
        x: Floats,
        current: Ints,
        reach: float,
        slack: float = _kernels.HYSTERESIS,
    ) -> tuple[Ints, Floats]:
        """Choose a facet for each point, see `Candidates.pair`."""
        found, gap = self._obstacle.find(points.of(x), current, slack, reach)
        return found, np.where(found >= 0, gap, np.nan)

    def penalty_forces(
        self,
        nodes: Ints,
        x: Floats,
        current: Ints,
        reach: float,
        numbers: Ints,
        stiffness: Floats,
    ) -> tuple[Ints, Floats, _kernels.Springs]:
        """Springs of nodes inside, see `Candidates.penalty_forces`."""
        segment, gap = self.pair(NodalPoints(nodes), x, current, reach)
        (inside,) = (gap < 0).nonzero()
        nodes, facet, depth = nodes[inside], segment[inside], gap[inside]
        gradient = self.contact("static", NodalPoints(nodes), x, x, facet).gradient
        lambda_N = stiffness[inside] * depth
        force = -lambda_N[:, None, None] * gradient[:, None]
        springs = _kernels.Springs(
            numbers[inside], self.key[facet], nodes[:, None], force, lambda_N * depth / 2
        )
        return segment, gap, springs

    def near(self, points: ContactPoints, x: Floats, reach: float) -> Ints:
        """Points within reach of a facet, see `Candidates.near`."""
        return self._obstacle.near(points.of(x), reach)

    def gap(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Gap of points to given facets, see `Candidates.gap`."""
        return self.contact("static", points, x, x, segment).gap

    def contact(
        self, scheme: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> ContactKinematics:
        """Gap and force of points, see `Candidates.contact`."""
        return ContactKinematics(
            *self._obstacle.contact(scheme, points.of(x_n), points.of(x), segment)
        )

    def slip(self, law: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints) -> Slip:
        """Slip of points by the objective measure, see `Candidates.slip`."""
        *values, frame_n, frame, orientation = self._obstacle.slip(
            points.of(x_n), points.of(x), segment
        )
        return Slip(*values, frame_n=frame_n, frame=frame, orientation=orientation)

    def restrict(self, points: ContactPoints, free: Floats) -> Floats | None:
        """Which displacements are unknown, see `Candidates.restrict`."""
        return None if points.of(free).all() else free

    def beside(self, points: ContactPoints, x: Floats, segment: Ints) -> Flags:
        """Whether points have left their facets sideways, see `Candidates.beside`."""
        return self._obstacle.beside(points.of(x), segment)

    def independent(
        self, surface: Surface, segment: Ints, eligible: Flags, urgency: GlobalInts
    ) -> Flags:
        """All eligible nodes, as there are no vertices, see `Candidates.independent`."""
        return eligible


class ObstacleSearch:
    """An obstacle is always in reach, see `Search`.

    Args:
        obstacle: The obstacle.
        nodes: Surface whose nodes meet it.

    Attributes:
        candidates: The facets, always the same.
        num_searches: 0.
    """

    num_searches = 0

    def __init__(self, obstacle: Obstacle, nodes: Surface) -> None:
        """Make the candidates."""
        self._nodes = nodes
        self.candidates = ObstacleCandidates(obstacle, nodes)

    def update(self, x: Floats, reach: float) -> tuple[ObstacleCandidates, bool]:
        """The candidates, see `Search.update`. Local."""
        return self.candidates, False

    def positions(self, x: Floats) -> tuple[Floats, Floats]:
        """Positions of this rank's nodes, and of no vertices. Local."""
        return x[self._nodes.nodes], np.empty((0, 3))

    def approach(self, x: Floats, before: Sequence[Floats]) -> float:
        """By how much any node may be closer than it was [m], see `Search.approach`."""
        moved = _kernels.farthest(x.take(self._nodes.nodes, axis=0), before[0])
        return float(reductions.largest(self._nodes.V.mesh.comm, moved))

    def serialize(self, archive: Archive, name: str) -> None:
        """Do nothing, as an obstacle has no state."""
