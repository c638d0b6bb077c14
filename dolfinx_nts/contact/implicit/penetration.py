"""Nodes that a step would let through a surface: such a step fails, and says so.

Nodes and segments are paired down to a depth of half a segment, as a deeper node may belong to
another side of the body. See `passage` for nodes that go through in one step.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.joint_search import JointSearch
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.joint_state import bounds, members
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.passage import Passage, passing_nodes_message
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import sunk_from
from dolfinx_nts.search.points import ContactPoints

__all__ = ["check_penetration"]

# Depth that another segment may give to a pressing node, and by how much it may make it deeper,
# relative to the size of a segment [-].
_DEEP, _DEEPER = 0.1, 0.05


def check_penetration(step: ContactStep, dt: float) -> str:
    """Say what is wrong with the nodes at the end of a step, or "". Collective.

    Call it after the last evaluation of the step.

    Args:
        step: The solved step.
        dt: Its length [s].
    """
    parts = _parts(step)
    counts = [0, 0, step.search.pairing.num_beyond(step.x, _numbers(step.normal.active))]
    if step.search.pairing.follows:
        counts[:2] = (sum(map(count, parts)) for count in (_without_segment, _between_segments))
    without, between, beyond = reductions.total(step.state.nodes.V.mesh.comm, counts)
    if without:
        springs = isinstance(step.state.pair.enforcement, Penalty)
        advice = "; stiffer springs (eps_N) or LagrangeMultiplier hold them" if springs else ""
        return f"nodes that sank into a surface and face no segment any more: {without}{advice}"
    if between:
        return f"nodes that sank into a surface between two segments: {between}"
    if beyond:
        return f"contact points that slid off their segments within the step: {beyond}"
    messages = (passing_nodes_message(part.state.nodes, _passage(part), dt) for part in parts)
    return next(filter(None, messages), "")


class _Part(NamedTuple):
    """One contact pair at the end of a step.

    Attributes:
        state: State of the pair.
        search: Segments of its nodes.
        active: Whether a node transmits force, shape ``(n,)``.
        x: Positions of the nodes that its candidates know, shape ``(l, 3)`` [m].
    """

    state: PairState
    search: LocalSearch
    active: Flags
    x: Floats


def _parts(step: ContactStep) -> list[_Part]:
    """Pairs of a step."""
    search, active = step.search, step.normal.active
    if not isinstance(search, JointSearch):
        (state,) = members(step.state)
        return [_Part(state, search, active, step.x)]
    ends = pairwise(bounds(step.state))
    each = zip(members(step.state), search.members, ends, strict=True)
    return [
        _Part(state, own, active[start:end], search.at(number, step.x))
        for number, (state, own, (start, end)) in enumerate(each)
    ]


def _numbers(flags: Flags) -> Ints:
    return flags.nonzero()[0].astype(np.int32)


def _passage(part: _Part) -> Passage:
    """Nodes that pass what they face. Local."""
    search = part.search
    ends, start = (search.x_n, part.x), search.start
    return Passage.through(
        search.candidates, search.points, ends, start, search.reach, ~part.active
    )


def _without_segment(part: _Part) -> int:
    """Number of nodes that press from within a body and have no segment at the end.

    It includes those that stayed with their segment because they had changed it again and
    again: the next step could not begin, however short.
    """
    old, search, candidates = part.state.history, part.search, part.search.candidates
    before, now = search.last, search.segment
    deep = old.active & (before >= 0)
    deep[deep] = old.gap[deep] < -sunk_from(candidates, before[deep])
    pressing = part.active.copy()
    pressing[pressing] = search.gap[pressing] < -sunk_from(candidates, now[pressing])
    node = _numbers(deep | pressing)
    if not len(node):
        return 0
    points = search.points.take(node)
    after, _ = candidates.pair(points, part.x, now[node], search.reach)
    last = np.where(now >= 0, now, before)[node]
    beside = _beside(part, points, last)
    return int(np.count_nonzero((after < 0) & ~beside))


def _beside(part: _Part, points: ContactPoints, segment: Ints) -> Flags:
    """Whether points have left their segments sideways, over a rim of the surface."""
    candidates = part.search.candidates
    depth = -candidates.gap(points, part.x, segment)
    flags: Flags = depth < _kernels.DEEPEST * candidates.size[segment]
    return flags & candidates.is_at_rim(points, part.x, segment)


def _between_segments(part: _Part) -> int:
    """Number of pressing nodes that their next segment has much deeper within the body.

    At the bottom of a dent a node finds no place over either of two segments.
    """
    node = _numbers(part.active)
    if not len(node):
        return 0
    search, size = part.search, part.search.candidates.size
    now, gap = search.segment[node], search.gap[node]
    points = search.points.take(node)
    after, gap_after = search.candidates.pair(points, part.x, now, search.reach)
    deeper = (gap_after < -_DEEP * size[now]) & (gap_after < gap - _DEEPER * size[now])
    return int(np.count_nonzero(deeper & (after != now)))
