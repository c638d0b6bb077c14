"""A step fails if nodes sink into a surface, or if forces contradict their laws."""

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_nts import compat
from dolfinx_nts.contact.enforcement import LagrangeMultiplier, Penalty, Tied
from dolfinx_nts.contact.friction.laws import Coulomb
from dolfinx_nts.contact.implicit.solution_checks import check_forces, check_penetration
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.scatter import NodalScatter
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates

pytestmark = pytest.mark.serial

# Two squares over 0 < y < 1: the second rises by 2 from their common edge at x = 1.
FLAT = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
STEEP = [[2.0, 0, 2], [2, 1, 2]]
SEGMENTS = {
    "quadrilateral": [[1, 2, 3, 4], [2, 5, 4, 6]],
    "triangle": [[1, 2, 3], [4, 2, 3], [2, 5, 4], [6, 5, 4]],
}
NO_SEGMENT = "nodes that sank into a surface and face no segment any more: 1"


def step_of(facets, before, after, held):
    """A step that moves a node in the plane y = 0.4; ``held``: active at t_n, active at the end."""
    segments = np.array(SEGMENTS[facets], dtype=np.int32)
    orientation = np.resize([1.0, -1.0] if facets == "triangle" else [1.0], len(segments))
    none = np.empty(0, dtype=np.int64)
    index_map = compat.index_map(MPI.COMM_SELF, 7, none, none.astype(np.int32))
    size = np.full(len(segments), np.sqrt(2))
    found = FoundSegments(
        scatter=NodalScatter(index_map),
        vertices=segments,
        orientation=orientation,
        key=np.arange(len(segments)),
        size=size,
        thickness=size,
    )
    candidates = SegmentCandidates(found)
    x_n, x = (np.array([[at[0], 0.4, at[1]], *FLAT, *STEEP]) for at in (before, after))
    points = NodalPoints(np.zeros(1, dtype=np.int32))
    none_yet = np.full(1, -1, dtype=np.int32)
    segment_n, gap_n = candidates.pair(points, x_n, none_yet, 2.0)
    segment, gap = candidates.pair(points, x, segment_n, 2.0)
    if held[1] and segment[0] < 0:
        # As for a node that has changed its segment repeatedly.
        segment, gap = segment_n, candidates.gap(points, x, segment_n)
    history = SimpleNamespace(active=np.array(held[:1]), gap=gap_n)
    search = SimpleNamespace(
        candidates=candidates,
        points=points,
        x_n=x_n,
        reach=2.0,
        last=segment_n,
        start=(segment_n, gap_n),
        segment=segment,
        gap=gap,
        pairing=SimpleNamespace(follows=True, num_beyond=lambda x, node: 0),
    )
    mesh, pair = SimpleNamespace(comm=MPI.COMM_SELF), SimpleNamespace(enforcement=None)
    surface = SimpleNamespace(V=SimpleNamespace(mesh=mesh), node_ids=np.array([7]))
    return SimpleNamespace(
        candidates=candidates,
        state=SimpleNamespace(history=history, nodes=surface, pair=pair),
        search=search,
        normal=SimpleNamespace(active=np.array(held[1:])),
        x=x,
    )


@pytest.mark.parametrize("facets", SEGMENTS)
@pytest.mark.parametrize(
    ("before", "after", "held", "message"),
    [
        ((0.4, -0.3), (0.4, -0.9), (True, False), NO_SEGMENT),  # half a segment deep
        ((0.4, -0.3), (0.4, -0.5), (True, True), ""),
        ((0.9, -0.3), (1.3, -0.3), (True, False), NO_SEGMENT),  # below the edge of a pit
        ((0.9, -0.3), (1.3, -0.3), (False, True), NO_SEGMENT),
        (
            (0.9, -0.3),
            (1.3, -0.3),
            (False, False),
            "",
        ),  # without force at an admissible depth at the rim
        ((0.9, -0.1), (1.3, -0.1), (True, False), ""),  # a depth with which nodes may come
        ((0.1, -0.3), (-0.3, -0.3), (True, False), ""),  # over the rim
        ((0.1, -0.3), (-0.3, -0.3), (False, True), ""),
        ((0.1, -0.3), (-0.3, -0.9), (True, False), NO_SEGMENT),  # too deep next to it
    ],
)
def test_penetrating_nodes_are_distinguished_from_nodes_next_to_the_surface(
    facets, before, after, held, message
):
    assert check_penetration(step_of(facets, before, after, held), dt=0.1) == message


