"""Local search: the candidate segment of each contact point, in one attempt at a step."""

from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints, indices
from dolfinx_nts.contact.enforcement import TOUCHES, Tied
from dolfinx_nts.contact.history import NEVER
from dolfinx_nts.contact.implicit.pairing import NodePairing, Pairing
from dolfinx_nts.contact.joint_state import JointState, members
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.contact.method import NODES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.model.obstacles.adjacent_facets import AdjacentFacets
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import contact_normals
from dolfinx_nts.search.shared_segments import SharedSegments

__all__ = [
    "LATE",
    "STATIC_OVERHANG",
    "Approach",
    "LocalSearch",
    "StaticSearch",
    "may_face",
    "penetrated_nodes",
]

# Number of segment changes of a node in a step after which it keeps the last segment.
_MOST_MOVES = 2
# Largest distance of a node without inertia from its segment in equilibrium, tangential and
# relative to the size of the segment [-]. At a concave edge such a node is below the next segment.
STATIC_OVERHANG = 0.06
# Penetration in excess of that at t_n above which an inactive node counts as missed contact,
# relative to the longest segment [-]. Smaller: ordinary impacts are solved twice, as nodes next to
# active ones end deeper than in the ballistic motion (at 0.02 the first impact of two blocks takes
# 8 iterations instead of 4). Larger: impacts from rest end deeper (0.31 segments at 0.4, where half
# of the approach is 0.2).
LATE = 0.05
# Search radius relative to the largest displacement increment of the trial motion [-]: both
# surfaces may move, and Newton iterates overshoot.
_REACH = 3


def may_face(state: PairState | JointState, x_n: Floats, increment: float) -> bool:
    """Whether nodes of a pair may get a segment in a step, or had one in the last step. Collective.

    In a step with inertia, a pair without such nodes has no contact and is skipped: if its surfaces
    did not touch after the last step, and their distance is more than a multiple of the increment.

    Args:
        state: State of the contact pair, or of several.
        x_n: Accepted positions of the local nodes of the space, owned and ghost, ``(l, 3)``
            [m].
        increment: Largest displacement increment of a node in the trial motion, the same on all
            ranks [m].
    """
    if isinstance(state, JointState) or state.search.was_displaced:
        return True
    comm: MPI.Comm = state.nodes.V.mesh.comm
    old, reach = state.history, (_REACH + 1) * increment
    may_penetrate = bool(np.any(old.active | (old.key == NEVER) | (old.gap < 0)))
    if reductions.anywhere(comm, may_penetrate):
        return True
    return reductions.anywhere(comm, state.search.is_near(x_n, reach))


class Approach(NamedTuple):
    """Segments and gaps of the nodes in the trial state, without contact forces, see `Rates`.

    Attributes:
        segment: Segment in the trial state, or else at t_n, or -1, shape ``(n,)``.
        gap_n: Gap to that segment at t_n, NaN without one, shape ``(n,)`` [m].
        gap: Gap to that segment in the trial state, shape ``(n,)`` [m].
        x: Trial positions of the nodes of the candidates' map, shape ``(l, 3)`` [m].
    """

    segment: Ints
    gap_n: Floats
    gap: Floats
    x: Floats


