"""Incomplete factors of block matrices, by their definition in dense matrices."""

import numpy as np

EPS = np.finfo(np.float32).eps

NODES = 9

BEYOND = 3  # columns that have no rows


def definition(A, pattern):
    """Return L with unit diagonal and U whose product is A in the pattern, as blocks."""
    n = len(A)
    L, U = np.zeros_like(A), np.zeros_like(A)
    for i in range(n):
        L[i, i] = np.eye(A.shape[-1])
        for j in np.flatnonzero(pattern[i]):
            remainder = A[i, j] - sum(L[i, k] @ U[k, j] for k in range(min(i, j)))
            if j < i:
                L[i, j] = remainder @ np.linalg.inv(U[j, j])
            else:
                U[i, j] = remainder
    return L, U


def filled(pattern):
    """Pattern with the entries that the elimination of its rows fills, one level of fill."""
    lower, upper = np.tril(pattern, -1), np.triu(pattern, 1)
    return pattern | (lower.astype(int) @ upper.astype(int) > 0)


def dense(blocks):
    return blocks.transpose(0, 2, 1, 3).reshape(blocks.shape[-1] * len(blocks), -1)


def rounding(L, U, x):
    """Bound on the rounding error of the factors and of both solves, entry by entry."""
    n = len(L)
    diagonals = [U[i, i] for i in range(n)]
    condition = max(np.linalg.cond(D, np.inf) for D in diagonals)
    L, U = dense(L), dense(U)
    sums = 3 * n + 6  # terms of a row, and roundings of a factor
    growth = np.abs(np.linalg.inv(U)) @ np.abs(np.linalg.inv(L)) @ np.abs(L) @ np.abs(U)
    return 4 * sums * EPS * condition * growth @ np.abs(x).ravel()


def matrix(rng, share, dim=3):
    """Return random rows with columns in any order, as arrays and dense, and their pattern."""
    A = rng.normal(size=(NODES, NODES + BEYOND, dim, dim))
    A[np.arange(NODES), np.arange(NODES)] += dim * NODES * np.eye(dim)
    pattern = rng.random((NODES, NODES + BEYOND)) < share
    pattern |= np.eye(*pattern.shape, dtype=bool)
    columns = [rng.permutation(np.flatnonzero(row)) for row in pattern]
    value = np.concatenate([A[i, row].ravel() for i, row in enumerate(columns)])
    start = np.cumsum([0, *(len(row) for row in columns)])
    A[~pattern] = 0
    rows = start, np.concatenate(columns).astype(np.int32), value
    return rows, A[:, :NODES], pattern[:, :NODES]
