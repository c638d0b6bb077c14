"""Choice of the nodes that may have multipliers where a surface touches itself."""

from types import SimpleNamespace

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.self_contact import SelfContactSearch
from helpers.scenes import part


def flattened(comm, cell):
    """A ring's inner surface and its candidates once it is pressed flat."""
    shape = {"inner_radius": 0.9, "outer_radius": 1.0, "width": 0.3, "cells": (24, 1, 2)}
    V, _, facets, tag = part(comm, "ring", cell, centre=(0, 0, 0), **shape)
    surface = nts.Surface(V, facets, tag["ring_inner"])
    x = V.tabulate_dof_coordinates() * [1, 0.02, 1]
    candidates, _ = SelfContactSearch(surface, surface).update(x, 0.2)
    x = candidates.scatter.forward(x)
    none = np.full(len(surface.nodes), -1, dtype=np.int32)
    return surface, candidates, candidates.pair(NodalPoints(surface.nodes), x, none, 0.2)[0]


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_chosen_nodes_are_a_maximal_independent_set(comm, cell):
    surface, candidates, segment = flattened(comm, cell)
    eligible = segment >= 0
    urgency = surface.node_ids % 3
    taken = candidates.independent(surface, segment, eligible, urgency)
    assert comm.allreduce(int(np.count_nonzero(taken & ~eligible))) == 0
    node = np.flatnonzero(eligible)
    dofs = NodalPoints(surface.nodes[node]).dofs(candidates.segments[segment[node]])
    dofs = candidates.scatter.global_nodes(dofs)
    rows = zip(taken[node], urgency[node], surface.node_ids[node], dofs, strict=True)
    everywhere = [row for part in comm.allgather(list(rows)) for row in part]
    assert len(everywhere) > 20

    def clash(a, b):
        return a[3][0] in b[3][1:] or b[3][0] in a[3][1:]

    for row in everywhere:
        before = [
            other for other in everywhere if other[0] and clash(row, other) and other is not row
        ]
        if row[0]:
            assert not before
        else:
            # A chosen node of at least the same urgency excludes it.
            assert any(other[1] >= row[1] for other in before)


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_one_of_two_flat_walls_has_all_multipliers(comm, cell):
    """Where it would be the other wall's turn, no node could be held."""
    surface, candidates, segment = flattened(comm, cell)
    X = surface.V.tabulate_dof_coordinates()[surface.nodes]
    eligible = (segment >= 0) & (np.abs(X[:, 0]) < 0.7)
    urgency = np.zeros(len(segment), dtype=np.int64)
    shuffled = SimpleNamespace(
        V=surface.V, nodes=surface.nodes, node_ids=surface.node_ids * 7919 % 104729
    )
    taken = candidates.independent(shuffled, segment, eligible, urgency)
    walls = comm.allreduce(np.array([np.sum(taken & (s * X[:, 1] > 0)) for s in (1, -1)]))
    all_nodes = comm.allreduce(int(np.sum(eligible)))
    assert all_nodes > 40
    assert sorted(walls) == [0, all_nodes // 2]


def test_without_candidates_no_node_is_chosen(comm):
    surface, candidates, segment = flattened(comm, "hexahedron")
    none = np.zeros(len(segment), dtype=bool)
    assert not candidates.independent(surface, segment, none, np.zeros(len(segment))).any()