def test_node_that_goes_through_a_surface_is_found():
    step = step_of("quadrilateral", (0.4, 0.2), (0.4, -0.9), (False, False))
    # Half of what can be caught, half a segment, after the 0.2 to the surface.
    possible = 0.1 * (0.2 + np.sqrt(2) / 4) / 1.1
    assert check_penetration(step, dt=0.1) == (
        "1 nodes pass through a surface that they face: 7; "
        f"a dt of {possible:.2g} would let contact catch them"
    )


@pytest.mark.parametrize(("facets", "flat"), [("quadrilateral", 0), ("triangle", 1)])
@pytest.mark.parametrize(
    ("after", "held", "message"),
    [
        ((1.2, 0.05), True, "nodes that sank into a surface between two segments: 1"),
        ((1.1, 0.05), True, ""),  # an admissible depth without force
        ((1.2, 0.05), False, ""),  # nothing presses
    ],
)
def test_node_must_not_sink_between_two_segments(facets, flat, after, held, message):
    # At the end it is on the extension of the flat segment; the next step finds the steep one.
    step = step_of(facets, (0.9, 0.1), after, (True, held))
    step.search.segment[:], step.search.gap[:] = flat, after[1]
    assert check_penetration(step, dt=0.1) == message
    step.search.gap[:] = -0.1  # hardly deeper than now
    assert check_penetration(step, dt=0.1) == ""


def loaded(enforcement=None, **fault):
    """A node in sliding contact with its last evaluation, correct unless a fault is injected."""
    at = {"held": 0.0, "gap_n": 0.0, "gap": 0.0, "force": -2.0, "t": (0.6, 0.0), "slip": (0.1, 0.0)}
    at |= fault
    surface = SimpleNamespace(
        V=SimpleNamespace(mesh=SimpleNamespace(comm=MPI.COMM_SELF)),
        nodes=np.array([1]),
        node_ids=np.array([7]),
    )
    pair = SimpleNamespace(
        enforcement=enforcement or LagrangeMultiplier(),
        friction=None if isinstance(enforcement, Tied) else Coulomb(0.3),
        has_slip_spring=False,
        between="cube and plate",
    )
    state = SimpleNamespace(pair=pair, nodes=surface, segment_sizes=np.ones(1), ends=[0, 1])
    normal = SimpleNamespace(
        lambda_N=np.array([at["force"]]),
        largest_gaps=lambda pairs: np.full(len(pairs.node), at["held"]),
    )
    friction = SimpleNamespace(
        traction=np.array([at["t"]]),
        sliding=np.ones(1, dtype=bool),
        largest=lambda node, p, slip: 0.3 * p,
    )
    x = np.array([[9.0, 9, 9], [1, 2, 3]])
    contact = SimpleNamespace(gap_n=np.array([at["gap_n"]]), gap=np.array([at["gap"]]))
    slip = SimpleNamespace(value=np.array([at["slip"]]))
    pairs = SimpleNamespace(node=np.zeros(1, dtype=np.int32), contact=contact, slip=slip)
    step = SimpleNamespace(state=state, normal=normal, friction=friction, x=x)
    return step, SimpleNamespace(active=np.ones(1, dtype=bool), pairs=pairs)


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ({}, ""),
        ({"gap_n": 0.2, "gap": 0.2, "held": 0.2}, ""),  # elastic impact holds the gap
        ({"gap_n": 0.2, "gap": 0.2}, "press across an open gap, by 0.2 m"),
        ({"enforcement": Penalty(1.0), "gap_n": -0.1, "gap": 0.2}, ""),
        ({"enforcement": Penalty(1.0), "gap_n": 0.3, "gap": 0.2}, "open gap, by 0.2 m"),
        ({"force": 2.0, "t": (0.0, 0.0)}, "are pulled, by 2 N"),
        ({"enforcement": Tied(), "force": 2.0, "gap": 0.2, "t": (0.0, 0.0)}, ""),
        ({"t": (0.9, 0.0)}, "exceed the limit of friction, by 0.3 N"),
        ({"t": (0.0, 0.6)}, "slide 1.57 rad away from their traction"),
        ({"t": (-0.6, 0.0)}, "slide 3.14 rad away from their traction"),
        ({"t": (-0.6, 0.0), "slip": (1e-9, 0.0)}, ""),  # no slip that has a direction
    ],
)
def test_forces_that_contradict_their_law_are_named_with_the_place(fault, text):
    message = check_forces(*loaded(**fault), residual=1e-9)
    if text:
        assert message.startswith("1 nodes between cube and plate ")
        assert message.endswith(" at (1, 2, 3): 7")
    assert text in message
    assert bool(message) == bool(text)
