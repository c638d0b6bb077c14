"""Pairs of crossing sharp edges as candidates of edge-to-edge contact."""

from typing import NamedTuple

import numpy as np

from dolfinx_nts._kernels import DEEPEST, HYSTERESIS, OVERHANG
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints, indices
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.obstacles.trajectories import Trajectories
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.search.edges.crossings import WEIGHTS, Crossing
from dolfinx_nts.search.edges.current_edges import Edges, pairs_within
from dolfinx_nts.search.points import ContactPoints
from dolfinx_nts.search.scatter import NodalScatter
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates

__all__ = ["EdgeCandidates"]

# Least sines of angles [-] for new and for active pairs: between the edges, and between the normal
# and the facets at the edges. Larger: edges of length l penetrate by about l times the value before
# a node touches a facet; smaller: nearly parallel edges become active. The second values also allow
# edges that initially lie on a facet at the other edge, unless facets lie on each other.
_CROSSING, _BETWEEN = (0.01, 0.005), (1e-3, -0.05)
# Distance of a crossing beyond the end of an edge relative to its length [-] that counts as
# round-off.
_ROUNDING = 1e-9
# Additional depth relative to the edge length [-] at which another edge replaces the current one.
_DEEPER = 0.01


class _Found(NamedTuple):
    """Admissible candidates of carriers.

    Attributes:
        candidate: Candidates, shape ``(m,)``.
        gap: Gaps, shape ``(m,)`` [m].
        beyond: Whether edges cross beyond an end of the other edge, ``(m,)``.
        depth: Gap by which candidates are compared, ``(m,)`` [m].
    """

    candidate: Ints
    gap: Floats
    beyond: Flags
    depth: Floats

    def with_others(self, other: "_Found") -> "_Found":
        return _Found(*map(np.concatenate, zip(self, other, strict=True)))  # type: ignore[arg-type]


