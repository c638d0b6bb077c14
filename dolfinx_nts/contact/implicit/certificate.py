"""Certificate of a converged step: contact is right for the motion actually made, or refused.

The search of an attempt covers a multiple of the trial motion, which the solution may exceed.
`missed_contact` repeats the search with the motion from x_n to the solution x, and compares.
`check_penetration` refuses nodes that passed through a surface or sank into one: nodes and
segments are paired down to a depth of half a segment, as a deeper node may belong to another
side of the body. See `passage` for nodes that pass through within one step.
"""

from collections.abc import Callable, Sequence

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.enforcement import TOUCHES, Penalty
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.local_search import may_face
from dolfinx_nts.contact.implicit.normal_contact import known_nodes
from dolfinx_nts.contact.joint_state import JointState, members
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.passage import Passage, passing_nodes_message
from dolfinx_nts.fem.node_numbering import listed
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.search.candidates import sunk_from
from dolfinx_nts.search.joint_search import JointSearch
from dolfinx_nts.search.points import ContactPoints

__all__ = ["check_penetration", "missed_contact"]

# Depth that another segment may give to a pressing node, and by how much it may make it deeper,
# relative to the size of a segment [-].
_DEEP, _DEEPER = 0.1, 0.05


def missed_contact(
    steps: Sequence[ContactStep],
    states: Sequence[PairState | JointState],
    ends: tuple[Floats, Floats],
    displacement: float,
    repeat: Callable[[PairState | JointState], ContactStep],
) -> str:
    """Name nodes that the motion actually made brought into a surface, unseen, or "". Collective.

    Free of charge while the largest displacement increment is within the reach of the search, as
    the candidates are exhaustive then.

    Args:
        steps: The solved step of each state that takes part in it.
        states: States of all pairs.
        ends: Positions of the local nodes of the space at both ends of the step, ``(l, 3)`` [m].
        displacement: Largest displacement increment of any node, the same on all ranks [m].
        repeat: Starts the contact of a state again with the end of the step as trial state.
    """
    solved = {step.state: step for step in steps}
    messages = []
    for state in states:
        step = solved.get(state)
        if _is_exhaustive(state, step, ends, displacement):
            continue
        known = None if step is None else known_nodes(step.normal)
        messages.append(_missed_nodes(repeat(state), known, ends[1]))
    return next(filter(None, messages), "")


def _is_exhaustive(
    state: PairState | JointState,
    step: ContactStep | None,
    ends: tuple[Floats, Floats],
    displacement: float,
) -> bool:
    """Whether no node can have come to anything that the search left out. Collective."""
    search = state.search
    if step is None:
        return not may_face(state, ends[0], displacement)
    reach = step.search.reach
    if not search.frame.moves and 2 * displacement <= reach:
        return True
    if isinstance(search, JointSearch):
        return False
    x_n, x = search.frame.at_start(ends[0]), search.frame.at_end(ends[1])
    return search.approach(x, search.positions(x_n)) <= reach


def _missed_nodes(step: ContactStep, known: Flags | None, x: Floats) -> str:
    """Describe nodes that the repeated search would hold and that are inside, or "". Collective.

    Args:
        step: Contact with the end of the step as trial state.
        known: Whether the solved step knew each node, shape ``(n,)``; None: it knew none.
        x: Positions of the local nodes of the space at the end of the step, ``(l, 3)`` [m].
    """
    state, approach = step.state, step.search.approach
    inside = approach.gap < np.fmin(approach.gap_n, 0.0) - TOUCHES * state.segment_sizes
    node = step.normal.nodes
    node = node[inside[node] if known is None else (inside & ~known)[node]]
    pair = np.searchsorted(state.ends, node, side="right") - 1
    nodes = state.nodes
    columns = pair, nodes.node_ids[node], -approach.gap[node], x[nodes.nodes[node]]
    rows = joined(nodes.V.mesh.comm, np.column_stack(columns))
    if not len(rows):
        return ""
    number, _, depth, *place = rows[rows[:, 2].argmax()]
    between = members(state)[int(number)].pair.between
    point = ", ".join(f"{value:.4g}" for value in place)
    ids = np.unique(rows[:, 1].astype(np.int64))
    return (
        f"{len(ids)} nodes are inside the other surface without contact force between {between}, "
        f"up to {depth:.3g} m deep at ({point}), as they moved beyond the reach of the search: "
        f"{listed(ids)}"
    )


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
    flags: Flags = depth < candidates.too_deep(segment)
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
