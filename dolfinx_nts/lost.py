"""Nodes that a step would lose: contact ends with an error, never silently.

The pairing of nodes and segments ends where a node is half a segment deep,
for there it may belong to another side of the body. A node that gets there
within a step has gone through the surface.

A segment holds the gap of a node that presses on it. In a pit of the surface a
node can slide from segment to segment, each time deeper below the next: it
sinks, however small the steps.
"""

import numpy as np

from dolfinx_nts.contact_step import ContactStep
from dolfinx_nts.search import Neighbourhood

__all__ = ["lost_nodes"]

# Of the size of a segment. Depth from which a pressing node does not just
# slide off the rim, or over an edge; way in which the path of a node is looked
# at; difference of depths that is none.
_SUNK, _LOOK, _SAME = 0.1, 0.25, 1e-6
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
    return f"nodes that sank into a surface: {sunk}" if sunk else ""


def _sunk(step: ContactStep, here: Neighbourhood) -> int:
    """Nodes that pressed from within a body and now have no segment, or a higher one."""
    old = step.pair.history
    before = here.find(old.key)
    node = np.flatnonzero(old.active & (before >= 0)).astype(np.int32)
    node = node[old.gap[node] < -_SUNK * here.size[before[node]]]
    if not len(node):
        return 0
    segment, pairing = before[node], step.pairing
    nodes, now = step.pair.nodes.nodes[node], pairing.segment[node]
    after, gap = here.pair(step.x, nodes, now, pairing.reach)
    deeper = (after != segment) & (gap < old.gap[node] - _SAME * here.size[segment])
    return int(np.count_nonzero((after < 0) | deeper))


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
