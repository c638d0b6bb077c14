"""Overlapping contact subdomain of one of several ranks."""

import numpy as np
import pytest

from dolfinx_nts.solvers.linear.block_csr import BlockCSR
from dolfinx_nts.solvers.linear.contact_blocks import ContactBlocks
from dolfinx_nts.solvers.precond.overlapping_subdomain import OverlappingSubdomain
from helpers import contact_blocks, scenes


def some(blocks, constraints, tangents):
    """Contacts that are selected by flags."""
    return blocks.take(np.flatnonzero(constraints), np.flatnonzero(tangents))


def test_ranks_gather_rows_again_only_for_more_contacts_or_another_matrix(comm, monkeypatch, agree):
    if comm.size == 1:
        pytest.skip("for several ranks")
    scene = scenes.ball_plate(comm, shift=scenes.NO_TIES)
    while scene.stepper.advance().num_active < 5:
        pass
    rows = scene.stepper._tangent.rows
    (every,) = scene.stepper._solver._contacts._schwarz._contacts
    count = np.arange(len(every.rank))
    fewer = some(every, count < count[-1:], count < count[-1:])
    gathered, gather = [], BlockCSR.gather
    monkeypatch.setattr(BlockCSR, "gather", lambda *args: gathered.append(1) or gather(*args))
    domain = OverlappingSubdomain(rows)
    history = [(fewer, 1, 1), (every, 1, 2), (every, 1, 2), (every, 2, 3), (fewer, 2, 3)]
    for blocks, version, times in history:
        domain.build([blocks], version)
        assert len(gathered) == times
    narrow = comm.allreduce(domain.size)
    domain.build([every], 2, wide=True)
    assert len(gathered) == 4
    assert comm.allreduce(domain.size) > narrow
    domain.build([every], 2)
    domain.build([fewer], 2)
    assert len(gathered) == 5
    # Additional data change nothing.
    exact = OverlappingSubdomain(rows)
    exact.build([fewer], 2)
    r, z = np.random.default_rng(comm.rank).random((2, rows.index_map.size_local, 3))
    expected = z.copy()
    exact.correct(r, expected)
    domain.correct(r, z)
    assert agree(np.array_equal(z, expected))


def test_each_rank_gets_the_contacts_of_its_nodes_and_of_their_neighbours_once(comm, agree):
    tangent = scenes.blocks(comm).stepper._tangent
    tangent.assemble_nearby()
    rows = tangent.rows
    # Constraints contain any nodes, blocks of the tangent one node; both come from any rank.
    arrays = contact_blocks.blocks("ragged", np.random.default_rng(3), rows.index_map.size_global)
    every = ContactBlocks(*arrays).renumbered(lambda nodes: nodes.astype(np.int64))
    every = every._replace(
        tangent_nodes=every.tangent_nodes[:, :1], tangent=every.tangent[:, :3, :3]
    )
    ranks = (np.arange(len(a)) % comm.size for a in (every.rank, every.tangent))
    own = some(every, *(r == comm.rank for r in ranks))
    (found,) = OverlappingSubdomain(rows)._near([own])

    reached = rows.matrix.index_map(1).local_to_global(rows.column)
    flags = (np.isin(nodes, reached) for nodes in (every.nodes, every.tangent_nodes))
    constraints, tangents = every.touching(*flags)
    expected = every.take(constraints, tangents)
    # They come in any order.
    found, expected = (
        a.take(np.argsort(a.nodes[a.start[:-1]]), np.argsort(a.tangent[:, 0, 0]))
        for a in (found, expected)
    )
    assert agree(all(map(np.array_equal, found, expected)))
    assert comm.size == 1 or not agree(len(expected.tangent) == len(every.tangent))
