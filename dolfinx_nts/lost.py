"""Nodes that a step would lose: contact ends with an error, never silently.

The pairing of nodes and segments ends where a node is half a segment deep,
for there it may belong to another side of the body. A node that gets there
within a step has gone through the surface.
"""

import numpy as np

from dolfinx_nts.contact_step import ContactStep
from dolfinx_nts.search import Neighbourhood

__all__ = ["lost_nodes"]

# Of the size of a segment. Depth from which a pressing node does not just
# slide off the rim; way in which the path of a node is looked at.
_SUNK, _LOOK = 0.1, 0.25
_MOST_LOOKS = 100


def lost_nodes(step: ContactStep) -> str:
    """Say what is wrong with the nodes at the end of a step, or "".

    Collective. Call it after the last evaluation of the step.

    Args:
        step: The solved step.
    """
    here = step.neighbourhood
    if not isinstance(here, Neighbourhood):
        return ""
    counts = np.array([_sunk(step, here), _passed(step, here)])
    sunk, passed = step.comm.allreduce(counts)
    if passed:
        return f"nodes that pass through a surface: {passed}"
    return f"nodes that sank into a surface and face no segment any more: {sunk}" if sunk else ""


def _sunk(step: ContactStep, here: Neighbourhood) -> int:
    """Nodes that press from within a body and have no segment at the end.

    Also those that kept theirs, because they changed it again and again: the
    next step could not begin, however short.
    """
    old, pairing = step.pair.history, step.pairing
    before = here.find(old.key)
    deep = old.active & (before >= 0) & (old.gap < -_SUNK * here.size[before])
    deep |= step.active & (pairing.gap < -_SUNK * here.size[pairing.segment])
    node = np.flatnonzero(deep).astype(np.int32)
    nodes, segment = step.pair.nodes.nodes[node], pairing.segment[node]
    after, _ = here.pair(step.x, nodes, segment, pairing.reach)
    return int(np.count_nonzero(after < 0))


def _passed(step: ContactStep, here: Neighbourhood) -> int:
    """Nodes outside before the step that came out on the other side."""
    nodes, size = step.pair.nodes.nodes, here.size.min(initial=np.inf)
    x_n, reach = step.pairing.x_n, step.pairing.reach
    way = 2 * np.linalg.norm(step.x - x_n, axis=1).max(initial=0.0)
    if way <= _LOOK * size:
        return 0
    before, gap_n = here.pair(x_n, nodes, step.pairing.segment_n, reach)
    after, _ = here.pair(step.x, nodes, before, reach)
    node = np.flatnonzero((before >= 0) & (gap_n > 0) & (after < 0) & ~step.active)
    if not len(node):
        return 0
    inside = np.zeros(len(node), dtype=bool)
    segment = before[node]
    num_looks = min(int(np.ceil(way / (_LOOK * size))), _MOST_LOOKS)
    for part in np.linspace(0, 1, num_looks + 1)[1:-1]:
        x = x_n + part * (step.x - x_n)
        segment, gap = here.pair(x, nodes[node], segment, reach)
        inside |= (segment >= 0) & (gap < 0)
    return int(np.count_nonzero(inside))
