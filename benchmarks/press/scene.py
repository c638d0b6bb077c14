"""Two blocks, the upper one with a parabolic lower face, as plain arrays: Hertz' line contact.

The upper block is pressed down, and then dragged. There is one layer of hexahedra, whose nodes
do not move along y: plane strain.
"""

from typing import NamedTuple

import numpy as np

from benchmarks.peers.scene import Floats, Ints

__all__ = ["MU", "NUM_DOWN", "NUM_STEPS", "RADIUS", "WIDTH", "Scene", "facets", "read"]

MU, RADIUS, WIDTH = 0.3, 40.0, 0.05  # friction [-], of the parabola and along y [m]
# Between the bodies at the start [m]: GetFEM would join them where they share a point.
GAP = 2e-4
# Displacements of the upper end down and aside, and the number of steps of each.
DOWN, NUM_DOWN, ASIDE, NUM_ASIDE = 7.5e-4, 3, 4e-4, 10
NUM_STEPS = NUM_DOWN + NUM_ASIDE
# Cell sizes of the upper and the lower body up to a distance from the middle, and their largest
# growth beyond it [m, -].
_SIZES, _NEAR, _GROWTH = (0.0121, 0.0155), 0.17, 1.45


class Scene(NamedTuple):
    """Mesh of the scene.

    Attributes:
        X: Nodes, shape ``(n, 3)`` [m].
        upper, lower: Hexahedra, shape ``(c, 8)``, nodes in the order of gmsh.
        outer, top: Nodes of the upper and of the lower body in contact, along x and y, shape
            ``(k, 2)``.
        moved, held: Nodes of the ends of the upper and of the lower body, the same shape.
    """

    X: Floats
    upper: Ints
    lower: Ints
    outer: Ints
    top: Ints
    moved: Ints
    held: Ints

    @property
    def cells(self) -> Ints:
        """All hexahedra."""
        return np.concatenate([self.upper, self.lower])

    @staticmethod
    def travel(step: int) -> Floats:
        """Displacement of the moved nodes at the end of a step, from 1 on, shape ``(3,)`` [m]."""
        aside = ASIDE * max(step - NUM_DOWN, 0) / NUM_ASIDE
        return np.array([aside, 0.0, -DOWN * min(step, NUM_DOWN) / NUM_DOWN])


def facets(nodes: Ints) -> Ints:
    """Quadrilaterals over the nodes along x, between both layers of y, shape ``(k - 1, 4)``."""
    return np.hstack([nodes[:-1], nodes[1:, ::-1]])


def read() -> Scene:
    """Make the mesh."""
    (x_upper, ids, upper), (x_lower, below, lower) = map(_block, _SIZES)
    x_upper[:, 2] += GAP + (1 - x_upper[:, 2]) * x_upper[:, 0] ** 2 / (2 * RADIUS)
    x_lower[:, 2] *= -1
    below, n = below + len(x_upper), len(x_upper)
    return Scene(
        np.concatenate([x_upper, x_lower]),
        upper,
        n + lower[:, [4, 5, 6, 7, 0, 1, 2, 3]],
        *(ids[..., 0], below[..., 0], ids[..., -1], below[..., -1]),
    )


def _block(size: float) -> tuple[Floats, Ints, Ints]:
    """Nodes of a block of the height 1, their numbers along x, y and z, and its hexahedra."""
    z = _distances(size)
    x = np.concatenate([-z[:0:-1], z])
    X = np.stack(np.meshgrid(x, [0.0, WIDTH], z, indexing="ij"), axis=-1)
    ids = np.arange(X[..., 0].size).reshape(X.shape[:-1])
    square = [ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]]
    corners = [side[..., part] for part in (slice(-1), slice(1, None)) for side in square]
    return X.reshape(-1, 3), ids, np.stack(corners, axis=-1).reshape(-1, 8)


def _distances(size: float) -> Floats:
    """Distances of nodes from the middle, from 0 to 1, shape ``(k,)`` [m]."""
    near = np.linspace(0.0, _NEAR, round(_NEAR / size) + 1)
    for number in range(1, 100):
        growth = np.linspace(1.0, _GROWTH, 10001)
        length = near[1] * sum(growth**k for k in range(1, number + 1))
        if length[-1] >= 1 - _NEAR:
            break
    factor = float(np.interp(1 - _NEAR, length, growth))
    steps = near[1] * factor ** np.arange(1, number + 1)
    far = _NEAR + np.cumsum(steps) * (1 - _NEAR) / steps.sum()
    return np.concatenate([near, far])
