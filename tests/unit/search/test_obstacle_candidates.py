"""Candidates of an obstacle: local results without communication."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.model.obstacles.facing import Facing
from dolfinx_nts.search.obstacle_candidates import ObstacleCandidates, ObstacleSearch
from dolfinx_nts.search.points import NodalPoints
from helpers import scenes

pytestmark = pytest.mark.at_most_two_ranks

OBSTACLES = {
    "sphere": nts.RigidSphere((0.5, 0.5, -1.0), 1.1),
    "facets": nts.RigidSurface(
        [[-9, -9, 0], [9, -9, 0], [-9, 9, 0], [9, 9, 0]], [[0, 1, 2], [3, 2, 1]], (0, 0, 9)
    ),
}
obstacles = pytest.mark.parametrize("name", OBSTACLES)


@pytest.fixture
def nodes(comm):
    """Surface that meets the obstacles."""
    return scenes.blocks(comm).stepper.pairs[0].nodes


@obstacles
def test_pairs_are_nodes_within_reach_of_the_obstacle(name, nodes):
    candidates = ObstacleCandidates(OBSTACLES[name], nodes)
    x = nodes.V.tabulate_dof_coordinates()
    none = np.full(len(nodes.nodes), -1, dtype=np.int32)
    facet, gap = candidates.pair(NodalPoints(nodes.nodes), x, none, 0.5)
    found, exact = OBSTACLES[name].find(
        x[nodes.nodes], none, 0.01, 0.5, Facing.everywhere(len(none))
    )
    np.testing.assert_array_equal(facet, found)
    np.testing.assert_array_equal(gap, np.where(found >= 0, exact, np.nan))
    met = np.flatnonzero(found >= 0)
    np.testing.assert_array_equal(candidates.find(candidates.key[found[met]]), found[met])
    points = NodalPoints(nodes.nodes[met])
    np.testing.assert_allclose(candidates.gap(points, x, found[met]), exact[met], atol=1e-14)
    dofs = points.dofs(candidates.segments.take(found[met], axis=0))
    np.testing.assert_array_equal(dofs, nodes.nodes[met][:, None])
    assert candidates.contact("static", points, x, x, found[met]).gradient.shape == (len(met), 3)


@obstacles
@pytest.mark.parametrize("reach", [0.05, 0.5, 5.0])
def test_nodes_that_may_get_inside_are_near(name, nodes, reach, comm):
    candidates = ObstacleCandidates(OBSTACLES[name], nodes)
    x = nodes.V.tabulate_dof_coordinates()
    none = np.full(len(nodes.nodes), -1, dtype=np.int32)
    gap = candidates.pair(NodalPoints(nodes.nodes), x, none, np.inf)[1]
    near = candidates.near(NodalPoints(nodes.nodes), x, reach)
    assert np.all(np.isin(np.flatnonzero(gap <= reach), near))
    # Boxes of facets are wider than the facets, but flat ones of flat facets.
    assert name != "facets" or np.all(gap[near] <= reach)
    counts = comm.allreduce(np.array([len(near), len(nodes.nodes)]))
    assert (counts[0] == counts[1]) == (reach > 1)


@obstacles
def test_approach_is_the_longest_displacement_of_a_node(name, nodes, comm):
    search = ObstacleSearch(OBSTACLES[name], nodes)
    x = nodes.V.tabulate_dof_coordinates()
    before = search.positions(x)
    assert search.approach(x, before) == 0.0
    travel = np.array([0.1, -0.2, 0.2])
    moved = x + travel
    moved[nodes.nodes[: len(nodes.nodes) // 2]] += travel
    farthest = 0.6 if len(nodes.nodes) > 1 else 0.3
    assert search.approach(moved, before) == pytest.approx(comm.allreduce(farthest, op=MPI.MAX))


@obstacles
def test_obstacle_search_sends_no_messages(name, nodes):
    search = ObstacleSearch(OBSTACLES[name], nodes)
    candidates, x = search.candidates, nodes.V.tabulate_dof_coordinates()
    assert search.update(x, 0.1) == (candidates, False)
    owned = x[: nodes.V.dofmap.index_map.size_local]
    assert np.shares_memory(candidates.scatter.forward(x), owned)
    np.testing.assert_array_equal(candidates.scatter.forward(x), owned)
    assert candidates.scatter.reverse(owned) is owned
