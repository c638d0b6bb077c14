"""Constraints and contact tangents in the format of the solver kernels, and dense."""

import itertools

import numpy as np
import pytest

ROUNDING = 1e4 * np.finfo(float).eps

NODES = 40
RANKS = (0, 1, 3, 1, 3)  # constraints of each of the first nodes
OWNED = 20  # nodes of a rank that has values of the others at ghosts


def blocks(kind, rng, nodes=NODES):
    """Return uncoupled constraints of five nodes and blocks of a tangent, as arrays.

    Args:
        kind: Number of segment vertices of pairs, of which constraints and tangent
            have the same nodes; or "ragged": constraints that reach 3 to 30
            nodes, and a tangent of seven blocks between 8 others.
        rng: Random numbers.
        nodes: Nodes to choose from.
    """
    m, is_ragged = len(RANKS), kind == "ragged"
    lengths = [3, 30, 7, 12, 3] if is_ragged else [1 + kind] * m
    lists = [
        np.array([i, *rng.permutation(np.arange(m, nodes))[: k - 1]]) for i, k in enumerate(lengths)
    ]
    others = [rng.permutation(nodes)[:8] for _ in range(7)]
    tangent_nodes = np.array(others if is_ragged else lists)
    p, k = tangent_nodes.shape
    # Rows are near the normal and two tangents at the constrained node.
    own = np.linalg.qr(rng.normal(size=(m, 3, 3)))[0]
    rows = []
    for _ in range(2):
        parts = [0.2 * rng.normal(size=(3, 3 * length)) for length in lengths]
        for part, directions in zip(parts, own, strict=True):
            part[:, :3] += directions
        rows.append(np.concatenate([part.ravel() for part in parts]))
    # Constrained nodes may also occur in some of the rows, with any matrix.
    slopes = np.where([[[1]], [[0]], [[1]], [[1]], [[0]]], 0.3 * rng.normal(size=(m, 3, 3)), 0)
    return (
        np.concatenate([[0], np.cumsum(lengths)]),
        np.concatenate(lists).astype(np.int32),
        np.array(RANKS, dtype=np.int32),
        own[:, 0].copy(),
        *rows,
        slopes,
        tangent_nodes.astype(np.int32),
        0.3 * rng.normal(size=(p, 3 * k, 3 * k)),
    )


def parts(x):
    """Views of the rows of owned nodes and of ghosts."""
    return x[:OWNED], x[OWNED:]


def dense(start, nodes, rank, normal, gradients, columns, slopes, tangent_nodes, tangent):
    """Return E, G, F with one column a constraint, and the contact tangent."""

    def place(numbers):
        return np.kron(np.eye(NODES)[:, numbers], np.eye(3))

    E, G, F = [], [], []
    for i, (first, last) in enumerate(itertools.pairwise(start)):
        P = place(nodes[first:last])
        for result, rows in ((G, gradients), (F, columns)):
            result += list(rows[9 * first : 9 * last].reshape(3, -1)[: rank[i]] @ P.T)
        E += list((normal[i][None] if rank[i] == 1 else np.eye(3)[: rank[i]]) @ P[:, :3].T)
    C = sum(place(k) @ block @ place(k).T for k, block in zip(tangent_nodes, tangent, strict=True))
    for S, (first, last) in zip(slopes, itertools.pairwise(start), strict=True):
        g, f = (rows[9 * first : 9 * last].reshape(3, -1) for rows in (gradients, columns))
        P = place(nodes[first:last])
        C = C + P @ f.T @ S @ g @ P.T
    return np.array(E).T, np.array(G).T, np.array(F).T, C


kinds = pytest.mark.parametrize("kind", [0, 3, 4, "ragged"])
