"""Self contact: candidates of a surface without neighbours on the mesh.

Normals, thickness of the cells and reference positions decide which segments a node may touch, see
`cpp/nts/search/self_contact.h`.

With multipliers at nodes of both sides, there would be twice as many multipliers as independent
constraints, and nodes with eliminated displacements would be vertices of other constraints.
Therefore no node with a multiplier is a vertex of the segment of another such node. Other nodes are
constrained indirectly: the segment that such a node touches, or an adjacent one, has a vertex with
a multiplier.
"""

from collections import defaultdict
from collections.abc import Iterable
from heapq import heappop, heappush
from itertools import chain, permutations

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.points import ContactPoints
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates

__all__ = ["SelfContactCandidates", "SelfContactSearch"]


class SelfContactCandidates(SegmentCandidates):
    """Segments of a surface near its own nodes, see `Candidates`. Collective.

    Args:
        found: The segments, including all around the nodes of this rank.
        X: Reference positions of the owned nodes, shape ``(n, 3)`` [m].
    """

    def __init__(self, found: FoundSegments, X: Floats) -> None:
        super().__init__(found)
        self._X = self.scatter.forward(X)
        self._N = self._normals(self._X)

    def independent(
        self, surface: Surface, segment: Ints, eligible: Flags, urgency: GlobalInts
    ) -> Flags:
        """Choose nodes such that no node is a vertex of the segment of another one. Collective.

        Greedy selection by ``urgency``. At equal values neighbours of chosen nodes come first, so
        that one of two flat sides gets all multipliers. Then the input number decides, so the
        choice is partition-independent. See `Candidates.independent`.
        """
        node = np.flatnonzero(eligible)
        vertices = self.segments.take(segment[node], axis=0)
        ids = self.scatter.global_nodes(np.column_stack([surface.nodes[node], vertices]))
        order = np.column_stack([-urgency[node], surface.node_ids[node], ids])
        corners = self.scatter.global_nodes(self.segments)
        pairs = [np.empty((0, 2), dtype=np.int64)]
        pairs += [corners[:, [i, j]] for i, j in permutations(range(corners.shape[1]), 2)]
        edges = np.concatenate(pairs)
        edges = edges[np.isin(edges[:, 0], ids[:, 0])]
        comm = surface.V.mesh.comm
        everywhere = (chain(*comm.allgather(part.tolist())) for part in (order, edges))
        taken = _taken(*everywhere)
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
        # All nodes are vertices of the surface.
        return points.nodes

    def _normals(self, x: Floats) -> Floats:
        """Normals of the surface, of any length, shape ``(l, 3)``; valid at owned nodes only."""
        normals = np.zeros_like(x)
        areas = area_vectors(x[self.segments], self.orientation)
        for vertex in self.segments.T:
            np.add.at(normals, vertex, areas)
        return normals


def _taken(rows: Iterable[list[int]], edges: Iterable[list[int]]) -> set[int]:
    """Choose nodes, see `SelfContactCandidates.independent`. Local.

    Args:
        rows: Negative urgency, input number and dof of each node, and dofs of the vertices of its
            segment.
        edges: Pairs of dofs of nodes on the same facet.
    """
    turn: dict[int, tuple[int, int]] = {}
    segment: dict[int, list[int]] = {}
    for urgency, number, node, *vertices in rows:
        turn[node], segment[node] = (urgency, number), vertices
    neighbours: dict[int, list[int]] = defaultdict(list)
    for node, other in edges:
        if other in turn:
            neighbours[node].append(other)
    turns: list[tuple[int, bool, int, int]] = []
    for node, (urgency, number) in turn.items():
        heappush(turns, (urgency, True, number, node))
    taken: set[int] = set()
    covered: set[int] = set()  # vertices of the segments of chosen nodes
    while turns:
        node = heappop(turns)[-1]
        if node in taken or node in covered or not taken.isdisjoint(segment[node]):
            continue
        taken.add(node)
        covered.update(segment[node])
        for other in neighbours[node]:
            urgency, number = turn[other]
            heappush(turns, (urgency, False, number, other))
    return taken


class SelfContactSearch(GlobalSearch):
    """Search for segments near nodes of the same surface. Collective."""

    def _make(
        self, found: FoundSegments, others: Ints, x: Floats, reach: float
    ) -> SelfContactCandidates:
        X = reference_positions(self._nodes.V)[: found.scatter.index_map.size_local]
        return SelfContactCandidates(found, X)
