"""A step fails if a node sinks into a surface, but not if it is beside the surface."""

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_nts import compat
from dolfinx_nts.contact.implicit.certificate import check_penetration
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
    """A step that moves a node from (x, z) to another at y = 0.4; ``held``: at t_n, at the end."""
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
        # As of a node that has changed its segment again and again.
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
        ((0.9, -0.3), (1.3, -0.3), (False, False), ""),  # nothing presses
        ((0.9, -0.1), (1.3, -0.1), (True, False), ""),  # a depth with which nodes may come
        ((0.1, -0.3), (-0.3, -0.3), (True, False), ""),  # over the rim
        ((0.1, -0.3), (-0.3, -0.3), (False, True), ""),
        ((0.1, -0.3), (-0.3, -0.9), (True, False), NO_SEGMENT),  # too deep beside it
    ],
)
def test_nodes_that_sink_in_are_told_from_nodes_beside_the_surface(
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
        ((1.1, 0.05), True, ""),  # a depth with which nodes may come
        ((1.2, 0.05), False, ""),  # nothing presses
    ],
)
def test_node_must_not_sink_between_two_segments(facets, flat, after, held, message):
    # On the flat one, continued, at the end; the next step finds it below the steep one.
    step = step_of(facets, (0.9, 0.1), after, (True, held))
    step.search.segment[:], step.search.gap[:] = flat, after[1]
    assert check_penetration(step, dt=0.1) == message
    step.search.gap[:] = -0.1  # not much deeper than now
    assert check_penetration(step, dt=0.1) == ""
