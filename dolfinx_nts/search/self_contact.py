"""Contact of a surface with itself: candidates without neighbours on the mesh.

What a node may touch is decided by normals, by the thickness of the cells and by the reference
positions, see `cpp/nts/search/self_contact.h`.

Where both sides touch with their nodes there would be twice as many constraints as there is
room for, and a node that gives up its displacement would be asked for it by another. So no node
that may have a multiplier is a vertex of the segment of another one. These hold all other
nodes: the segment that such a node touches, or one around it, has a vertex with a multiplier.
"""

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.model.surfaces import Surface, area_vectors
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.points import ContactPoints
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates

__all__ = ["SelfContactCandidates", "SelfContactSearch"]


class SelfContactCandidates(SegmentCandidates):
    """Segments of a surface within reach of its own nodes, see `Candidates`. Collective.

    Args:
        found: The segments; all around the nodes of this rank are among them.
        X: Reference positions of the owned nodes, shape ``(n, 3)`` [m].
    """

    def __init__(self, found: FoundSegments, X: Floats) -> None:
        """Fetch the reference positions of ghosts and compute the reference normals."""
        super().__init__(found)
        self._X = self.scatter.forward(X)
        self._N = self._normals(self._X)

    def independent(
        self, surface: Surface, segment: Ints, eligible: Flags, urgency: GlobalInts
    ) -> Flags:
        """Choose nodes of which none is a vertex of the segment of another. Collective.

        Each node in turn is taken unless one of those before forbids it: the most urgent first,
        and among these the lowest number in the mesh, so that the choice does not depend on the
        partition. See `Candidates.independent`.
        """
        node = np.flatnonzero(eligible)
        vertices = self.segments.take(segment[node], axis=0)
        ids = self.scatter.global_nodes(np.column_stack([surface.nodes[node], vertices]))
        order = np.column_stack([-urgency[node], surface.node_ids[node], ids])
        everywhere = np.concatenate(surface.V.mesh.comm.allgather(order))
        everywhere = everywhere[np.lexsort((everywhere[:, 1], everywhere[:, 0]))]
        taken: set[int] = set()
        covered: set[int] = set()  # vertices of the segments of taken nodes
        for first, *others in everywhere[:, 2:].tolist():
            if first not in covered and taken.isdisjoint(others):
                taken.add(first)
                covered.update(others)
        flags: Flags = np.zeros_like(eligible)
        flags[node] = [first in taken for first in ids[:, 0].tolist()]
        return flags

    def _choose(
        self, points: ContactPoints, x: Floats, current: Ints, reach: float, slack: float
    ) -> tuple[Ints, Floats, Floats, Floats]:
        """Segment, convective coordinates, gap and normal of each point."""
        own = (points.of(self._normals(x)), points.of(self._X), points.of(self._N), self._X)
        return self._kernel.pair_own(points.of(x), current, slack, reach, x, *own, self._thickness)

    def _own_rows(self, points: ContactPoints) -> Ints:
        """The nodes themselves, as they are vertices of the surface."""
        return points.nodes

    def _normals(self, x: Floats) -> Floats:
        """Normals of the surface, of any length; right at owned nodes only, shape ``(l, 3)``."""
        normals = np.zeros_like(x)
        areas = area_vectors(x[self.segments], self.orientation)
        for vertex in self.segments.T:
            np.add.at(normals, vertex, areas)
        return normals


class SelfContactSearch(GlobalSearch):
    """Finds segments that nodes of the same surface can reach, see `GlobalSearch`. Collective."""

    def _make(
        self, found: FoundSegments, others: Ints, x: Floats, reach: float
    ) -> SelfContactCandidates:
        X = self._nodes.V.tabulate_dof_coordinates()[: found.scatter.index_map.size_local]
        return SelfContactCandidates(found, X)
