"""Parts of nodal vectors, against the exchange of all values."""

import numpy as np
import pytest

from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.solvers.partial_scatter import PartialScatter
from helpers import scenes

ROUNDING = 1e2 * np.finfo(float).eps


@pytest.fixture
def scatter(comm):
    """One that reaches everywhere."""
    scene = scenes.blocks(comm)
    pair = scene.stepper.pairs[0]
    candidates, _ = GlobalSearch(pair.nodes, pair.segments).update(scene.stepper.x, np.inf)
    return candidates.scatter


def some_nodes(scatter, comm, share):
    """A share of the nodes that a rank knows; none on the last of several."""
    rng = np.random.default_rng(comm.rank)
    chosen = np.flatnonzero(rng.random(scatter.num_local) < share).astype(np.int32)
    return chosen[:0] if comm.rank == comm.size - 1 > 0 else chosen


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_values_are_those_of_the_owners(comm, scatter, agree, share):
    nodes = some_nodes(scatter, comm, share)
    partial = PartialScatter(scatter, nodes)
    for number in range(2):  # nothing of the first vector stays
        rng = np.random.default_rng([number, comm.rank])
        x = rng.normal(size=(scatter.index_map.size_local, 3))
        assert agree(np.array_equal(partial.take(x), scatter.forward(x)[nodes]))


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_what_ghosts_have_is_added_at_their_owners(comm, scatter, agree, share):
    n = scatter.index_map.size_local
    nodes = some_nodes(scatter, comm, share)
    partial = PartialScatter(scatter, nodes)
    for number in range(2):
        rng = np.random.default_rng([number, comm.rank])
        y = rng.normal(size=(n, 3))
        whole = np.concatenate([y, np.zeros((scatter.index_map.num_ghosts, 3))])
        part = partial.owned(y)
        assert agree(np.array_equal(part, whole[nodes]))
        change = rng.normal(size=part.shape)
        whole[nodes] += change
        partial.put(part + change, y)
        assert agree(np.allclose(y, scatter.reverse(whole), rtol=0, atol=ROUNDING))
