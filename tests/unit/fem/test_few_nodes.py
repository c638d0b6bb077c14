"""Sums at a few nodes of a space, on any number of ranks."""

import gc

import numpy as np
from dolfinx import fem, la
from dolfinx.mesh import create_unit_cube

from dolfinx_nts.fem import few_nodes
from dolfinx_nts.fem.few_nodes import nodes_on_any_rank, sums_at


def _space(comm):
    return fem.functionspace(create_unit_cube(comm, 3, 3, 3), ("Lagrange", 1, (3,)))


def test_nodes_of_some_ranks_are_found_on_all_that_know_them(comm, agree):
    """Each rank gives the nodes of its own first cells; twice, as the vector is used again."""
    V = _space(comm)
    index_map, dofs = V.dofmap.index_map, V.dofmap.list
    for count in (5, 2):
        given = np.unique(dofs[:count])
        found = nodes_on_any_rank(V, dofs[:count])
        assert found.dtype == np.int32
        everywhere = comm.allgather(index_map.local_to_global(given))
        known = index_map.local_to_global(np.arange(index_map.size_local + index_map.num_ghosts))
        expected = np.flatnonzero(np.isin(known, np.concatenate(everywhere)))
        assert agree(np.array_equal(found, expected))


def test_a_rank_without_nodes_takes_part(comm, agree):
    V = _space(comm)
    nodes = V.dofmap.list[:1] if comm.rank == comm.size - 1 else V.dofmap.list[:0]
    found = nodes_on_any_rank(V, nodes)
    assert agree(np.isin(nodes, found).all())
    assert len(nodes_on_any_rank(V, V.dofmap.list[:0])) == 0


def test_sums_equal_those_of_a_vector(comm, agree, rng):
    V = _space(comm)
    index_map = V.dofmap.index_map
    owned = np.arange(index_map.size_local, dtype=np.int32)
    for width in (1, 2, 2):
        nodes = V.dofmap.list[: 7 + comm.rank].ravel()
        values = rng.random((len(nodes), width))
        vector = la.vector(index_map, width)
        np.add.at(vector.array.reshape(-1, width), nodes, values)
        vector.scatter_reverse(la.InsertMode.add)
        expected = vector.array.reshape(-1, width)[owned]
        assert agree(np.allclose(sums_at(V, owned, nodes, values), expected, rtol=1e-14))


def test_vectors_go_with_their_space(comm):
    V = _space(comm)
    nodes_on_any_rank(V, V.dofmap.list[:1])
    key = id(V)
    assert key in few_nodes._KNOWN
    del V
    gc.collect()
    assert key not in few_nodes._KNOWN
