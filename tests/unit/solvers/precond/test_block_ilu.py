"""Incomplete factors of a distributed matrix, compared with dense factors of each rank's block."""

import numpy as np
import pytest

from dolfinx_nts.solvers.precond import block_ilu
from dolfinx_nts.solvers.precond.block_ilu import BlockILU
from helpers import scenes
from helpers.dense_factors import definition, dense, filled, rounding


@pytest.mark.serial
def test_rows_of_other_ranks_are_eliminated_next_to_their_neighbours():
    # Neighbours of rows 0 to 5, of which 4 and 5 are another rank's; 6 is outside.
    rows = [[0, 1, 4], [0, 1, 2], [1, 2, 3], [2, 3, 5], [4, 0, 6], [3, 5, 6]]
    start = np.cumsum([0, *map(len, rows)])
    order = block_ilu._order(start, np.concatenate(rows).astype(np.int32), 4)
    np.testing.assert_array_equal(order, [3, 5, 2, 1, 0, 4])


@pytest.mark.parametrize("fill", [False, True])
def test_factors_cover_each_rank_and_its_neighbours(comm, rng, fill):
    tangent = scenes.blocks(comm).stepper._tangent
    tangent.assemble_nearby()
    N = tangent.rows.index_map.size_global
    factors = BlockILU(tangent.rows, fill=fill)
    assert factors.build()
    nodes = tangent.rows.matrix.index_map(1)
    numbers = nodes.local_to_global(np.arange(nodes.size_local + nodes.num_ghosts, dtype=np.int32))
    matrix = tangent.matrix(scalar=True)
    begin, column, value = (
        np.concatenate(a) for a in zip(*comm.allgather(_csr(matrix)), strict=True)
    )
    A = np.zeros((3 * N, 3 * N))
    A[begin, column] = value
    pattern = np.zeros((N, N), dtype=bool)
    pattern[begin // 3, column // 3] = True
    order = numbers[factors._order]
    n = len(order)
    A = A.reshape(N, 3, N, 3).transpose(0, 2, 1, 3)[np.ix_(order, order)]
    pattern = pattern[np.ix_(order, order)]
    L, U = definition(A, filled(pattern) if fill else pattern)
    r = comm.bcast(rng.normal(size=(N, 3)))
    expected = np.linalg.solve(dense(L) @ dense(U), r[order].ravel()).reshape(-1, 3)
    z, b = matrix.createVecs()
    b.array[:] = r[numbers[: nodes.size_local]].ravel()
    factors.apply(None, b, z)
    z = z.array.reshape(-1, 3)
    inside = factors._order < len(z)
    error = np.abs(z[factors._order[inside]] - expected[inside])
    assert np.all(error < rounding(L, U, expected).reshape(n, 3)[inside])
    np.testing.assert_array_equal(factors.solve_all(b.array[:, None].copy("F")).ravel(), z.ravel())


def _csr(matrix):
    """Row, column and value of each entry of this rank."""
    start, column, value = matrix.getValuesCSR()
    first, last = matrix.getOwnershipRange()
    return np.repeat(np.arange(first, last), np.diff(start)), column, value
