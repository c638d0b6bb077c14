"""Local search: which candidate each contact point faces, in one attempt at a step."""

from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.enforcement import TOUCHES, Tied
from dolfinx_nts.contact.implicit.pairing import NodePairing, Pairing
from dolfinx_nts.contact.joint_state import JointState, members
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.contact.method import NODES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.model.obstacles.adjacent_facets import AdjacentFacets
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.shared_segments import SharedSegments

__all__ = [
    "STATIC_OVERHANG",
    "Approach",
    "LocalSearch",
    "StaticSearch",
    "may_face",
    "sunk",
]

# How often a node may change its segment in a step, after which it stays with the last one.
_MOST_MOVES = 2
# How far beyond the edge of its segment, in sizes of it [-], a node without inertia may be in
# equilibrium: in a dent it is below the next segment there.
STATIC_OVERHANG = 0.06
# Reach of the search in ways of the fastest node [-]: both surfaces may move, and Newton
# iterates overshoot.
_WAYS = 3


def may_face(state: PairState | JointState, x_n: Floats, way: float) -> bool:
    """Whether nodes of a pair may face anything in a step, or did so in the last one. Collective.

    Nothing becomes of others in a step with inertia: they need no attempt.

    Args:
        state: State of the contact pair, or of several.
        x_n: Accepted positions of the local nodes of the space, owned and ghost, ``(l, 3)``
            [m].
        way: Longest way of a node in the ballistic step, the same on all ranks [m].
    """
    near = isinstance(state, JointState) or state.search.is_near(
        x_n, (_WAYS + 1) * way + _kernels.DEEPEST * state.longest_segment + state.search.sunk
    )
    comm: MPI.Comm = state.nodes.V.mesh.comm
    return reductions.anywhere(comm, near or bool(np.any(state.history.key != -1)))


class Approach(NamedTuple):
    """Where nodes would go without contact, and what they would meet there.

    Attributes:
        segment: Segment that the ballistic state meets, or that at t_n; -1 without, ``(n,)``.
        gap_n: Gap to it at t_n, NaN without, shape ``(n,)`` [m].
        gap: Gap of the ballistic state, shape ``(n,)`` [m].
        x: Positions in that state of the nodes that the candidates know, shape ``(l, 3)`` [m].
    """

    segment: Ints
    gap_n: Floats
    gap: Floats
    x: Floats


