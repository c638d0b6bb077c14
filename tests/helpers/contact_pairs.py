"""Contact pairs as the kernels of the solvers take them, and their dense matrices."""

import numpy as np
import pytest

ROUNDING = 1e4 * np.finfo(float).eps

NODES = 30


def pairs(k, rng):
    """Return five uncoupled pairs with 0, 1 or 3 constraints, as arrays."""
    rank = np.array([0, 1, 3, 1, 3], dtype=np.int32)
    vertices = rng.integers(5, NODES, size=(5, k)).astype(np.int32)
    dofs = np.column_stack([np.arange(5, dtype=np.int32), vertices])
    d = 3 * (1 + k)
    normal = rng.normal(size=(5, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    gradients, columns = (0.2 * rng.normal(size=(5, 3, d)) for _ in range(2))
    gradients[:, 0, :3] += normal
    columns[:, 0, :3] += normal
    for a in (1, 2):
        tangent = np.cross(normal, np.eye(3)[a])
        gradients[:, a, :3] += tangent
        columns[:, a, :3] += tangent
    return dofs, rank, normal, gradients, columns, rng.normal(size=(5, d, d))


def dense(dofs, rank, normal, gradients, columns, tangent):
    """Return E, G, F with one column a constraint, and the contact tangent."""
    E, G, F, C = [], [], [], np.zeros((3 * NODES, 3 * NODES))
    for i, nodes in enumerate(dofs):
        place = np.zeros((3 * NODES, tangent.shape[1]))
        for a, node in enumerate(nodes):
            place[3 * node : 3 * node + 3, 3 * a : 3 * a + 3] += np.eye(3)
        C += place @ tangent[i] @ place.T
        for a in range(rank[i]):
            G.append(place @ gradients[i, a])
            F.append(place @ columns[i, a])
            E.append(place[:, :3] @ (normal[i] if rank[i] == 1 else np.eye(3)[a]))
    return np.array(E).T, np.array(G).T, np.array(F).T, C


kinds = pytest.mark.parametrize("k", [0, 3, 4])
