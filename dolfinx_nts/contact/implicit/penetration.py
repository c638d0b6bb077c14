"""Nodes that a step would let through a surface: such a step fails, and says so.

Nodes and segments are paired down to a depth of half a segment, as a deeper node may belong to
another side of the body. See `passage` for nodes that go through in one step.
"""

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Ints
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.implicit.contact_step import ContactStep
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
    counts = [0, 0, step.search.pairing.num_beyond(step.x, _numbers(step.normal.active))]
    if step.search.pairing.follows:
        counts[:2] = _without_segment(step), _between_segments(step)
    without, between, beyond = reductions.total(step.state.nodes.V.mesh.comm, counts)
    if without:
        springs = isinstance(step.state.pair.enforcement, Penalty)
        advice = "; stiffer springs (eps_N) or LagrangeMultiplier hold them" if springs else ""
        return f"nodes that sank into a surface and face no segment any more: {without}{advice}"
    if between:
        return f"nodes that sank into a surface between two segments: {between}"
    if beyond:
        return f"contact points that slid off their segments within the step: {beyond}"
    return passing_nodes_message(step.state.nodes, _passage(step), dt)


def _numbers(flags: Flags) -> Ints:
    return flags.nonzero()[0].astype(np.int32)


def _passage(step: ContactStep) -> Passage:
    """Nodes that pass what they face. Local."""
    search = step.search
    ends, start = (search.x_n, step.x), search.start
    return Passage.through(
        search.candidates, search.points, ends, start, search.reach, ~step.normal.active
    )


def _without_segment(step: ContactStep) -> int:
    """Number of nodes that press from within a body and have no segment at the end.

    It includes those that stayed with their segment because they had changed it again and
    again: the next step could not begin, however short.
    """
    old, search, candidates = step.state.history, step.search, step.search.candidates
    before, now = search.last, search.segment
    deep = old.active & (before >= 0)
    deep[deep] = old.gap[deep] < -sunk_from(candidates, before[deep])
    pressing = step.normal.active.copy()
    pressing[pressing] = search.gap[pressing] < -sunk_from(candidates, now[pressing])
    node = _numbers(deep | pressing)
    if not len(node):
        return 0
    points = search.points.take(node)
    after, _ = candidates.pair(points, step.x, now[node], search.reach)
    last = np.where(now >= 0, now, before)[node]
    beside = _beside(step, points, last)
    return int(np.count_nonzero((after < 0) & ~beside))


def _beside(step: ContactStep, points: ContactPoints, segment: Ints) -> Flags:
    """Whether points have left their segments sideways, over a rim of the surface."""
    candidates = step.search.candidates
    depth = -candidates.gap(points, step.x, segment)
    flags: Flags = depth < _kernels.DEEPEST * candidates.size[segment]
    return flags & candidates.is_at_rim(points, step.x, segment)


def _between_segments(step: ContactStep) -> int:
    """Number of pressing nodes that their next segment has much deeper within the body.

    At the bottom of a dent a node finds no place over either of two segments.
    """
    node = _numbers(step.normal.active)
    if not len(node):
        return 0
    search, size = step.search, step.search.candidates.size
    now, gap = search.segment[node], search.gap[node]
    points = search.points.take(node)
    after, gap_after = search.candidates.pair(points, step.x, now, search.reach)
    deeper = (gap_after < -_DEEP * size[now]) & (gap_after < gap - _DEEPER * size[now])
    return int(np.count_nonzero(deeper & (after != now)))
