"""Contact in complete factors of the bulk, against dense matrices; counts of work."""

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.common.archive import Snapshot
from dolfinx_nts.io import checkpoint
from dolfinx_nts.solvers.linear.contact_blocks import ContactBlocks
from dolfinx_nts.solvers.precond import contact_complement
from dolfinx_nts.solvers.precond.contact_complement import ContactComplement
from helpers import scenes
from helpers.contact_blocks import NODES, ROUNDING, blocks, dense, kinds


class Bulk:
    """Factors of a dense matrix, whose rows the ranks share."""

    def __init__(self, comm, rng, *, is_strong=True):
        """Draw a matrix."""
        self.is_strong = is_strong
        self.first, self.last = (NODES * rank // comm.size for rank in (comm.rank, comm.rank + 1))
        self.K = 5 * np.eye(3 * NODES) + 0.1 * rng.normal(size=(3 * NODES, 3 * NODES))
        self.num_builds, self.comm = 1, comm
        index_map = SimpleNamespace(
            size_local=self.last - self.first, local_range=(self.first, self.last)
        )
        self.tangent = SimpleNamespace(comm=comm, rows=SimpleNamespace(index_map=index_map, dim=3))

    def responses(self, forces):
        whole = np.vstack(self.comm.allgather(forces))
        return np.linalg.solve(self.K, whole)[3 * self.first : 3 * self.last]

    def apply(self, r):
        return np.linalg.solve(self.K, r).reshape(-1, 3)[self.first : self.last]


def elimination(comm, *contacts):
    """Contacts that the last rank alone knows."""
    pairs = [SimpleNamespace(global_blocks=lambda c=c: ContactBlocks(*c)) for c in contacts]
    return SimpleNamespace(pairs=pairs if comm.rank == comm.size - 1 else [])


@kinds
@pytest.mark.parametrize("is_strong", [False, True])
def test_whole_system_is_solved(comm, kind, is_strong, rng):
    bulk, arrays = Bulk(comm, rng, is_strong=is_strong), blocks(kind, rng)
    _, G, F, C = dense(*arrays)
    complement = ContactComplement(bulk.tangent, bulk)
    complement.update(elimination(comm, arrays))
    r = rng.normal(size=3 * NODES)
    z = bulk.apply(r)
    complement.correct(None, z)
    z = np.vstack(comm.allgather(z)).ravel()
    zero = np.zeros((G.shape[1], G.shape[1]))
    saddle = np.block([[bulk.K + C, F], [G.T, zero]])
    expected = np.linalg.solve(saddle, np.concatenate([r, zero[0]]))
    np.testing.assert_allclose(z, expected[: 3 * NODES], rtol=0, atol=ROUNDING)


@kinds
def test_forces_at_points_move_them_as_the_whole_system_does(comm, kind, rng):
    """Without geometric stiffness of contact forces; constraints of other ranks stay active."""
    bulk, arrays = Bulk(comm, rng), blocks(kind, rng)
    without = ContactBlocks(*arrays)
    _, G, F, C = dense(*without._replace(tangent=0 * without.tangent))
    (pairs,) = elimination(MPI.COMM_SELF, arrays).pairs
    pairs.blocks, pairs.excess = ContactBlocks(*arrays), rng.normal(size=(len(arrays[2]), 3))
    rows = np.arange(3) < arrays[2][:, None]
    is_point = rng.random(F.shape[1]) < 0.6
    present, f = rng.normal(size=(2, int(is_point.sum())))
    R = rng.normal(size=3 * NODES)
    complement = ContactComplement(bulk.tangent, bulk)
    own = [pairs] if comm.rank == comm.size - 1 else []
    part = slice(3 * bulk.first, 3 * bulk.last)
    W, q = complement.condensed(R[part], own, is_point, present)
    held = ~is_point
    zero = np.zeros((int(held.sum()),) * 2)
    saddle = np.block([[bulk.K + C, F[:, held]], [G[:, held].T, zero]])
    excess = pairs.excess[rows]
    right = np.concatenate([-R + F[:, is_point] @ (present + f), -excess[held]])
    z = np.linalg.solve(saddle, right)[: 3 * NODES]
    expected = G[:, is_point].T @ z + excess[is_point]
    np.testing.assert_allclose(W @ f + q, expected, rtol=0, atol=ROUNDING)


def test_columns_belong_to_nodes_and_factors(comm, rng):
    bulk, first, second = Bulk(comm, rng), blocks(3, rng), blocks(4, rng)
    complement = ContactComplement(bulk.tangent, bulk)
    reached = [np.union1d(arrays[1], arrays[-2]) for arrays in (first, second)]
    expected = 0
    for arrays, nodes in [
        (first, reached[0]),
        (first, reached[0][:0]),
        (second, np.setdiff1d(reached[1], reached[0])),
        (first, reached[0][:0]),
    ]:
        complement.update(elimination(comm, arrays))
        expected += 3 * len(nodes)
        assert complement.num_columns == expected
    bulk.num_builds += 1
    complement.update(elimination(comm, first))
    assert complement.num_columns == expected + 3 * len(reached[0])


@pytest.mark.at_most_two_ranks
def test_columns_of_former_contacts_are_dropped_when_they_are_many(comm, rng, monkeypatch):
    bulk, arrays = Bulk(comm, rng), [blocks(3, rng) for _ in range(2)]
    first, second = (np.union1d(some[1], some[-2]) for some in arrays)
    assert not np.array_equal(first, second)
    monkeypatch.setattr(contact_complement, "_MOST_NODES", len(np.union1d(first, second)) - 1)
    complement = ContactComplement(bulk.tangent, bulk)
    for some in arrays:
        complement.update(elimination(comm, some))
    assert complement.num_columns == 3 * (len(first) + len(second))


@pytest.mark.at_most_two_ranks
def test_singular_contact_is_left_to_others(comm, rng):
    bulk, arrays = Bulk(comm, rng), list(blocks(3, rng))
    arrays[4] = 0 * arrays[4]  # gradients
    complement = ContactComplement(bulk.tangent, bulk)
    complement.update(elimination(comm, arrays))
    z = rng.normal(size=(bulk.last - bulk.first, 3))
    before = z.copy()
    complement.correct(None, z)
    np.testing.assert_array_equal(z, before)


@pytest.mark.at_most_two_ranks
def test_restored_nodes_are_solved_for_as_before(comm, rng):
    bulk, first, second = Bulk(comm, rng), blocks(3, rng), blocks(4, rng)
    complement = ContactComplement(bulk.tangent, bulk)
    calls = []
    responses = bulk.responses
    bulk.responses = lambda forces: calls.append(forces.shape[1]) or responses(forces)
    complement.update(elimination(comm, first))
    complement.update(elimination(comm, second))
    archive = Snapshot()
    complement.serialize(archive)
    complement.serialize(archive.rewind())
    complement.update(elimination(comm, second))
    assert len(calls) == 4 and calls[:2] == calls[2:]


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_nearly_incompressible_contact_takes_few_iterations(comm, mu):
    law = nts.Coulomb(mu) if mu else None
    scene = scenes.sliding_blocks(comm, nts.LagrangeMultiplier(), law, n=4, nu=0.499)
    solver = scene.stepper._solver
    scene.stepper.advance()
    start, newton = solver.num_iterations, 0
    for _ in range(3):
        newton += scene.stepper.advance().newton_iterations
    # Around the contacts alone there are more than 200 for each system, and solutions of whole
    # systems; with multipliers that balance forces at nodes, three times as many systems as the
    # 21, or 27 to 32 with friction, that there are on different meshers and processors.
    assert solver.num_direct == 0
    assert solver.num_iterations - start < 50 * newton
    assert newton < 40


@pytest.mark.serial
def test_resumed_run_repeats_every_digit(comm, tmp_path):
    runs = [
        scenes.sliding_blocks(comm, nts.LagrangeMultiplier(), nts.Coulomb(0.3), n=3, nu=0.499)
        for _ in range(2)
    ]
    first, second = (scene.stepper for scene in runs)
    for _ in range(3):
        first.advance()
    assert first._solver._contacts.uses_complement
    checkpoint.save(tmp_path / "run.h5", first)
    checkpoint.load(tmp_path / "run.h5", second)
    for stepper in (first, second):
        stepper.advance()
    np.testing.assert_array_equal(first.u.x.array, second.u.x.array)
