"""Parts of scenes: hexahedra from grids, their facets, how they start."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import numpy as np
import numpy.typing as npt

import dolfinx_nts as nts

__all__ = ["RUBBER", "Part", "ball", "box", "box_blocks", "from_blocks", "rotation"]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

RUBBER = nts.SaintVenantKirchhoff(E=1.0e5, nu=0.4, rho=1.0e3)  # Pa, -, kg/m^3

# Corners of the cells in tensor order, and their facets.
_BITS = np.array([[(c >> a) & 1 for a in range(3)] for c in range(8)])
_SIDES = np.array([np.flatnonzero(_BITS[:, a] == b) for a in range(3) for b in (0, 1)])
_WAYS = np.array([[0, 1 << a, (1 << a) + (1 << b), 7] for a, b, _ in permutations(range(3))])
# Distance of nodes of two grids that are merged, relative to the part.
_SAME = 1e-8


@dataclass(frozen=True)
class Part:
    """A body: nodes (n, 3) [m], hexahedra (c, 8), facets (f, 4) by side.

    Attributes:
        X: Nodes.
        cells: Hexahedra in tensor order.
        sides: Outer facets by name.
        material: Material.
        velocity: At the start: three numbers [m/s], or a function of
            the positions (3, n).
    """

    X: Array
    cells: Ints
    sides: dict[str, Ints]
    material: nts.Hyperelastic = RUBBER
    velocity: Any = (0.0, 0.0, 0.0)

    def moved(self, move: Callable[[Array], Any]) -> "Part":
        """Move the nodes by a function of their coordinates (3, n)."""
        return replace(self, X=np.asarray(np.broadcast_arrays(*move(self.X.T))).T.copy())

    def at(self, *shift: float) -> "Part":
        """Shift by three numbers."""
        return replace(self, X=self.X + shift)

    def turned(self, Q: Array) -> "Part":
        """Turn about the origin by a rotation matrix."""
        return replace(self, X=self.X @ Q.T)

    def made(self, material: nts.Hyperelastic, velocity: Any = None) -> "Part":
        """Copy of the part with a material and, if given, a velocity."""
        return replace(
            self, material=material, velocity=self.velocity if velocity is None else velocity
        )

    def flying(self, *velocity: float) -> "Part":
        """Copy of the part with a velocity [m/s]."""
        return replace(self, velocity=velocity)

    def tetrahedra(self) -> tuple[Ints, dict[str, Ints]]:
        """Six from each hexahedron of a grid; triangles of the sides."""
        cells = self.cells[:, _WAYS].reshape(-1, 4)
        corners = cells[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3)
        sides = {}
        for name, facets in self.sides.items():
            # Three corners of one quadrangle of the side.
            of = {frozenset(f) for f in facets.tolist()}
            nodes = np.unique(facets)
            near = corners[np.isin(corners, nodes).all(axis=1)]
            chosen = [t for t in near.tolist() if any(set(t) <= f for f in of)]
            sides[name] = np.array(chosen)
        return cells, sides


def rotation(axis: Sequence[float], angle: float) -> Array:
    """Rotation matrix about an axis by an angle [rad]."""
    u = np.divide(axis, np.linalg.norm(axis))
    skew = np.cross(np.eye(3), u)
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew


def from_blocks(
    blocks: Sequence[Array], side: Callable[[Array], npt.NDArray[Any]] | None = None
) -> Part:
    """Join grids of nodes (nx + 1, ny + 1, nz + 1, 3) where they coincide.

    Args:
        blocks: The grids.
        side: Names of outer facets from their nodes (f, 4, 3); all outer
            facets are also in the side ``all``.
    """
    points, cells, first = [], [], 0
    for block in blocks:
        shape = np.array(block.shape[:3])
        ids = first + np.arange(shape.prod()).reshape(shape)
        i, j, k = np.indices(shape - 1)[..., None] + _BITS.T[:, None, None, None]
        points.append(block.reshape(-1, 3))
        cells.append(ids[i, j, k].reshape(-1, 8))
        first += ids.size
    X, hexahedra = np.concatenate(points), np.concatenate(cells)
    if len(blocks) > 1:
        grid = np.round((X - X.min(axis=0)) / (_SAME * np.ptp(X))).astype(np.int64)
        _, chosen, same = np.unique(grid, axis=0, return_index=True, return_inverse=True)
        X, hexahedra = X[chosen], same.ravel()[hexahedra]
    facets = hexahedra[:, _SIDES].reshape(-1, 4)
    _, chosen, count = np.unique(
        np.sort(facets, axis=1), axis=0, return_index=True, return_counts=True
    )
    outer = facets[chosen[count == 1]]
    sides = {"all": outer}
    if side is not None:
        names = np.asarray(side(X[outer]))
        sides |= {str(name): outer[names == name] for name in np.unique(names)}
    return Part(X, hexahedra, sides)


def box_blocks(size: Sequence[float], cells: Sequence[int]) -> Array:
    """Grid of a box with a corner at the origin."""
    axes = [np.linspace(0, s, c + 1) for s, c in zip(size, cells, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def box(size: Sequence[float], cells: Sequence[int]) -> Part:
    """Box with a corner at the origin; sides left, right, front, back, bottom, top."""
    names = np.array(["left", "right", "front", "back", "bottom", "top"])

    def side(x: Array) -> npt.NDArray[Any]:
        middle = x.mean(axis=1)
        distance = np.abs(np.stack([middle, size - middle], axis=-1))
        return names[distance.reshape(-1, 6).argmin(axis=1)]

    return from_blocks([box_blocks(size, cells)], side)


def ball(outer: float, wall: float, cells: int = 3, layers: int = 1) -> Part:
    """Hollow ball about the origin, a cubed sphere; sides outer and inner.

    Args:
        outer: Outer radius [m].
        wall: Thickness [m].
        cells: Cells along an edge of the cube.
        layers: Cells through the wall.
    """
    p = np.tan(np.pi / 4 * np.linspace(-1, 1, cells + 1))
    a, b = (c[..., None] for c in np.meshgrid(p, p, indexing="ij"))
    r = np.linspace(outer - wall, outer, layers + 1)[:, None]
    faces = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            n = np.roll(np.concatenate([np.full_like(a, sign), a, b], axis=-1), axis, axis=-1)
            n /= np.linalg.norm(n, axis=-1, keepdims=True)
            faces.append(n[:, :, None] * r)

    def side(x: Array) -> npt.NDArray[Any]:
        far = np.linalg.norm(x, axis=2).mean(axis=1) > outer - wall / 2
        return np.where(far, "outer", "inner")

    return from_blocks(faces, side)