class LocalSearch:
    """Segments of the nodes of contact pairs. Collective; its methods are local.

    Attributes are in the frame of the pair's search, constructor arguments in space.

    Args:
        state: State of the contact pair, or of several.
        x_n: Accepted positions of the local nodes of the space, owned and ghost, ``(l, 3)``
            [m].
        x_trial: The same for the trial state, see `Rates`.

    Attributes:
        candidates: Candidates within the search radius.
        points: Contact points of the nodes, with the outward normals at t_n.
        reach: Search radius [m].
        x_n: Positions at t_n of the nodes of the candidates' map.
        last: Segment of each node in the last step or -1, shape ``(n,)``.
        start: Segment of each node at t_n or -1, ``(n,)``, and gap to it, NaN without one, ``(n,)``
            [m].
        segment: Current segment of each node or -1, shape ``(n,)``.
        gap: Gap to the current segment, NaN without one, shape ``(n,)`` [m].
        approach: Segments and gaps in the trial state.
        passing: Flags of nodes that would pass through a segment in the trial motion, shape
            ``(n,)``.
        pairing: Evaluation of nodes and their segments.
        shared: Segments of the nodes that are equally near to several.
    """

    _overhang: float = _kernels.OVERHANG
    # Largest tangential distance from one of several equally near segments at which a node in
    # equilibrium keeps all of them, relative to their size [-].
    _sharing: float = _kernels.OVERHANG

    def __init__(self, state: PairState | JointState, x_n: Floats, x_trial: Floats) -> None:
        comm: MPI.Comm = state.nodes.V.mesh.comm
        for member in members(state):
            member.reduce_initial_depth()
        self._x_in_space, self._members, self._ends = x_n, members(state), state.ends
        frame = state.search.frame
        x_n, x_trial = frame.at_start(x_n), frame.at_end(x_trial)
        # Largest displacement increment of a node in the trial motion [m].
        self._increment: float = reductions.largest(comm, _kernels.farthest(x_trial, x_n))
        # Gap that counts as near, and largest distance of nodes in front of or behind segments [m].
        self._open_reach = _REACH * self._increment + _kernels.DEEPEST * state.longest_segment
        self.reach = self._open_reach + state.search.initial_depth
        reach = self.reach + self._additional_reach(state.pair)
        self.candidates, _ = candidates, _ = state.search.update(x_n, reach)
        self.points = points = state.facets.points(x_n)
        self.x_n = candidates.scatter.forward(x_n)
        trial = candidates.scatter.forward(x_trial)

        last = state.history.key
        pairing = NodePairing(state.nodes, candidates, points, self.x_n, state.history)
        self.pairing: Pairing = pairing
        self.shared: SharedSegments = pairing.shared
        self._shares = _may_share(state.pair) and candidates.adjacent(self.x_n) is not None
        self.last = candidates.find(last)
        self.start = segment_n, gap = candidates.pair(points, self.x_n, self.last, self.reach)
        if self._shares:
            # Nodes with several segments are assigned again, to the nearest ones.
            several = indices(state.history.shared != 0)
            before = self.last.copy()
            before[several] = -1
            self._find_again(self.x_n, several, segment_n, gap)
            every = np.arange(len(gap), dtype=np.int32)
            self._share(self.x_n, every, before, segment_n, gap)
        met, gap_trial = candidates.pair(points, trial, segment_n, self.reach)
        several = indices(self.shared.many & (met >= 0))
        gap_trial[several] = pairing.gaps(trial, several, met[several])
        met[several] = segment_n[several]
        # A node that would be too deep for the search gets the segment through which it enters.
        self.passing: Flags = np.zeros(len(met), dtype=bool)
        self._assign_entered(trial, met, gap_trial)
        # The gap at t_n is the gap to the segment in the trial state.
        gap_n = gap.copy()
        moved = indices((met >= 0) & (met != segment_n))
        if len(moved):
            gap_n[moved] = candidates.gap(points.take(moved), self.x_n, met[moved])
        self.approach = Approach(np.where(met >= 0, met, segment_n), gap_n, gap_trial, trial)
        self.segment: Ints = segment_n.copy()
        self.gap: Floats = gap.copy()
        self._moves: Ints = np.zeros(len(self.segment), dtype=np.int32)

    def _assign_entered(self, trial: Floats, met: Ints, gap_trial: Floats) -> None:
        """Assign the segment through which a node would pass: set ``met`` and ``gap_trial``."""
        if self._increment <= self.candidates.passage.min(initial=np.inf) / 2:
            return
        node = indices(~(self.start[1] > 2 * self._increment))
        none = np.full(len(node), -1, dtype=np.int32)
        paths = self.candidates.follow(self.points.take(node), self.x_n, trial, none)
        passing = paths.passes(self.candidates.size) | ((paths.entered >= 0) & (met[node] < 0))
        met[node[passing]], gap_trial[node[passing]] = paths.entered[passing], paths.gap[passing]
        self.passing[node[passing]] = True

    def _find_again(self, x: Floats, node: Ints, segment: Ints, gap: Floats) -> Flags:
        """Find the nearest segments of some nodes again, among the neighbours of their segments.

        Arguments are positions, the nodes, shape ``(m,)``, and segments and gaps of all nodes,
        which are changed. Returns flags of the nodes with a new segment, shape ``(m,)``.
        """
        candidates = self.candidates
        none = np.full(len(node), -1, dtype=np.int32)
        if not len(node):
            return none >= 0
        found, there = candidates.pair(self.points.take(node), x, none, self.reach)
        adjacent, _ = self._adjacent(x)
        is_next: Flags = (found >= 0) & (segment[node] >= 0)
        own = node[is_next]
        is_next[is_next] = adjacent.have_common_vertices(segment[own], found[is_next])
        segment[node[is_next]], gap[node[is_next]] = found[is_next], there[is_next]
        return is_next

    def _share(self, x: Floats, node: Ints, before: Ints, found: Ints, gap: Floats) -> None:
        """Assign all equally near segments to the nodes whose segment is new.

        Arguments are positions, and for ``m`` nodes their numbers, old segments, new segments,
        and gaps. The gaps of nodes with several segments are replaced by means.
        """
        (new,) = (found != before).nonzero()
        if not len(new):
            return
        some = new[found[new] >= 0]
        own, (adjacent, vertices) = found[some], self._adjacent(x)
        points, size = self.points.take(node[some]).of(x), self.candidates.size[own]
        row, segment = adjacent.as_near(points, vertices, own, size)
        self.shared.replace(node[new], np.searchsorted(new, some[row]), segment)
        several = new[self.shared.many[node[new]]]
        gap[several] = self.pairing.gaps(x, node[several], found[several])

    def _slid(self, x: Floats, node: Ints, slack: float) -> Ints:
        """Flags of nodes, ``(m,)``, outside one of their segments by more than a tolerance."""
        if np.isinf(slack) or not self.shared.many[node].any():
            return node[:0]
        slack = min(slack, self._sharing)
        node = node[self.shared.many[node]]
        row, segment, start = self.shared.entries(node, self.segment[node])
        adjacent, vertices = self._adjacent(x)
        outside = adjacent.outside(self.points.take(node[row]).of(x), vertices, segment)
        slid: Ints = node[np.maximum.reduceat(outside, start[:-1]) > slack]
        return slid

    def _adjacent(self, x: Floats) -> tuple[AdjacentFacets, Floats]:
        """Facets that may share nodes, see `Candidates.adjacent`, which must not return None."""
        found = self.candidates.adjacent(x)
        assert found is not None
        return found

    @staticmethod
    def _additional_reach(pair: ContactPair) -> float:
        """Length added to the search radius, such as the length of edges [m]."""
        return 0.0

    @property
    def may_close(self) -> Flags:
        """Flags of nodes whose gap may close within the step, shape ``(n,)``."""
        flags: Flags = np.fmin(self.approach.gap_n, self.approach.gap) < self._increment
        return flags

    @property
    def touches(self) -> Flags:
        """Flags of nodes on their segments at t_n, up to round-off, shape ``(n,)``."""
        size = self.candidates.size
        # Without candidates no node has a segment.
        size = size.take(self.approach.segment, mode="wrap") if len(size) else np.ones(1)
        flags: Flags = np.abs(self.approach.gap_n) <= TOUCHES * size
        return flags

    @property
    def chosen_at(self) -> Floats | None:
        """Positions for which points were chosen in equilibrium, ``(l, 3)`` [m]. Local.

        None if they were not chosen there.
        """
        return None

    @property
    def dual_fraction(self) -> Floats:
        """Largest fraction of dual functions around each node, 1 without points, ``(n,)`` [-]."""
        return np.ones(len(self.segment))

    @cached_property
    def pressed_layers(self) -> tuple[Floats, Floats] | None:
        """Fractions of the nodal areas on which the segments may press, and heights behind them.

        Collective at the first use. See `NodalFacets.pressed_layers`; None without edges, where all
        are 1. Of a block that lies on a plane, the lateral facets do not touch.
        """
        if not any(state.facets.has_edges for state in self._members):
            return None
        normal, layers = self._facing_normals(), []
        for state, (first, last) in zip(self._members, pairwise(self._ends), strict=True):
            layers.append(state.facets.pressed_layers(self._x_in_space, normal[first:last]))
        fractions, heights = zip(*layers, strict=True)
        return np.concatenate(fractions), np.concatenate(heights)

    @property
    def pressed_fractions(self) -> Floats:
        """Fractions of the nodal areas on which the segments may press, ``(n,)`` [-]."""
        layers = self.pressed_layers
        return np.ones(len(self.approach.segment)) if layers is None else layers[0]

    def _facing_normals(self) -> Floats:
        """Unit normals of contact at the nodes at t_n, 0 without a segment, ``(n, 3)``. Local."""
        segment = self.approach.segment
        normal = np.zeros((len(segment), 3))
        (node,) = (segment >= 0).nonzero()
        points = self.points.take(node.astype(np.int32))
        normal[node] = contact_normals(self.candidates, points, self.x_n, segment[node])
        return normal

    def least_faced(self, values: Floats) -> Floats:
        """Minimum of values over the segments that nodes face at t_n, shape ``(n, k)``. Local.

        It is infinite without a segment. ``values`` belong to the candidates, ``(s, k)``.
        """
        segment = self.approach.segment
        found: Floats = np.full((len(segment), values.shape[1]), np.inf)
        found[segment >= 0] = values[segment[segment >= 0]]
        return found

    def find(self, x: Floats, node: Ints, iteration: int) -> tuple[Ints, Flags]:
        """Find the segments of nodes in an iterate.

        Nodes keep their initial segments, extended beyond their edges, until equilibrium
        (`reproject`). A choice at each iterate would depend on the accuracy of the linear
        solutions, and thus on the partition.

        Args:
            x: Positions with ghosts, shape ``(l, 3)`` [m].
            node: Indices of nodes of the surface, shape ``(m,)``.
            iteration: Number of the Newton iteration, from 0.

        Returns:
            The segments, -1 for none, and flags of the nodes whose segment has changed.
        """
        segment, moved = self._find(x, node, np.inf if iteration else _kernels.HYSTERESIS)
        if iteration:
            self._count(node, moved)
        return segment, moved

    def reproject(self, x: Floats, node: Ints, active: Flags, converged: bool) -> tuple[int, bool]:
        """Find the segments of nodes in equilibrium. Collective.

        Args:
            x: Positions with ghosts, shape ``(l, 3)`` [m].
            node: Indices of nodes of the surface, shape ``(m,)``.
            active: Flags of the nodes that transmit force, shape ``(m,)``.
            converged: Whether Newton's method has converged; otherwise x is only near an
                equilibrium.

        Returns:
            The number of changed segments on this rank, and whether the contact points changed.
        """
        self._moves[self._left_inside(x, node[~active])] = _MOST_MOVES - 1
        _, moved = self._find(x, node, self._overhang)
        self._count(node, moved)
        return int(np.count_nonzero(moved)), False

    def unheld(self, x: Floats, node: Ints, active: Flags) -> tuple[Ints, Ints, Floats]:
        """Nodes inside the other surface, deeper than at t_n, that contact has lost. Local.

        They are found independently of the contact points; none where the points are the nodes,
        whose segments are checked instead.

        Args:
            x: Positions with ghosts at the end of the step, shape ``(l, 3)`` [m].
            node: Eligible nodes, shape ``(m,)``.
            active: Flags of all nodes that transmit force, shape ``(n,)``.

        Returns:
            The nodes, their segments, and the gaps to these [m], see `penetrated_nodes`.
        """
        none = node[:0]
        return none, none, np.empty(0)

    def _left_inside(self, x: Floats, node: Ints) -> Ints:
        """Select nodes with a fixed segment that penetrate another one. Local.

        A node that has changed its segment too often keeps its last one, or none. This is wrong if
        it transmits no force and has penetrated another segment deeper than at t_n.
        """
        node = node[self._moves[node] >= _MOST_MOVES]
        if not len(node):
            return node
        inside, segment, _ = penetrated_nodes(self, x, node, TOUCHES)
        others: Ints = inside[segment != self.segment[inside]]
        return others

    def start_from(self, other: "LocalSearch") -> None:
        """Start with the segments at the end of another attempt at the same step.

        Segments outside the search radius are replaced by those of this attempt. Mortar points are
        chosen at the trial positions.
        """
        if not self.pairing.follows:
            return
        key = np.full(len(self.segment), -1, dtype=np.int64)
        found = other.segment >= 0
        key[found] = other.candidates.key[other.segment[found]]
        last, before = self.candidates.find(key), self.segment
        self.segment = np.where(last >= 0, last, before).astype(np.int32)
        (nodes,) = (self.segment != before).nonzero()
        row, segment = nodes[:0].astype(np.int32), nodes[:0].astype(np.int32)
        if other.candidates is self.candidates:
            nodes, of_other = (last >= 0).nonzero()[0], other.shared
            kept = last[of_other.node] >= 0
            row = np.searchsorted(nodes, of_other.node[kept]).astype(np.int32)
            segment = of_other.segment[kept]
        self.shared.replace(nodes.astype(np.int32), row, segment)

    def _find(self, x: Floats, node: Ints, slack: float) -> tuple[Ints, Flags]:
        """Find segments of nodes; also return flags of nodes whose segment has changed."""
        before = self.segment[node]
        free, current = node, before
        if self._moves.max(initial=0) >= _MOST_MOVES:
            stays = self._moves[node] >= _MOST_MOVES
            kept = node[stays & (before >= 0)]
            self.gap[kept] = self.candidates.gap(self.points.take(kept), x, self.segment[kept])
            free = node[~stays]
            current = self.segment[free]
        slid = self._slid(x, free, slack) if self._shares else free[:0]
        found, gap = self.candidates.pair(self.points.take(free), x, current, self.reach, slack)
        lost = ((found < 0) & self.passing[free]).nonzero()[0]
        if len(lost):
            found[lost] = self.approach.segment[free[lost]]
            gap[lost] = self.candidates.gap(self.points.take(free[lost]), x, found[lost])
        self.segment[free], self.gap[free] = found, gap
        segment = found if free is node else self.segment[node]
        moved = segment != before
        if self._shares:
            if len(slid):
                renewed = slid[self._find_again(x, slid, self.segment, self.gap)]
                current = np.where(np.isin(free, renewed), -1, current).astype(np.int32)
                found, gap = self.segment[free], self.gap[free]
                segment = self.segment[node]
                moved |= np.isin(node, renewed)
            self._share(x, free, current, found, gap)
            # Also count changes of nodes that keep their segments.
            several = node[self.shared.many[node]]
            self.gap[several] = self.pairing.gaps(x, several, self.segment[several])
        return segment, moved

    def _count(self, node: Ints, moved: Flags) -> None:
        """Count the changes of the segment of each node."""
        if moved.any():
            self._moves[node] += moved

    @property
    def unsettled(self) -> Flags:
        """Flags of nodes that keep their segment after too many changes, shape ``(n,)``."""
        flags: Flags = self._moves >= _MOST_MOVES
        return flags


