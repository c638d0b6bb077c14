"""Local search of several pairs, whose nodes are evaluated together."""

from collections.abc import Sequence
from itertools import pairwise
from typing import cast

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.implicit.local_search import Approach, LocalSearch
from dolfinx_nts.contact.implicit.pairing import NodePairing, Pairing
from dolfinx_nts.contact.joint_state import JointState, bounds
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.segment_candidates import SegmentCandidates

__all__ = ["JointSearch"]


class JointSearch(LocalSearch):
    """Nodes of several pairs: each looks among the segments of its own, see `LocalSearch`.

    Args:
        state: State of the pairs.
        members: Searches of these in this attempt.
        x_n: Accepted positions of the local nodes of the space, owned and ghost, ``(l, 3)``
            [m].
        x_trial: The same for the ballistic state x_n + h v_n.

    Attributes:
        members: The argument.
    """

    def __init__(
        self, state: JointState, members: Sequence[LocalSearch], x_n: Floats, x_trial: Floats
    ) -> None:
        """Join what the searches have found."""
        self.members = tuple(members)
        candidates = [cast(SegmentCandidates, each.candidates) for each in members]
        self._segments = segments = state.segments(candidates)
        self.candidates, self._bounds = segments.candidates, bounds(state)
        self.points = NodalPoints(state.nodes.nodes)
        self._way, self.reach = (max(getattr(e, n) for e in members) for n in ("_way", "reach"))
        self.x_n = self.candidates.scatter.forward(x_n)
        self.pairing: Pairing = NodePairing(
            state.nodes, self.candidates, self.points, self.x_n, state.history.key
        )
        self.last = self._joint([each.last for each in members])
        gap_n, gap, now = (
            np.concatenate(arrays)
            for arrays in zip(
                *((e.approach.gap_n, e.approach.gap, e.gap) for e in members), strict=True
            )
        )
        self.start = self._joint([each.start[0] for each in members]), now.copy()
        self.approach = Approach(
            self._joint([each.approach.segment for each in members]),
            gap_n,
            gap,
            self.candidates.scatter.forward(x_trial),
        )
        self.segment, self.gap = self.start[0].copy(), now
        self._moves = np.zeros(len(now), dtype=np.int32)
        for each, (start, end) in zip(members, pairwise(self._bounds), strict=True):
            each.gap, each._moves = self.gap[start:end], self._moves[start:end]

    def at(self, number: int, x: Floats) -> Floats:
        """Positions, ``(l, 3)``, of the nodes that one of the searches knows. Local."""
        return self._segments.at(number, x)

    def _joint(self, parts: Sequence[Ints]) -> Ints:
        """Segments of all nodes, by those of each pair."""
        numbered = self._segments.numbered
        return np.concatenate([numbered(i, segment) for i, segment in enumerate(parts)])

    def _find(self, x: Floats, node: Ints, slack: float) -> tuple[Ints, Flags]:
        """Let each pair with such nodes find their segments, see `LocalSearch`."""
        segment, moved = np.empty_like(node), np.empty(len(node), dtype=bool)
        ends = map(int, np.searchsorted(node, self._bounds))
        for number, (start, end) in enumerate(pairwise(ends)):
            if start < end:
                own = node[start:end] - np.int32(self._bounds[number])
                found, moved[start:end] = self.members[number]._find(self.at(number, x), own, slack)
                segment[start:end] = self._segments.numbered(number, found)
        self.segment[node] = segment
        return segment, moved
