"""Rows of a distributed matrix, against PETSc's own assembly."""

import numpy as np

ROUNDING = 1e3 * np.finfo(float).eps


def test_rows_of_any_nodes_are_gathered_from_their_owners(comm, matrices, agree):
    rows, dense, _ = matrices
    num_nodes = len(dense) // 3
    ends = np.cumsum(comm.allgather(rows.index_map.size_local))
    # Each rank requests other rows, the last rank none.
    nodes = np.sort(np.random.default_rng(comm.rank).permutation(num_nodes)[:7])
    if comm.rank == comm.size - 1 > 0:
        nodes = nodes[:0]
    start, column, value = rows.gather(nodes.astype(np.int64), ends)
    found = np.zeros((len(nodes), 3, num_nodes, 3))
    row = np.repeat(np.arange(len(nodes)), np.diff(start))
    found[row, :, column] = value.reshape(-1, 3, 3)
    expected = dense.reshape(num_nodes, 3, num_nodes, 3)[nodes]
    assert agree(np.array_equal(rows.neighbours(nodes.astype(np.int64), ends), column))
    assert agree(np.allclose(found, expected, rtol=0, atol=ROUNDING * np.abs(dense).max()))


def test_diagonal_agrees_with_the_owned_rows(comm, matrices):
    rows, dense, _ = matrices
    diagonal = np.concatenate(comm.allgather(rows.diagonal())).ravel()
    np.testing.assert_allclose(diagonal, np.diag(dense), rtol=ROUNDING)


def test_values_reach_a_matrix_of_petsc(comm, matrices):
    rows, dense, _ = matrices
    A = rows.petsc()
    x, y = A.createVecs()
    first, last = x.getOwnershipRange()
    whole = np.sin(np.arange(len(dense)))
    x.array[:] = whole[first:last]
    A.mult(x, y)
    scale = np.abs(dense).sum(axis=1).max()
    np.testing.assert_allclose(y.array, (dense @ whole)[first:last], atol=ROUNDING * scale)
    for item in (A, x, y):
        item.destroy()
