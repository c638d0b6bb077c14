"""Values of nodes that go from owners to ghosts and back."""

import numpy as np
import pytest

from dolfinx_nts.search.global_search import GlobalSearch
from helpers import scenes

ROUNDING = 1e2 * np.finfo(float).eps


@pytest.fixture
def scatter(comm):
    """One that reaches everywhere."""
    scene = scenes.blocks(comm)
    pair = scene.stepper.pairs[0]
    candidates, _ = GlobalSearch(pair.nodes, pair.segments).update(scene.stepper.x, np.inf)
    return candidates.scatter


def numbers(scatter):
    """Global numbers of all nodes of a rank, owned ones first."""
    return scatter.global_nodes(np.arange(scatter.num_local, dtype=np.int32))


@pytest.mark.parametrize("d", [2, 3])
def test_ghosts_get_the_values_of_their_owners(scatter, agree, d):
    number = numbers(scatter)
    n = scatter.index_map.size_local
    for factor in (1.0, 2.0):  # no value of the first vector remains
        values = factor * np.column_stack([number, number**2, -number])[:, :d]
        assert agree(np.array_equal(scatter.at_ghosts(values[:n]), values[n:]))
    assert agree(d < 3 or np.array_equal(scatter.forward(values[:n]), values))


@pytest.mark.parametrize("d", [2, 3])
def test_owners_get_contributions_of_all_ranks(comm, scatter, agree, d):
    number, n = numbers(scatter), scatter.index_map.size_local
    for seed in (0, 1):
        here = np.random.default_rng([seed, comm.rank]).normal(size=(scatter.num_local, d))
        everywhere = np.zeros((scatter.index_map.size_global, d))
        for their_number, theirs in comm.allgather((number, here)):
            everywhere[their_number] += theirs
        total = here[:n].copy()
        scatter.add_of_ghosts(total, here[n:])
        assert agree(np.allclose(total, everywhere[number[:n]], rtol=0, atol=ROUNDING))
    assert agree(d < 3 or np.array_equal(scatter.reverse(here), total))


def test_values_of_nodes_are_added_wherever_they_are(comm, scatter, agree):
    rng = np.random.default_rng(comm.rank)
    nodes = rng.integers(scatter.num_local, size=(50, 4)).astype(np.int32)
    values, total = rng.normal(size=(50, 4, 3)), rng.normal(size=(scatter.index_map.size_local, 3))
    whole = scatter.no_values(3)
    whole = np.concatenate([total, whole])
    np.add.at(whole, nodes, values)
    scatter.add(total, nodes, values)
    assert agree(np.allclose(total, scatter.reverse(whole), rtol=0, atol=ROUNDING))