class StaticSearch(LocalSearch):
    """Local search without inertia: nodes change their segment at its edges."""

    _overhang = STATIC_OVERHANG
    # Static steps are long: a node that has left the edge between its segments gets only one of
    # them. The tolerance is the same as at the start of a step.
    _sharing = _kernels.HYSTERESIS


def penetrated_nodes(
    search: LocalSearch, x: Floats, node: Ints, least: float
) -> tuple[Ints, Ints, Floats]:
    """Select the nodes that have penetrated their segments within the step. Local.

    Args:
        search: Local search of the nodes.
        x: Positions with ghosts at the end of the step, shape ``(l, 3)`` [m].
        node: Indices of nodes of the surface, shape ``(m,)``.
        least: Least increase of the depth since t_n, relative to the segment's size [-].

    Returns:
        The nodes, their segments at the end of the step, and the gaps to these [m].
    """
    candidates, points, current = search.candidates, search.points, search.segment[node]
    overhang = search._overhang
    segment, gap = candidates.pair(points.take(node), x, current, search.reach, overhang)
    inside = (gap < 0).nonzero()[0]
    node, segment, gap = node[inside], segment[inside], gap[inside]
    before = candidates.gap(points.take(node), search.x_n, segment)
    deeper = gap < np.fmin(before, 0.0) - least * candidates.size[segment]
    return node[deeper], segment[deeper], gap[deeper]


def _may_share(pair: ContactPair) -> bool:
    """Whether nodes may have several segments: in node-to-segment contact with segment changes."""
    alone = isinstance(pair.enforcement, Tied) or pair.is_convective or is_resolved(pair)
    return pair.method == NODES and not (alone or pair.touches_itself)