class EdgeCandidates(SegmentCandidates):
    """Pairs of edges near each other.

    A candidate consists of an edge of the nodal surface, an edge of the other surface, and an
    orientation of the normal. It is a candidate only of its carrier, the first end of the own edge.
    Its *vertices* are the second end of the own edge and both ends of the other one.

    Args:
        scatter: Map of the nodes.
        own: Edges of the nodal surface.
        other: Edges of the other surface.
        pairs: Indices of paired edges, ordered by key, shape ``(c, 2)``.
        key: Partition-independent number of each pair, ascending, ``(c,)``.
        x: Positions of the nodes of the map, shape ``(l, 3)`` [m].
    """

    # Weights of the nodes with unknowns.
    _weights = WEIGHTS
    # The kernel of facets does not apply to edges.
    penalty_forces = Candidates.penalty_forces
    # Pairs of edges have no neighbours.
    adjacent = Candidates.adjacent

    def __init__(
        self,
        scatter: NodalScatter,
        own: Edges,
        other: Edges,
        pairs: Ints,
        key: GlobalInts,
        x: Floats,
    ) -> None:
        self._edges, self._pairs = (own, other), pairs
        a, b = own.ends[pairs[:, 0]], other.ends[pairs[:, 1]]
        self._carrier = a[:, 0]
        lengths = [np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1) for ends in (a, b)]
        size, self._lengths = np.minimum(*lengths), lengths[1]
        thickness = np.minimum(own.thickness[pairs[:, 0]], other.thickness[pairs[:, 1]])
        self._deepest = np.minimum(DEEPEST * size, thickness)
        vertices = np.column_stack([a[:, 1], b]).astype(np.int32)
        senses = np.tile([-1.0, 1.0], len(pairs))
        keys = np.repeat(2 * key, 2) + (senses > 0)
        twice = (np.repeat(values, 2, axis=0) for values in (vertices, size, thickness))
        vertices, size, thickness = twice
        super().__init__(FoundSegments(scatter, vertices, senses, keys, size, thickness))
        # There is no pass-through check for edges.
        self.passage = np.full(len(size), np.inf)

    @classmethod
    def paired(
        cls,
        scatter: NodalScatter,
        own: Edges,
        other: Edges,
        num_others: int,
        x: Floats,
        reach: float,
    ) -> "EdgeCandidates":
        """Pair edges with boxes within ``reach`` [m]; ``num_others`` counts edges of all ranks."""
        return cls(scatter, own, other, *pairs_within(own, other, num_others, x, reach), x)

    def pair(
        self,
        points: ContactPoints,
        x: Floats,
        current: Ints,
        reach: float,
        slack: float = HYSTERESIS,
    ) -> tuple[Ints, Floats]:
        """Choose the deepest crossing edge of each carrier, see `Candidates.pair`.

        The current candidate is kept if it is nearly as deep, and always within the iterations of
        a step (infinite ``slack``).
        """
        segment, gap = np.full(len(current), -1, dtype=np.int32), np.full(len(current), np.nan)
        if not len(self._pairs) or not len(current):
            return segment, gap
        row = np.full(len(x), -1, dtype=np.int32)
        row[points.nodes] = np.arange(len(current))
        held = current[current >= 0]
        searches = np.zeros(len(x), dtype=bool)
        searches[points.nodes[current < 0] if np.isinf(slack) else points.nodes] = True
        met = indices(searches[self._carrier])
        found = self._met(x, met, reach)
        candidate, gaps, beyond, depth = (
            found.with_others(self._kept_candidates(x, held, slack)) if len(held) else found
        )
        if not len(candidate):
            return segment, gap
        fits = np.flatnonzero((gaps <= reach) & (gaps >= -self._deepest[candidate // 2]))
        point = row[self._carrier[candidate // 2]]
        # Order: crossings beyond an end last, then by depth, then by key.
        keys = candidate, depth, beyond, point
        order = fits[np.lexsort([values[fits] for values in keys])]
        where, first = np.unique(point[order], return_index=True)
        segment[where], gap[where] = candidate[order[first]], gaps[order[first]]
        return segment, gap

    def near(self, points: ContactPoints, x: Floats, reach: float) -> Ints:
        every = np.arange(len(self._pairs), dtype=np.int32)
        carries = np.zeros(len(x), dtype=bool)
        carries[self._carrier[self._within(x, every, reach)]] = True
        return indices(carries[points.nodes])

    def _within(self, x: Floats, pair: Ints, reach: float, overhang: float = 0.0) -> Ints:
        """Pairs with boxes within ``reach`` [m]; the other edge is extended by ``overhang``."""
        (lower, upper), (least, greatest) = (edges.boxes(x) for edges in self._edges)
        beyond = overhang * (greatest - least) + reach
        least, greatest = least - beyond, greatest + beyond
        for i in range(3):  # one direction first, which excludes most pairs
            own, other = self._pairs[pair].T
            pair = pair[(lower[own, i] <= greatest[other, i]) & (least[other, i] <= upper[own, i])]
        return pair

    def _kept_candidates(self, x: Floats, candidate: Ints, slack: float) -> "_Found":
        """Current candidates whose edges still cross, which may be kept."""
        sense, crossing = self.orientation[candidate], self._crossing(x, candidate // 2)
        if np.isfinite(slack):
            stays = crossing.sine > _CROSSING[1]
            stays &= np.all((crossing.places >= -slack) & (crossing.places <= 1 + slack), axis=1)
            angles = sense[:, None] * self._between(x, candidate // 2, crossing.normal)
            stays &= np.all(angles > _BETWEEN[1], axis=1)
            candidate, sense = candidate[stays], sense[stays]
            crossing = crossing.take(stays)
        gap = sense * crossing.gap
        none = np.zeros(len(gap), dtype=bool)
        return _Found(candidate, gap, none, gap - _DEEPER * self.size[candidate])

    def _met(self, x: Floats, pair: Ints, reach: float) -> "_Found":
        """Crossing pairs, with the normal orientation for which the edges face each other."""
        reach = max(reach, self._deepest.max())
        pair = self._within(x, pair, reach, OVERHANG)
        crossing = self._crossing(x, pair)
        own, other = crossing.places.T
        # At a common vertex of two own edges the crossing belongs to the edge that starts there.
        # Among the other edges, crossings beyond an end are admissible at corners.
        beyond = np.abs(other - 0.5) - 0.5
        some = indices(
            (np.abs(crossing.gap) <= reach)
            & ((own >= -_ROUNDING) & (own < 1 - _ROUNDING))
            & ((beyond <= OVERHANG) & (crossing.sine > _CROSSING[0]))
        )
        pair, crossing, beyond = pair[some], crossing.take(some), beyond[some]
        is_beyond: Flags = beyond > _ROUNDING
        if not len(pair):
            return _Found(pair, crossing.gap, is_beyond, crossing.gap)
        angles = self._between(x, pair, crossing.normal)
        sense = np.where(angles.sum(axis=1) > 0, 1.0, -1.0)
        gap = sense * crossing.gap
        first, second = (sense[:, None] * angles).reshape(-1, 2, 2).min(axis=2).T
        lies_on_facet = np.maximum(first, second) > -_BETWEEN[1]
        least = np.where(lies_on_facet, _BETWEEN[1], _BETWEEN[0])
        faces: Flags = np.minimum(first, second) > least
        # Beyond a convex corner there is no body. In front of the corner, the nearest points are
        # beyond the ends by about the gap.
        faces &= ~is_beyond | (beyond * self._lengths[pair] <= gap)
        faces &= self._depth(x, pair) >= -gap - _DEEPER * self.size[2 * pair]
        candidate = (2 * pair + (sense > 0)).astype(np.int32)[faces]
        return _Found(candidate, gap[faces], is_beyond[faces], gap[faces])

    def _crossing(self, x: Floats, pair: Ints) -> Crossing:
        """Crossings of some pairs of edges."""
        ends = (edges.ends[self._pairs[pair, i]] for i, edges in enumerate(self._edges))
        return Crossing.of(*(x[rows] for rows in ends))

    def _between(self, x: Floats, pair: Ints, normal: Floats) -> Floats:
        """Sines of the angles between normals, ``(m, 3)``, and the facets, ``(m, 4)``.

        All are positive if the normal points away from the other surface and into the own one, and
        negative for the reverse normal.
        """
        own, other = (self._pairs[pair, i] for i in range(2))
        return np.hstack(
            [
                self._edges[1].between(x, other, normal),
                self._edges[0].between(x, own, -normal),
            ]
        )

    def _depth(self, x: Floats, pair: Ints) -> Floats:
        """Depth of a whole edge below a facet at the other edge, shape ``(m,)`` [m].

        If it is less than the depth of the crossing, an end penetrates the facet, where node
        contact acts. Without this limit, edges that rotate past that end would begin to cross deep
        inside.
        """
        own, other = (self._pairs[pair, i] for i in range(2))
        (a, b), (ends_a, ends_b) = (
            self._edges,
            (x[edges.ends[some]] for edges, some in zip(self._edges, (own, other), strict=True)),
        )
        return np.minimum(a.depth(x, own, ends_b), b.depth(x, other, ends_a))

    def pairs(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        """Positions of the equivalent points and triangles, ``(m, 4, 3)`` [m]."""
        return WEIGHTS @ super().pairs(points, x, segment)

    def contact(
        self, scheme: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> ContactKinematics:
        found = super().contact(scheme, points, x_n, x, segment)
        to_nodes = np.kron(self._weights, np.eye(3))
        return found._replace(
            force=found.force @ to_nodes,
            gradient=found.gradient @ to_nodes,
            tangent=to_nodes.T @ found.tangent @ to_nodes,
        )

    def slip(
        self, measure: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> Slip:
        return super().slip(measure, points, x_n, x, segment).combined(self._weights)

    def follow(self, points: ContactPoints, x_n: Floats, x: Floats, inside: Ints) -> Trajectories:
        # Edges have no path below a surface.
        number = len(points.facing.numbers)
        zero, none = np.zeros(number), np.full(number, -1, dtype=np.int32)
        return Trajectories(none, none >= 0, zero, zero, zero, zero)

    def is_at_rim(self, points: ContactPoints, x: Floats, segment: Ints) -> Flags:
        # True, as another edge or facet begins at the end of an edge.
        return np.ones(len(segment), dtype=bool)
