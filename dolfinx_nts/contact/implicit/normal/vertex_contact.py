"""Normal contact of vertices with faces, and of edges, in one attempt at a step."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import cast

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints, indices
from dolfinx_nts.contact.enforcement import TOUCHES, LagrangeMultiplier
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.implicit.normal.interface import NormalContact
from dolfinx_nts.contact.implicit.normal.multiplier import MultiplierContact
from dolfinx_nts.contact.implicit.normal.penalty import PenaltyContact
from dolfinx_nts.contact.joint_state import JointState, members
from dolfinx_nts.contact.method import EDGES, MORTAR
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.vertices import VertexState, released
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.segment_candidates import SegmentCandidates

__all__ = ["VertexMultipliers", "VertexSprings"]

# Cosine of the angle between two constraints at one place [-], 8 degrees, below which they count as
# the same constraint. Larger: their system is nearly singular. Smaller: a corner above a node sinks
# until its sides hold the node (30 degrees: by 0.6 of a facet, in statics with a corner of 90
# degrees).
_ONE = 0.99


class _Vertices(NormalContact):
    """Contact of vertices that were active in the last step, or penetrate a face within the step.

    With edge-to-edge contact, these are edges that cross others. See `add_vertices`.
    """

    def _prepare(self, state: PairState | JointState, search: LocalSearch) -> None:
        """Store the arguments that the choice of vertices needs."""
        self._candidates = cast(SegmentCandidates, search.candidates)
        self._states = cast(tuple[VertexState, ...], members(state))
        self._tolerance = np.concatenate([each.tolerance for each in self._states])
        segments, faces = self._candidates.segments, self._states[0].segments
        self._are_edges = state.pair.method == EDGES
        # Smooth segments list the vertices of the facet first, then the nodes around it.
        if isinstance(faces, Surface) and not self._are_edges:
            segments = segments[:, : faces.segments.shape[1]]
        self._facets: Ints = np.ascontiguousarray(segments)

    @abstractmethod
    def _stay(self, node: Ints) -> Flags:
        """Flags of active vertices that may stay active, shape ``(m,)``. Local."""

    @abstractmethod
    def _lack_force(self, node: Ints, segment: Ints, gap: Floats, x: Floats) -> Flags:
        """Whether no other contact supports vertices that are too deep, ``(m,)``. Collective.

        ``segment`` are their segments, ``gap`` their gaps [m], both ``(m,)``, ``x`` positions with
        ghosts, shape ``(l, 3)`` [m].
        """

    def choose(self) -> Flags:
        eligible = self._faces_by_law() & ~released(self._state)
        chosen = eligible & self._sunk
        node = indices(eligible & self._state.history.active)
        chosen[node] |= self._stay(node)
        self._barred = eligible & ~chosen
        return chosen

    @property
    def may_touch(self) -> Flags:
        return self._eligible

    def renew(self, x: Floats, *, moved: bool) -> int:
        """Make vertices eligible that have penetrated faces within the step."""
        search, candidates = self._search, self._candidates
        node = indices(self._barred)
        points, current = search.points.take(node), search.segment[node]
        segment, gap = candidates.pair(points, x, current, search.reach)
        # Nodes deeper than half a facet have no segment: they passed through the segment of the
        # trial state.
        met = search.approach.segment[node]
        lost = indices((segment < 0) & (met >= 0))
        segment[lost] = met[lost]
        gap[lost] = candidates.gap(points.take(lost), x, met[lost])
        some = (gap < 0).nonzero()[0]
        node, segment, gap = node[some], segment[some], gap[some]
        size = candidates.size[segment]
        deep, _, depth = self._above(node, segment, x)
        # On round surfaces smooth patches lie above their facets; this distance is no penetration.
        deep &= depth > np.fmin(self._tolerance[node], _kernels.HYSTERESIS * size)
        deep &= self._lack_force(node, segment, gap, x)
        return self._admit_penetrating(node[deep], segment[deep], gap[deep])

    def _above(self, node: Ints, segment: Ints, x: Floats) -> tuple[Flags, Ints, Floats]:
        """Vertices whose projections are on their facets, nearest facet nodes, and depths. Local.

        Arguments as for `_lack_force`. Returns flags, nodes of the map or -1 between nodes and for
        edges, and depths below the facets [m], all of shape ``(m,)``.
        """
        points, vertices = self._search.points.take(node), self._facets[segment]
        if self._are_edges:
            none = np.full(len(node), -1, dtype=np.int32)
            return none < 0, none, -self._candidates.gap(points, x, segment)
        pairs = _kernels.with_vertices(points.of(x), x, self._facets, segment)
        xi, gap, *_ = _kernels.project(pairs, self._candidates.orientation[segment])
        outside = np.fmax(-xi.min(axis=1), xi.max(axis=1) - 1)
        if vertices.shape[1] == 3:
            outside = np.fmax(outside, xi.sum(axis=1) - 1)
        corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])[: vertices.shape[1]]
        away = np.abs(xi[:, None] - corners).max(axis=2)
        nearest = np.take_along_axis(vertices, away.argmin(axis=1)[:, None], axis=1)[:, 0]
        is_above: Flags = outside <= _kernels.HYSTERESIS
        return is_above, np.where(away.min(axis=1) <= _kernels.HYSTERESIS, nearest, -1), -gap

    def _penetrate_further(self, node: Ints, segment: Ints, gap: Floats) -> Flags:
        """Whether vertices are deeper than at t_n. Local."""
        candidates, points = self._candidates, self._search.points.take(node)
        before = candidates.gap(points, self._search.x_n, segment)
        flags: Flags = gap < before - TOUCHES * candidates.size[segment]
        return flags


class VertexMultipliers(_Vertices, MultiplierContact):
    """Multipliers of vertices.

    The constraint of a vertex of the nodes replaces the mean gap of this node: opposite one facet
    both constraints are nearly the same, and no active set may have an equilibrium. The mean gap is
    constrained again once no force acts on the vertex. See `add_vertices` and, for the other
    arguments, `MultiplierContact`.

    Args:
        replace: Excludes nodes of the parent pair, and returns how many of this rank changed.
    """

    def __init__(
        self,
        state: PairState | JointState,
        law: LagrangeMultiplier,
        is_static: bool,
        search: LocalSearch,
        stiffness: Floats,
        intermediate: Mapping[float, Floats],
        replace: Callable[[PairState, Flags], int],
    ) -> None:
        self._prepare(state, search)
        self._replace = replace
        self._is_static = is_static
        normal = np.zeros((self._candidates.scatter.index_map.size_local, 3))
        for each in self._states:
            history = each.parent.history
            normal[each.parent.nodes.nodes] += np.where(
                history.active[:, None], history.normal, 0.0
            )
        self._held_along = self._candidates.scatter.forward(normal)
        super().__init__(state, law, is_static, search, stiffness, intermediate)

    def _begin(self, active: Flags, lambda_N: Floats) -> None:
        super()._begin(active, lambda_N)
        self._replace_means(self._eligible)

    def renew(self, x: Floats, *, moved: bool) -> int:
        number = super().renew(x, moved=moved)
        return number + self._replace_means(self.active | self._sunk)

    def _replace_means(self, holding: Flags) -> int:
        """Constrain the gaps at flagged vertices, ``(n,)``, instead of the mean gaps around them.

        Collective. Returns the number of nodes of this rank that changed.
        """
        number, ends = 0, self._state.ends
        if not self._is_static:
            return 0
        for each, start, end in zip(self._states, ends[:-1], ends[1:], strict=True):
            parent = each.parent
            is_own = not each.is_reverse and each.pair.method != EDGES
            if is_own and parent.pair.method == MORTAR:
                nodes = each.nodes.nodes[holding[start:end]]
                number += self._replace(parent, np.isin(parent.nodes.nodes, nodes))
        return number

    def _stay(self, node: Ints) -> Flags:
        search = self._search
        return ~self._is_opposite_active_node(node, search.approach.segment[node], search.x_n)

    def _lack_force(self, node: Ints, segment: Ints, gap: Floats, x: Floats) -> Flags:
        if self._is_static:
            return np.ones(len(node), dtype=bool)
        return self._penetrate_further(node, segment, gap) & ~self._is_opposite_active_node(
            node, segment, x
        )

    def _target(self, pairs: PairKinematics) -> Floats:
        """Reference gaps of the multipliers: with inertia, penetrating vertices are not pushed out.

        That would add energy, as they have penetrated without a force.
        """
        target = super()._target(pairs)
        return target if self._is_static else np.fmin(target, pairs.contact.gap_n)

    def _is_opposite_active_node(self, node: Ints, segment: Ints, x: Floats) -> Flags:
        """Whether vertices are opposite active nodes of the parent pair, shape ``(m,)``. Local.

        Both constraints would be the same. ``segment`` are the segments of the vertices, ``(m,)``,
        ``x`` positions with ghosts, shape ``(l, 3)`` [m].
        """
        points, candidates = self._search.points.take(node), self._candidates
        _, below, _ = self._above(node, segment, x)
        normal = candidates.contact("static", points, x, x, segment).gradient[:, :3]
        opposed = np.einsum("mi,mi->m", normal, self._held_along[below]) < -_ONE
        flags: Flags = (below >= 0) & opposed
        return flags


class VertexSprings(_Vertices, PenaltyContact):
    """Springs at vertices that are deeper below a face than the springs of the parent pair.

    With inertia a spring begins without energy at the activation depth of the vertex or, if the
    vertex is deeper, at its gap at t_n. In statics it begins at the compression of the other
    springs. See `add_vertices` and `PenaltyContact`.

    Args:
        compression: Returns the current compression of the active springs of the parent pair, shape
            ``(n,)`` [m]. Local.
    """

    def __init__(
        self,
        state: PairState | JointState,
        is_static: bool,
        search: LocalSearch,
        share: float,
        dt: float,
        compression: Callable[[PairState], Floats],
    ) -> None:
        self._prepare(state, search)
        self._compression = compression
        # Gaps at which springs begin in this step.
        self._begin_at: Floats = np.zeros(len(self._tolerance))
        super().__init__(state, is_static, search, share, dt)

    def _pressed_layers(self, deforms: Flags) -> tuple[Floats | float, Floats | None]:
        # The whole area acts at a vertex: all facets around it are behind it.
        return 1.0, None

    def _stay(self, node: Ints) -> Flags:
        return np.ones(len(node), dtype=bool)

    def _lack_force(self, node: Ints, segment: Ints, gap: Floats, x: Floats) -> Flags:
        candidates = self._candidates
        depth = np.zeros((candidates.scatter.index_map.size_local, 1))
        for each in self._states:
            depth[each.parent.nodes.nodes, 0] = self._compression(each.parent)
        own = depth[self._state.nodes.nodes[node], 0]
        depth = candidates.scatter.forward(np.repeat(depth, 3, axis=1))[:, 0]
        compressed = np.fmax(own, depth[self._facets[segment]].max(axis=1, initial=0.0))
        tolerance = np.fmin(self._tolerance[node], _kernels.HYSTERESIS * candidates.size[segment])
        allowed = compressed + tolerance
        self._begin_at[node] = -(compressed if self._is_static else allowed)
        flags: Flags = gap < -allowed
        return flags if self._is_static else flags & self._penetrate_further(node, segment, gap)

    @property
    def _is_loaded(self) -> Flags:
        return self._state.history.active & super()._is_loaded

    def _offset(self, pairs: PairKinematics) -> Floats:
        node, begins = pairs.node, self._begin_at[pairs.node]
        if not self._is_static:
            begins = np.fmin(pairs.contact.gap_n, begins)
        return np.where(self._state.history.active[node], super()._offset(pairs), begins)
