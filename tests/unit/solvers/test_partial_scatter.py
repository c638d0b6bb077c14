"""Parts of nodal vectors, against the exchange of all values."""

import numpy as np
import pytest

from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.solvers.partial_scatter import PartialScatter
from helpers import scenes

ROUNDING = 1e2 * np.finfo(float).eps


@pytest.fixture
def candidates(comm):
    """One that reaches everywhere."""
    scene = scenes.blocks(comm)
    pair = scene.stepper.pairs[0]
    found, _ = GlobalSearch(pair.nodes, pair.segments).update(scene.stepper.x, np.inf)
    return found


def some_nodes(candidates, comm, share):
    """A share of the nodes that a rank knows; none on the last of several."""
    rng = np.random.default_rng(comm.rank)
    chosen = np.flatnonzero(rng.random(candidates.num_local) < share).astype(np.int32)
    return chosen[:0] if comm.rank == comm.size - 1 > 0 else chosen


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_values_are_those_of_the_owners(comm, candidates, agree, share):
    nodes = some_nodes(candidates, comm, share)
    scatter = PartialScatter(candidates, nodes)
    for number in range(2):  # nothing of the first vector stays
        rng = np.random.default_rng([number, comm.rank])
        x = rng.normal(size=(candidates.index_map.size_local, 3))
        assert agree(np.array_equal(scatter.take(x), candidates.with_ghosts(x)[nodes]))


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_what_ghosts_have_is_added_at_their_owners(comm, candidates, agree, share):
    n = candidates.index_map.size_local
    nodes = some_nodes(candidates, comm, share)
    scatter = PartialScatter(candidates, nodes)
    for number in range(2):
        rng = np.random.default_rng([number, comm.rank])
        y = rng.normal(size=(n, 3))
        whole = np.concatenate([y, np.zeros((candidates.index_map.num_ghosts, 3))])
        part = scatter.owned(y)
        assert agree(np.array_equal(part, whole[nodes]))
        change = rng.normal(size=part.shape)
        whole[nodes] += change
        scatter.put(part + change, y)
        assert agree(np.allclose(y, candidates.to_owners(whole), rtol=0, atol=ROUNDING))
