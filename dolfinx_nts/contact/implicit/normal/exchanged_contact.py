"""Normal contact of vertices of the segments with facets of the nodes, in one attempt at a step."""

from collections.abc import Mapping
from typing import cast

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.enforcement import TOUCHES, LagrangeMultiplier
from dolfinx_nts.contact.exchange import ExchangedState, released
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.implicit.normal.multiplier import MultiplierContact
from dolfinx_nts.contact.joint_state import JointState, members
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.search.points import ContactPoints
from dolfinx_nts.search.segment_candidates import SegmentCandidates

__all__ = ["ExchangedContact"]

# Cosine of the angle between two constraints at one place [-], 8 degrees, up to which they are one.
# Larger: their system is nearly singular. Smaller: a corner above a node sinks until its sides hold
# the node (30 degrees: by 0.6 of a facet, in statics with a corner of 90 degrees).
_ONE = 0.99


class ExchangedContact(MultiplierContact):
    """Holds vertices that were held in the last step, or that the step has sunk into a face.

    See `exchange_roles` and, for the arguments, `MultiplierContact`.
    """

    def __init__(
        self,
        state: PairState | JointState,
        law: LagrangeMultiplier,
        is_static: bool,
        search: LocalSearch,
        stiffness: Floats,
        intermediate: Mapping[float, Floats],
    ) -> None:
        self._is_static = is_static
        self._candidates = candidates = cast(SegmentCandidates, search.candidates)
        states = cast(tuple[ExchangedState, ...], members(state))
        self._tolerance = np.concatenate([each.tolerance for each in states])
        normal = np.zeros((candidates.scatter.index_map.size_local, 3))
        for each in states:
            history = each.given.history
            normal[each.given.nodes.nodes] += np.where(history.active[:, None], history.normal, 0.0)
        self._held_along = candidates.scatter.forward(normal)
        super().__init__(state, law, is_static, search, stiffness, intermediate)

    def choose(self) -> Flags:
        search, eligible = self._search, self._faces_by_law() & ~released(self._state)
        chosen = eligible & self._state.history.active
        node = chosen.nonzero()[0].astype(np.int32)
        segment = search.approach.segment[node]
        chosen[node] = ~self._is_held_by_node(node, segment, search.x_n)
        chosen |= eligible & self._sunk
        self._barred = eligible & ~chosen
        return chosen

    @property
    def may_touch(self) -> Flags:
        return self._eligible

    def renew(self, x: Floats, *, moved: bool) -> int:
        """Activate vertices that have penetrated faces within the step."""
        search, candidates = self._search, self._candidates
        node = self._barred.nonzero()[0].astype(np.int32)
        points, current = search.points.take(node), search.segment[node]
        segment, gap = candidates.pair(points, x, current, search.reach)
        # Deeper than half a facet they have none: they went through the one that they met.
        met = search.approach.segment[node]
        lost = ((segment < 0) & (met >= 0)).nonzero()[0].astype(np.int32)
        segment[lost] = met[lost]
        gap[lost] = candidates.gap(points.take(lost), x, met[lost])
        some = (gap < 0).nonzero()[0]
        node, segment, gap = node[some], segment[some], gap[some]
        size = candidates.size[segment]
        deep = gap < -np.fmin(self._tolerance[node], _kernels.HYSTERESIS * size)
        points = search.points.take(node)
        deep &= _above(candidates, points, x, segment)[0]
        if not self._is_static:
            # Those that leave need no force, those above a held node have it.
            deep &= gap < candidates.gap(points, search.x_n, segment) - TOUCHES * size
            deep &= ~self._is_held_by_node(node, segment, x)
        return self._hold(node[deep], segment[deep], gap[deep])

    def _target(self, pairs: PairKinematics) -> Floats:
        """Gaps that multipliers hold: with inertia, vertices inside are not pushed out.

        That would do work, as they have sunk in without a force.
        """
        target = super()._target(pairs)
        return target if self._is_static else np.fmin(target, pairs.contact.gap_n)

    def _is_held_by_node(self, node: Ints, segment: Ints, x: Floats) -> Flags:
        """Whether vertices are above nodes that the given pair holds, shape ``(m,)``. Local.

        Both constraints would be the same. ``segment`` are the segments of the vertices, ``(m,)``,
        ``x`` positions with ghosts, shape ``(l, 3)`` [m].
        """
        points, candidates = self._search.points.take(node), self._candidates
        _, below = _above(candidates, points, x, segment)
        normal = candidates.contact("static", points, x, x, segment).gradient[:, :3]
        opposed = np.einsum("mi,mi->m", normal, self._held_along[below]) < -_ONE
        flags: Flags = (below >= 0) & opposed
        return flags


def _above(
    candidates: SegmentCandidates, points: ContactPoints, x: Floats, segment: Ints
) -> tuple[Flags, Ints]:
    """Whether points are above their segments, and above which vertices. Local.

    Args:
        candidates: The segments.
        points: The points.
        x: Positions with ghosts, shape ``(l, 3)`` [m].
        segment: Segment of each point, shape ``(m,)``.

    Returns:
        Flags, shape ``(m,)``, and nodes of the map, -1 between vertices, shape ``(m,)``.
    """
    pairs, vertices = candidates.pairs(points, x, segment), candidates.segments[segment]
    xi = _kernels.project(pairs, candidates.orientation[segment])[0]
    outside = np.fmax(-xi.min(axis=1), xi.max(axis=1) - 1)
    if vertices.shape[1] == 3:
        outside = np.fmax(outside, xi.sum(axis=1) - 1)
    corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])[: vertices.shape[1]]
    away = np.abs(xi[:, None] - corners).max(axis=2)
    nearest = np.take_along_axis(vertices, away.argmin(axis=1)[:, None], axis=1)[:, 0]
    is_above: Flags = outside <= _kernels.HYSTERESIS
    return is_above, np.where(away.min(axis=1) <= _kernels.HYSTERESIS, nearest, -1)
