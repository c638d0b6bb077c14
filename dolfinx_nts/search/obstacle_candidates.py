"""Facets of a rigid obstacle as candidates, without a global search."""

import numpy as np

from dolfinx_nts import compat
from dolfinx_nts._kernels import HYSTERESIS
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.model.frames import Frame
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.obstacles.adjacent_facets import AdjacentFacets
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.obstacles.trajectories import Trajectories
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.candidates import Candidates, Search
from dolfinx_nts.search.edges.rigid_edge_candidates import RigidEdgeCandidates
from dolfinx_nts.search.points import ContactPoints
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["ObstacleCandidates", "ObstacleSearch"]


class ObstacleCandidates(Candidates):
    """Facets of an obstacle, see `Candidates`; a pair consists of the point alone.

    Collective; its methods are local.

    Args:
        obstacle: The obstacle.
        nodes: Surface of the nodes. Its longest facet is the reference length of gaps.

    Attributes:
        frame: Frame of the obstacle in the current step.
    """

    may_curve = True

    def __init__(self, obstacle: Obstacle, nodes: Surface) -> None:
        self._obstacle, self.frame = obstacle, Frame()
        none = np.empty(0, dtype=np.int64)
        owned = compat.index_map(
            nodes.V.mesh.comm, nodes.V.dofmap.index_map.size_local, none, none.astype(np.int32)
        )
        self.scatter = NodalScatter(owned)
        self.key = obstacle.key
        self.segments = np.empty((len(self.key), 0), dtype=np.int32)
        self.size = np.full(len(self.key), nodes.size)
        self.passage = np.full(len(self.key), obstacle.shortest_passage)

    def find(self, key: GlobalInts) -> Ints:
        return np.maximum(key, -1).astype(np.int32)

    def pair(
        self,
        points: ContactPoints,
        x: Floats,
        current: Ints,
        reach: float,
        slack: float = HYSTERESIS,
    ) -> tuple[Ints, Floats]:
        found, gap = self._obstacle.find(points.of(x), current, slack, reach, points.facing)
        return found, np.where(found >= 0, gap, np.nan)

    def near(self, points: ContactPoints, x: Floats, reach: float) -> Ints:
        return self._obstacle.near(points.of(x), reach)

    def gap(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        return self.contact("static", points, x, x, segment).gap

    def contact(
        self, scheme: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> ContactKinematics:
        contact = self._obstacle.contact(scheme, points.of(x_n), points.of(x), segment)
        return self.frame.turned(scheme, contact)

    def slip(
        self, measure: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> Slip:
        return self.frame.turned_slip(self._obstacle.slip(points.of(x_n), points.of(x), segment))

    def follow(self, points: ContactPoints, x_n: Floats, x: Floats, inside: Ints) -> Trajectories:
        obstacle, facing = self._obstacle, points.facing

        def follow(begin: Floats, end: Floats, behind: Ints) -> Trajectories:
            return obstacle.follow(begin, end, behind, facing)

        ends = self.frame.path(points.of(x_n), points.of(x), obstacle.unturned)
        paths = Trajectories.along(ends, follow, inside)
        if len(ends) == 2:
            return paths
        gap = self.gap(points, x, np.maximum(paths.entered, 0))
        return paths._replace(gap=np.where(paths.entered >= 0, gap, np.nan))

    def adjacent(self, x: Floats) -> tuple[AdjacentFacets, Floats] | None:
        return self._obstacle.adjacent

    def is_at_rim(self, points: ContactPoints, x: Floats, segment: Ints) -> Flags:
        return self._obstacle.is_at_rim(points.of(x), segment)


class ObstacleSearch(Search):
    """Search that always returns all facets of an obstacle.

    Args:
        obstacle: The obstacle.
        nodes: Surface of the nodes.
    """

    candidates: ObstacleCandidates | RigidEdgeCandidates

    def __init__(self, obstacle: Obstacle, nodes: Surface) -> None:
        super().__init__(nodes, np.empty(0, dtype=np.int32))
        self.candidates = ObstacleCandidates(obstacle, nodes)
        self._obstacle, self._motion, self._dim = obstacle, obstacle.motion, obstacle.dim
        self._has_axis = is_axisymmetric(nodes.V.mesh)
        self.may_move = not obstacle.motion.is_rest

    def begin(self, t_n: float, t: float) -> None:
        self.frame = self.candidates.frame = self._motion.frame(t_n, t, self._dim)
        if self._has_axis and not self.frame.stays_on_axis:
            raise ValueError(
                "expected a motion along the axis y of an obstacle in an axisymmetric mesh, given "
                f"{self._motion!r}, which has other components at t = {t:g}"
            )

    def is_near(self, x: Floats, reach: float) -> bool:
        return self.may_move or len(self._obstacle.near(x[self.rows[0]], reach)) > 0

    def update(self, x: Floats, reach: float) -> tuple[Candidates, bool]:
        return self.candidates, False

    def serialize(self, archive: Archive, name: str) -> None:
        """Do nothing: an obstacle has no state."""
