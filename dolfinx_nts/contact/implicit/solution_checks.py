"""Check that the contact of a converged step is consistent with the computed motion.

The search of an attempt covers a multiple of the trial motion, which the solution may exceed.
`missed_contact` repeats the search with the motion from x_n to the solution x, and compares.
`check_penetration` refuses nodes that passed through a surface or sank into one: a node has a
segment only down to a depth of half a segment, as a deeper node may belong to another side of the
body. See `passage` for nodes that pass through within one step.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints, indices
from dolfinx_nts.contact.checks.overlap_watch import OverlapWatch
from dolfinx_nts.contact.checks.passage import Passage, passing_message, passing_nodes_message
from dolfinx_nts.contact.enforcement import TOUCHES, Penalty, Tied
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.implicit.local_search import LATE, may_face
from dolfinx_nts.contact.implicit.normal.interface import eligible_or_excluded
from dolfinx_nts.contact.joint_state import JointState, members
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.vertices import vertex_tolerance
from dolfinx_nts.fem.node_numbering import listed
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.search.candidates import lost_depth, too_deep
from dolfinx_nts.search.joint_search import JointSearch
from dolfinx_nts.search.points import ContactPoints

__all__ = [
    "check_boundaries",
    "check_forces",
    "check_penetration",
    "missed_contact",
    "passing_without_contact",
]

# Relative to the size of a segment [-]: largest depth of an active node below an adjacent segment,
# or of a node without force in the middle of the step; and largest difference between the depths of
# an active node below an adjacent segment and below its own.
_DEEP, _DEEPER = 0.1, 0.05
# Ratio of trial to computed relative motion of node and segment [-] below which a node moves from
# rest, so that the trial motion does not predict contact. Larger: steps of vibrating bodies are
# solved twice, and may have no second solution. Smaller: a body that begins to move penetrates
# deeper than the law of impact allows.
_STILL = 0.5
# Gap above which a multiplier must be 0, relative to the longest segment [-]. Smaller: below
# the tolerance of constraints in Newton's method. Larger: forces without contact are accepted.
_OPEN = 1e-3
# Admissible error of the length of tractions, relative to the largest normal force [-], and of the
# direction of sliding [rad]. Smaller: below the residual tolerance of Newton's method.
_CONE, _PARALLEL = 1e-3, 0.05
# Admissible error of a multiplier relative to the residual norm [-].
_NOISE = 10
# Text on nodes that penetrate without force, with the largest depth [m], and the cause.
_INSIDE = "are inside the other surface without contact force, up to {:.3g} m deep,"
_FARTHER = "they moved farther than the search expected"
# Slip relative to the longest segment [-] below which round-off determines its direction.
_SLIPS = 1e-6


def missed_contact(
    steps: Sequence[ContactStep],
    states: Sequence[PairState | JointState],
    ends: tuple[Floats, Floats],
    displacement: float,
    repeat: Callable[[PairState | JointState], ContactStep],
) -> str:
    """Message naming nodes that penetrate beyond the searched range, or "". Collective.

    As long as the largest displacement increment is within the search radius, no candidate is
    missing, and only the eligibility of nodes is checked with the computed motion.

    Args:
        steps: The solved step of each state that has contact in it.
        states: States of all pairs.
        ends: Positions of the local nodes of the space at both ends of the step, ``(l, 3)`` [m].
        displacement: Largest displacement increment of any node, the same on all ranks [m].
        repeat: Creates the `ContactStep` of a state with the end of the step as trial state.
    """
    solved = {step.state: step for step in steps}
    messages = []
    for state in states:
        step = solved.get(state)
        known = None if step is None else eligible_or_excluded(step.normal)
        is_seen = _is_exhaustive(state, step, ends, displacement)
        if step is not None and is_seen:
            passing = _passage(step, ~eligible_or_excluded(step.normal)).points
            is_seen = not reductions.anywhere(state.nodes.V.mesh.comm, len(passing) > 0)
        if not is_seen:
            repeated = repeat(state)
            messages.append(_missed_nodes(repeated, known, ends[1]))
            if step is None:
                messages.append(_passing_message(repeated))
        elif step is not None:
            messages.append(_message(step, *_late_nodes(step), ends[1]))
    return next(filter(None, messages), "")


def _late_nodes(step: ContactStep) -> tuple[Ints, Floats]:
    """Nodes that are eligible by the computed motion, but not by the trial motion. Local.

    Returns:
        Indices among the nodes of the surface, and the gaps at the end of the step [m].
    """
    search, normal, x = step.search, step.normal, step.x
    gap_n, gap_trial = search.approach.gap_n, search.approach.gap
    if not len(search.candidates.segments):
        return np.empty(0, dtype=np.int32), np.empty(0)
    # The distance between computed and trial motion bounds the change of the gaps.
    off = x - search.approach.x
    vertices = _kernels.largest_size(off.take(search.candidates.segments.ravel(), axis=0))
    own = np.linalg.norm(off.take(step.state.nodes.nodes, axis=0), axis=1)
    own = own if search.pairing.follows else own.max(initial=0.0)
    node = indices(~eligible_or_excluded(normal) & ~(gap_n + gap_trial > own + vertices))
    if not len(node):
        return node, np.empty(0)
    if search.pairing.follows:
        node = node[search.candidates.near(search.points.take(node), x, search.reach)]
        points = search.points.take(node)
        segment, gap = search.candidates.pair(points, x, search.segment[node], search.reach)
        inside = indices(gap < 0)
        node, segment, gap = node[inside], segment[inside], gap[inside]
        before = search.candidates.gap(search.points.take(node), search.x_n, segment)
    else:
        node = node[search.segment[node] >= 0]
        segment = search.segment[node]
        gap, before = search.pairing.gaps(x, node, segment), gap_n[node]
    size = step.state.segment_sizes[node]
    late = gap < np.fmin(before, 0.0) - LATE * size
    late &= normal.may_activate(node, before, gap)
    # An elastic impact penetrates by up to half of the approach, where the mean gap is zero.
    is_deep = (before + gap)[late] < -2 * _DEEP * size[late]
    node, gap = node[late], gap[late]
    if not len(node):
        return node, gap
    # Otherwise trial and computed motion are similar, and the law has excluded the node.
    own, facing = step.state.nodes.nodes[node], search.candidates.segments[segment[late]]
    number = max(facing.shape[1], 1)  # obstacles have no vertices, and rest in the frame
    trial, made = (
        np.linalg.norm(u[own] - u[facing].sum(axis=1) / number, axis=1)
        for u in (search.approach.x - search.x_n, x - search.x_n)
    )
    from_rest = trial < _STILL * made
    return node[from_rest | is_deep], gap[from_rest | is_deep]


def _is_exhaustive(
    state: PairState | JointState,
    step: ContactStep | None,
    ends: tuple[Floats, Floats],
    displacement: float,
) -> bool:
    """Whether the search covers all segments within the computed motion. Collective."""
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
    """Describe penetrating nodes that the repeated search makes eligible, or "". Collective.

    Args:
        step: Contact with the end of the step as trial state.
        known: Whether each node was eligible or excluded in the solved step, shape ``(n,)``; None
            if there was no contact in it.
        x: Positions of the local nodes of the space at the end of the step, ``(l, 3)`` [m].
    """
    approach, node = step.search.approach, step.normal.nodes
    inside = approach.gap < np.fmin(approach.gap_n, 0.0) - TOUCHES * step.state.segment_sizes
    if (tolerance := vertex_tolerance(step.state)) is not None:
        node = indices(eligible_or_excluded(step.normal))
        inside &= approach.gap < -np.fmin(tolerance, _kernels.HYSTERESIS * step.state.segment_sizes)
    node = node[inside[node] if known is None else (inside & ~known)[node]]
    return _message(step, node, approach.gap[node], x)


def _passing_message(step: ContactStep) -> str:
    """Message naming nodes of a skipped pair that pass through a surface, or "". Collective.

    The step is solved again with this pair, whose solution is checked like the solution of any
    pair. ``step`` is its contact with the end of the step as trial state.
    """
    if vertex_tolerance(step.state) is not None:
        return ""
    search, nodes = step.search, step.state.nodes
    passage = Passage.through(
        *(search.candidates, search.points, (search.x_n, search.approach.x)),
        *(search.start, search.reach),
    )
    ids = nodes.node_ids[passage.points]
    return passing_message(nodes.V.mesh.comm, "nodes", ids, _FARTHER)


def _message(step: ContactStep, node: Ints, gap: Floats, x: Floats) -> str:
    """Message naming penetrating nodes without force, and the deepest one, or "". Collective.

    Args:
        step: Contact of their surface.
        node: Indices among the nodes of the surface, shape ``(m,)``.
        gap: Their gaps, shape ``(m,)`` [m].
        x: Positions of the local nodes of the space, shape ``(l, 3)`` [m].
    """
    message = _wrong_nodes(step, _INSIDE, node, -gap, x[step.state.nodes.nodes[node]])
    return message and f"{message}; {_FARTHER}"


def check_penetration(step: ContactStep, dt: float) -> str:
    """Message on nodes in a wrong state at the end of a step, or "". Collective.

    Call it after the last evaluation of the step.

    Args:
        step: The solved step.
        dt: Its length [s].
    """
    counts = [0, 0, step.search.pairing.num_beyond(step.x, indices(step.normal.active))]
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
    if not step.search.pairing.follows:
        node, _, gap = step.search.unheld(step.x, step.normal.nodes, step.normal.active)
        there = step.x[step.state.nodes.nodes[node]]
        if message := _wrong_nodes(step, _INSIDE, node, -gap, there):
            return message
    if vertex_tolerance(step.state) is not None:
        return ""  # vertices of segments are followed by `ReversePassages`
    return passing_nodes_message(step.state.nodes, _passage(step, ~step.normal.active), dt)


def passing_without_contact(step: ContactStep, dt: float) -> str:
    """Message naming nodes that pass on the trial motion, and a shorter step, or "". Collective.

    It explains a failed step: from such a depth a node may not return to the surface.

    Args:
        step: A step without a solution.
        dt: Its length [s].
    """
    search = step.search
    ends, passing = (search.x_n, search.approach.x), search.passing
    passage = Passage.through(
        search.candidates, search.points, ends, search.start, search.reach, passing
    )
    message = passing_nodes_message(step.state.nodes, passage, dt)
    return f"without contact {message}" if message else ""


def check_boundaries(
    watch: OverlapWatch,
    steps: Sequence[ContactStep],
    ends: tuple[Floats, Floats],
    times: tuple[float, float],
    displacement: float,
) -> str:
    """Message naming bodies that overlap without contact force after a step, or "". Collective.

    It checks whole boundaries, including edges that cross between nodes, on the path of the step.
    It returns at once while steps are shorter than the last overlap check allows.

    Args:
        watch: Overlap checks of the run.
        steps: The solved contact.
        ends: Positions of the local nodes of the space at both ends of the step, ``(l, 3)`` [m].
        times: Times at both ends [s].
        displacement: Largest displacement increment of any node, the same on all ranks [m].
    """
    overlap = watch.overlap_on_path(ends, times, displacement)
    if overlap is None:
        return ""
    pressing = {
        member
        for step in steps
        for member, (start, end) in zip(members(step.state), pairwise(step.state.ends), strict=True)
        if reductions.anywhere(member.nodes.V.mesh.comm, bool(step.normal.active[start:end].any()))
    }
    if watch.is_pressed(overlap, pressing):
        return ""
    inner, outer = overlap.names
    return (
        f"{inner} goes up to {overlap.depth:.3g} m into {outer} within the step, with the centres "
        f"of {overlap.cells} cells, and no contact force acts between the two"
    )


def _passage(step: ContactStep, free: Flags) -> Passage:
    """Nodes flagged by `free`, ``(n,)``, that pass through their candidates. Local."""
    search = step.search
    ends, start = (search.x_n, step.x), search.start
    return Passage.through(search.candidates, search.points, ends, start, search.reach, free)


def _without_segment(step: ContactStep) -> int:
    """Number of penetrating nodes that transmit force and have no segment at the end.

    Nodes that keep their segment after too many changes are included: they would have no segment in
    the next step, however short it is.
    """
    old, search, candidates = step.state.history, step.search, step.search.candidates
    before, now = search.last, search.segment
    deep = old.active & (before >= 0)
    deep[deep] = old.gap[deep] < -lost_depth(candidates, before[deep])
    pressing = step.normal.active.copy()
    pressing[pressing] = search.gap[pressing] < -lost_depth(candidates, now[pressing])
    node = indices(deep | pressing)
    if not len(node):
        return 0
    points = search.points.take(node)
    after, _ = candidates.pair(points, step.x, now[node], search.reach)
    last = np.where(now >= 0, now, before)[node]
    outside = _outside_candidate(step, points, last)
    return int(np.count_nonzero((after < 0) & ~outside))


def _outside_candidate(step: ContactStep, points: ContactPoints, segment: Ints) -> Flags:
    """Flags of points that have left their segments over a free edge of the surface."""
    candidates = step.search.candidates
    depth = -candidates.gap(points, step.x, segment)
    flags: Flags = depth < too_deep(candidates, segment)
    return flags & candidates.is_at_rim(points, step.x, segment)


def _between_segments(step: ContactStep) -> int:
    """Number of active nodes that are much deeper below an adjacent segment than below their own.

    At a concave edge the projection of a node may be outside both segments.
    """
    node = indices(step.normal.active)
    if not len(node):
        return 0
    search, size = step.search, step.search.candidates.size
    now, gap = search.segment[node], search.gap[node]
    points = search.points.take(node)
    after, gap_after = search.candidates.pair(points, step.x, now, search.reach)
    deeper = (gap_after < -_DEEP * size[now]) & (gap_after < gap - _DEEPER * size[now])
    return int(np.count_nonzero(deeper & (after != now)))


def check_forces(step: ContactStep, last: ContactContribution, residual: float) -> str:
    """Message naming nodes whose force violates the contact laws after a step, or "". Collective.

    Multipliers are compressive. Their gap is the reference gap, or the gap at t_n with elastic
    impact. Springs act only if they are compressed at one end of the step. Friction is within the
    cone, and parallel to the slip where a node slides.

    Args:
        step: The solved step.
        last: Its last evaluation.
        residual: Norm of the residual of the solution, the accuracy of forces [N].
    """
    pairs, state, normal = last.pairs, step.state, step.normal
    loaded = indices(last.active & (normal.lambda_N[pairs.node] != 0))
    node = pairs.node[loaded]
    size, pressure = state.segment_sizes[node], -normal.lambda_N[node]
    floor = _CONE * pressure.max(initial=0.0) + _NOISE * residual
    law, friction = state.pair.enforcement, state.pair.friction
    # Scale of each error, and threshold.
    errors: list[tuple[str, Floats, Floats | float]] = []
    if not isinstance(law, Tied):
        gap_n, gap = pairs.contact.gap_n[loaded], pairs.contact.gap[loaded]
        opening = np.minimum(gap_n, gap) if isinstance(law, Penalty) else gap
        opening = opening - normal.largest_gaps(pairs)[loaded]
        errors.append(("press across an open gap, by {:.3g} m", opening, _OPEN * size))
        errors.append(("are pulled, by {:.3g} N", -pressure, floor))
    if friction is not None and friction.law == "objective" and not state.pair.has_slip_spring:
        t, slip = step.friction.traction[node], pairs.slip.value[loaded]
        length, slid = np.linalg.norm(t, axis=1), np.linalg.norm(slip, axis=1)
        slips = slid > _SLIPS * size
        # The limit may decrease with the slip: nodes with a slip of round-off size have the static
        # limit.
        limit = step.friction.largest(node, pressure, np.where(slips, slid, 0.0))
        excess = length - limit
        errors.append(("exceed the limit of friction, by {:.3g} N", excess, _CONE * limit + floor))
        moves = step.friction.sliding[node] & slips & (length > floor)
        turned = np.arctan2(t[:, 0] * slip[:, 1] - t[:, 1] * slip[:, 0], (t * slip).sum(axis=1))
        turned = np.where(moves, np.abs(turned), 0.0)
        errors.append(("slide {:.3g} rad away from their traction", turned, _PARALLEL))
    are_wrong = [value > most for _, value, most in errors]
    if not reductions.anywhere(state.nodes.V.mesh.comm, any(map(np.any, are_wrong))):
        return ""
    for (text, value, _), flags in zip(errors, are_wrong, strict=True):
        wrong = indices(flags)
        columns = node[wrong], value[wrong], step.x[state.nodes.nodes[node[wrong]]]
        if message := _wrong_nodes(step, text, *columns):
            return message
    return ""


def _wrong_nodes(step: ContactStep, text: str, node: Ints, value: Floats, x: Floats) -> str:
    """Message naming nodes, their errors, and the position of the worst one, or "". Collective."""
    nodes = step.state.nodes
    if not reductions.anywhere(nodes.V.mesh.comm, len(node) > 0):
        return ""
    pair = np.searchsorted(step.state.ends, node, side="right") - 1
    rows = joined(nodes.V.mesh.comm, np.column_stack((pair, nodes.node_ids[node], value, x)))
    number, _, most, *place = rows[rows[:, 2].argmax()]
    point = ", ".join(f"{value:.4g}" for value in place)
    ids = np.unique(rows[:, 1].astype(np.int64))
    return (
        f"{len(ids)} nodes between {members(step.state)[int(number)].pair.between} "
        f"{text.format(most)} at ({point}): {listed(ids)}"
    )
