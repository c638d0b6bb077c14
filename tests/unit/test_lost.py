"""Nodes that sink into a pit of a surface, from segment to segment."""

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_nts import compat
from dolfinx_nts.lost import lost_nodes
from dolfinx_nts.search import Neighbourhood

# Two unit squares, the second rises by this from the common edge at x = 1.
SLOPE, DIAMETER = 0.5, np.sqrt(2.25)


def step_of(before, after, *, active=True):
    """A step that moves the node from and to a position (x, z) at y = 0.5, held by segment 0."""
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    steep = np.array([[2.0, 0, SLOPE], [2, 1, SLOPE]])
    none = np.empty(0, dtype=np.int64)
    index_map = compat.index_map(MPI.COMM_SELF, 7, none, none.astype(np.int32))
    here = Neighbourhood(
        index_map,
        np.array([[1, 2, 3, 4], [2, 5, 4, 6]], dtype=np.int32),
        np.ones(2),
        np.array([10, 20], dtype=np.int64),
        np.array([np.sqrt(2), DIAMETER]),
        np.ones(2),
    )
    x_n, x = (np.vstack(([[at[0], 0.5, at[1]]], flat, steep)) for at in (before, after))
    history = SimpleNamespace(key=np.array([10]), active=np.array([active]), gap=x_n[:1, 2])
    pair = SimpleNamespace(history=history, nodes=SimpleNamespace(nodes=np.zeros(1, np.int32)))
    segment = np.zeros(1, dtype=np.int32)
    return SimpleNamespace(
        neighbourhood=here,
        pair=pair,
        comm=MPI.COMM_SELF,
        x_n=x_n,
        x=x,
        segment=segment,
        segment_n=segment,
        active=np.array([active]),
        reach=2.0,
    )


@pytest.mark.parametrize(
    ("depth", "way", "active", "sinks"),
    [
        (0.2, 0.3, True, True),  # below the steep one, deeper
        (0.2, 0.3, False, False),  # nothing presses
        (0.05, 0.1, True, False),  # a gap with which nodes may come
        (0.2, -0.1, True, False),  # stays with its segment
        (0.2, 0.04, True, False),  # not half-way round the edge
    ],
)
def test_node_that_goes_on_to_a_segment_above_it_sinks(depth, way, active, sinks):
    # Along the first segment, as deep as it was.
    step = step_of((0.9, -depth), (1 + way, -depth), active=active)
    below = way * np.sin(np.arctan(SLOPE)) + depth * np.cos(np.arctan(SLOPE))
    assert (below > depth) == (way > depth * np.tan(np.arctan(SLOPE) / 2))
    assert lost_nodes(step) == ("nodes that sank into a surface: 1" if sinks else "")


def test_node_that_has_no_segment_any_more_has_sunk():
    step = step_of((0.5, -0.2), (0.5, -0.9))
    assert lost_nodes(step) == "nodes that sank into a surface: 1"
