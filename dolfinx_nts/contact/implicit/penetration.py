"""Nodes that a step would lose: contact ends with an error, never silently.

The pairing of nodes and segments ends where a node is half a segment deep,
for there it may belong to another side of the body. A node that gets there
within a step has gone through the surface.
"""

import numpy as np
from basix import CellType, topology

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Ints
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import SegmentCandidates

__all__ = ["check_penetration"]


# Of the size of a segment. Depth from which a pressing node does not just
# slide off the rim; by which another segment must not make it deeper; way in
# which the path of a node is looked at.
_TOO_DEEP, _DEEPER, _LOOK = 0.1, 0.05, 0.25
# Ends of the edges, by the number of vertices.
_EDGES = {
    len(topology(cell)[0]): topology(cell)[1]
    for cell in (CellType.triangle, CellType.quadrilateral)
}
_MOST_LOOKS = 100


def check_penetration(step: ContactStep) -> str:
    """Say what is wrong with the nodes at the end of a step, or "".

    Collective. Call it after the last evaluation of the step.

    Args:
        step: The solved step.
    """
    candidates = step.candidates
    if not isinstance(candidates, SegmentCandidates):
        return ""
    counts = [
        _tunnelled(step, candidates),
        _too_deep(step, candidates),
        _between_segments(step, candidates),
    ]
    passed, sunk, crept = reductions.total(step.comm, counts)
    if passed:
        return f"nodes that pass through a surface: {passed}"
    if sunk:
        return f"nodes that sank into a surface and face no segment any more: {sunk}"
    return f"nodes that sank into a surface between two segments: {crept}" if crept else ""


def _too_deep(step: ContactStep, candidates: SegmentCandidates) -> int:
    """Nodes that press from within a body and have no segment at the end.

    Also those that kept theirs, because they changed it again and again: the
    next step could not begin, however short.
    """
    old, pairing = step.pair.history, step.local_search
    before, now = pairing.last, pairing.segment
    deep = old.active & (before >= 0)
    deep[deep] = old.gap[deep] < -_TOO_DEEP * candidates.size[before[deep]]
    pressing = step.active.copy()
    pressing[pressing] = pairing.gap[pressing] < -_TOO_DEEP * candidates.size[now[pressing]]
    node = (deep | pressing).nonzero()[0].astype(np.int32)
    if not len(node):
        return 0
    nodes = step.pair.nodes.nodes[node]
    after, _ = candidates.pair(step.x, nodes, now[node], pairing.reach)
    last = np.where(now >= 0, now, before)[node]
    return int(np.count_nonzero((after < 0) & ~_beside(step, candidates, nodes, last)))


def _between_segments(step: ContactStep, candidates: SegmentCandidates) -> int:
    """Nodes that press, and will do so from within a body on their next segment.

    At the bottom of a dent a node finds no place over either of two segments.
    """
    pairing = step.local_search
    (node,) = step.active.nonzero()
    now, gap = pairing.segment[node], pairing.gap[node]
    after, gap_after = candidates.pair(step.x, step.pair.nodes.nodes[node], now, pairing.reach)
    size = candidates.size[now]
    deeper = (gap_after < -_TOO_DEEP * size) & (gap_after < gap - _DEEPER * size)
    return int(np.count_nonzero(deeper & (after != now)))


def _beside(step: ContactStep, candidates: SegmentCandidates, nodes: Ints, segment: Ints) -> Flags:
    """Whether nodes have left a segment sideways, over a rim of the surface."""
    edges = candidates.segments[:, _EDGES[candidates.segments.shape[1]]]
    begin, end = np.moveaxis(step.x[edges[segment]], 2, 0)
    way, r = end - begin, step.x[nodes, None] - begin
    square = np.einsum("mei,mei->me", way, way)
    part = np.einsum("mei,mei->me", r, way) / np.where(square > 0, square, 1)
    distance = np.linalg.norm(r - np.clip(part, 0, 1)[..., None] * way, axis=2)
    nearest = np.sort(edges[segment, distance.argmin(axis=1)])
    shared = (np.sort(edges.reshape(-1, 2))[:, None] == nearest).all(axis=2).sum(axis=0) > 1
    depth = -candidates.gap(step.x, nodes, segment)
    beside: Flags = (depth < _kernels.DEEPEST * candidates.size[segment]) & ~shared
    return beside


def _tunnelled(step: ContactStep, candidates: SegmentCandidates) -> int:
    """Nodes outside before the step that came out on the other side."""
    nodes, size = step.pair.nodes.nodes, candidates.size.min(initial=np.inf)
    x_n, reach = step.local_search.x_n, step.local_search.reach
    way = 2 * _kernels.farthest(step.x, x_n)
    if way <= _LOOK * size:
        return 0
    before, gap_n = candidates.pair(x_n, nodes, step.local_search.segment_n, reach)
    after, _ = candidates.pair(step.x, nodes, before, reach)
    node = np.flatnonzero((before >= 0) & (gap_n > 0) & (after < 0) & ~step.active)
    if not len(node):
        return 0
    inside = np.zeros(len(node), dtype=bool)
    segment = before[node]
    num_looks = min(int(np.ceil(way / (_LOOK * size))), _MOST_LOOKS)
    for part in np.linspace(0, 1, num_looks + 1)[1:-1]:
        x = x_n + part * (step.x - x_n)
        segment, gap = candidates.pair(x, nodes[node], segment, reach)
        inside |= (segment >= 0) & (gap < 0)
    return int(np.count_nonzero(inside))