class LocalSearch:
    """Nodes of contact pairs and the segments that they face. Collective; its methods are local.

    Positions are those in the frame of the search of the pair, but for those of the arguments.

    Args:
        state: State of the contact pair, or of several.
        x_n: Accepted positions of the local nodes of the space, owned and ghost, ``(l, 3)``
            [m].
        x_trial: The same for the ballistic state x_n + h v_n.

    Attributes:
        candidates: Candidates in reach.
        points: Contact points of the nodes, which face what they do at t_n.
        reach: Largest gap of interest [m].
        x_n: Positions at t_n of the nodes that the candidates know.
        last: Segment of each node in the last step or -1, shape ``(n,)``.
        start: Segment of each node at t_n or -1, ``(n,)``, and gap to it, NaN without, ``(n,)``
            [m].
        segment: Segment of each node now or -1, shape ``(n,)``.
        gap: Gap to the segment now, NaN without, shape ``(n,)`` [m].
        approach: What the nodes would meet without contact.
        caught: Nodes that would pass a segment on the trial motion, shape ``(n,)``.
        pairing: Evaluates nodes and what they face.
        shared: Segments of the nodes that are equally near to several.
    """

    _overhang: float = _kernels.OVERHANG
    # How far off one of its segments a node in equilibrium still has all of them, in sizes of it
    # [-]: a step is short, and the next one begins with the nearest segment.
    _sharing: float = _kernels.OVERHANG

    def __init__(self, state: PairState | JointState, x_n: Floats, x_trial: Floats) -> None:
        """Find the candidates, the segments at t_n and those of the ballistic state."""
        comm: MPI.Comm = state.nodes.V.mesh.comm
        for member in members(state):
            member.rise()
        frame = state.search.frame
        x_n, x_trial = frame.at_start(x_n), frame.at_end(x_trial)
        # Longest way of a node in the ballistic step.
        self._way: float = reductions.largest(comm, _kernels.farthest(x_trial, x_n))
        # Nodes down to some depth still belong to their segments.
        deepest = _kernels.DEEPEST * state.longest_segment + state.search.sunk
        self.reach = _WAYS * self._way + deepest
        reach = self.reach + self._beyond(state.pair)
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
            # Of several segments none was the right one: they are found again.
            several = state.history.shared.nonzero()[0].astype(np.int32)
            before = self.last.copy()
            before[several] = -1
            self._find_again(self.x_n, several, segment_n, gap)
            every = np.arange(len(gap), dtype=np.int32)
            self._share(self.x_n, every, before, segment_n, gap)
        met, gap_trial = candidates.pair(points, trial, segment_n, self.reach)
        several = (self.shared.many & (met >= 0)).nonzero()[0].astype(np.int32)
        gap_trial[several] = pairing.gaps(trial, several, met[several])
        met[several] = segment_n[several]
        # Nodes that would be too deep to be found: they face what they enter.
        self.caught: Flags = np.zeros(len(met), dtype=bool)
        self._catch(trial, met, gap_trial)
        # The gap at t_n counts on the segment that the ballistic state meets.
        gap_n = gap.copy()
        moved = ((met >= 0) & (met != segment_n)).nonzero()[0].astype(np.int32)
        if len(moved):
            gap_n[moved] = candidates.gap(points.take(moved), self.x_n, met[moved])
        self.approach = Approach(np.where(met >= 0, met, segment_n), gap_n, gap_trial, trial)
        self.segment: Ints = segment_n.copy()
        self.gap: Floats = gap.copy()
        self._moves: Ints = np.zeros(len(self.segment), dtype=np.int32)

    def _catch(self, trial: Floats, met: Ints, gap_trial: Floats) -> None:
        """Let nodes that would pass a segment meet it: change what they meet, and the gap."""
        if self._way <= self.candidates.passage.min(initial=np.inf) / 2:
            return
        node = (~(self.start[1] > 2 * self._way)).nonzero()[0].astype(np.int32)
        none = np.full(len(node), -1, dtype=np.int32)
        ways = self.candidates.follow(self.points.take(node), self.x_n, trial, none)
        caught = ways.passes(self.candidates.size) | ((ways.entered >= 0) & (met[node] < 0))
        met[node[caught]], gap_trial[node[caught]] = ways.entered[caught], ways.gap[caught]
        self.caught[node[caught]] = True

    def _find_again(self, x: Floats, node: Ints, segment: Ints, gap: Floats) -> Flags:
        """Find the nearest segments of some nodes again, among those that go on from theirs.

        Arguments are positions, the nodes, shape ``(m,)``, and segments and gaps of all, which
        are changed. Returns which nodes have a segment that was found again, shape ``(m,)``.
        """
        candidates = self.candidates
        none = np.full(len(node), -1, dtype=np.int32)
        if not len(node):
            return none >= 0
        found, there = candidates.pair(self.points.take(node), x, none, self.reach)
        adjacent, _ = self._adjacent(x)
        goes_on: Flags = (found >= 0) & (segment[node] >= 0)
        own = node[goes_on]
        goes_on[goes_on] = adjacent.have_common_vertices(segment[own], found[goes_on])
        segment[node[goes_on]], gap[node[goes_on]] = found[goes_on], there[goes_on]
        return goes_on

    def _share(self, x: Floats, node: Ints, before: Ints, found: Ints, gap: Floats) -> None:
        """Let nodes whose segment was found just now have all that are as near.

        Arguments are positions, and of ``m`` nodes their numbers, their segments before, those
        that were found, and gaps, which become means.
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
        """Nodes among some, ``(m,)``, that are farther than slack off one of their segments."""
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
        """Facets that may share nodes, see `Candidates.adjacent`; there are some."""
        found = self.candidates.adjacent(x)
        assert found is not None
        return found

    @staticmethod
    def _beyond(pair: ContactPair) -> float:
        """How much farther than the reach there must be candidates [m]."""
        return 0.0

    @property
    def may_close(self) -> Flags:
        """Nodes whose gap may close within the step, shape ``(n,)``."""
        flags: Flags = np.fmin(self.approach.gap_n, self.approach.gap) < self._way
        return flags

    @property
    def touches(self) -> Flags:
        """Nodes that lie on their segments at t_n, but for round-off, shape ``(n,)``."""
        size = self.candidates.size
        # Without candidates no node has a segment.
        size = size.take(self.approach.segment, mode="wrap") if len(size) else np.ones(1)
        flags: Flags = np.abs(self.approach.gap_n) <= TOUCHES * size
        return flags

    def find(self, x: Floats, node: Ints, iteration: int) -> tuple[Ints, Flags]:
        """Find the segments of nodes in an iterate, and whether they are others than before.

        What iterates would choose depends on how the linear systems were solved, and with it on
        the partition: nodes stay with the segments of the start, continued beyond their edges,
        until equilibrium (`reproject`). ``x`` are positions with ghosts, shape ``(l, 3)`` [m],
        ``node`` positions among the surface's nodes, shape ``(m,)``, ``iteration`` counts
        Newton iterations from 0. Returns segments, -1 without, and flags.
        """
        segment, moved = self._find(x, node, np.inf if iteration else _kernels.HYSTERESIS)
        if iteration:
            self._count(node, moved)
        return segment, moved

    def reproject(self, x: Floats, node: Ints, held: Flags, converged: bool) -> tuple[int, bool]:
        """Find the segments of nodes in equilibrium, see `find`. Collective.

        ``held`` tells which of the nodes transmit force, shape ``(m,)``, ``converged`` whether
        this is equilibrium, and not a state near it. Returns how many changed on this rank, and
        whether the nodes have other contact points.
        """
        self._moves[self._left_inside(x, node[~held])] = _MOST_MOVES - 1
        _, moved = self._find(x, node, self._overhang)
        self._count(node, moved)
        return int(np.count_nonzero(moved)), False

    def _left_inside(self, x: Floats, node: Ints) -> Ints:
        """Restless nodes that the step has brought into what they face now, unseen. Local.

        What they stay with may be any segment that iterates were near, or none. Of the nodes
        that transmit no force these are those for which that is wrong: they are inside of the
        segment which they would have else, and deeper than at t_n.
        """
        node = node[self._moves[node] >= _MOST_MOVES]
        if not len(node):
            return node
        inside, segment, _ = sunk(self, x, node, TOUCHES)
        others: Ints = inside[segment != self.segment[inside]]
        return others

    def go_on_from(self, other: "LocalSearch") -> None:
        """Begin with the segments at the end of another attempt at the same step.

        Where they are not in reach any more they are those of this attempt. Contact points that
        do not follow their nodes are chosen where positions without contact want them.
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
        """Segments of nodes; whether they are others than before."""
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
        lost = ((found < 0) & self.caught[free]).nonzero()[0]
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
            # Also of nodes that stay with their segments.
            several = node[self.shared.many[node]]
            self.gap[several] = self.pairing.gaps(x, several, self.segment[several])
        return segment, moved

    def _count(self, node: Ints, moved: Flags) -> None:
        """Count changes of the segment, node by node."""
        if moved.any():
            self._moves[node] += moved

    @property
    def restless(self) -> Flags:
        """Nodes that have changed their segment too often, shape ``(n,)``."""
        flags: Flags = self._moves >= _MOST_MOVES
        return flags


class StaticSearch(LocalSearch):
    """Nodes without inertia, which slide over edges where these are, see `LocalSearch`."""

    _overhang = STATIC_OVERHANG
    # A static step is long: a node that has left the edge between its segments shares them no
    # more, by the tolerance at the start of a step.
    _sharing = _kernels.HYSTERESIS


def sunk(search: LocalSearch, x: Floats, node: Ints, least: float) -> tuple[Ints, Ints, Floats]:
    """Find those of some nodes that a step has brought into the segments that they meet. Local.

    Args:
        search: What the nodes face.
        x: Positions with ghosts at the end of the step, shape ``(l, 3)`` [m].
        node: Positions among the surface's nodes, shape ``(m,)``.
        least: By how much they are deeper than at t_n, relative to the segment's size [-].

    Returns:
        The nodes, their segments there, and the gaps to these [m].
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
    """Whether nodes may have several segments: not where they keep one, or none is theirs."""
    alone = isinstance(pair.enforcement, Tied) or pair.is_convective or is_resolved(pair)
    return pair.method == NODES and not (alone or pair.touches_itself)
