"""Sharp edges at current positions, and pairs of edges near each other."""

from dataclasses import dataclass

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints, indices
from dolfinx_nts.common.vectors import cross
from dolfinx_nts.search.edges.sharp_edges import unit_normals

__all__ = ["Edges", "pairs_within"]

# Number of boxes that are compared at a time [-], to save memory.
_AT_ONCE = 1 << 20

# Least and greatest coordinates, both ``(e, 3)`` [m].
Boxes = tuple[Floats, Floats]


@dataclass(frozen=True)
class Edges:
    """Sharp edges, see `SharpEdges`, in terms of the nodes of a scatter map.

    Attributes:
        ends: Both ends, shape ``(e, 2)``.
        facets: Vertices of both facets, oriented outward, shape ``(e, 2, k)``.
        key: Number of each edge, shape ``(e,)``.
        thickness: Heights of the cells behind the edges, ``(e,)`` [m].
    """

    ends: Ints
    facets: Ints
    key: GlobalInts
    thickness: Floats

    @classmethod
    def of(cls, rows: Ints, key: GlobalInts, thickness: Floats) -> "Edges":
        """Create edges from rows of ends and vertices of both facets, shape ``(e, 2 + 2 k)``."""
        ends, facets = np.ascontiguousarray(rows[:, :2]), rows[:, 2:]
        return cls(ends, facets.reshape(-1, 2, facets.shape[1] // 2), key, thickness)

    def boxes(self, x: Floats) -> Boxes:
        """Least and greatest coordinates of the edges, both ``(e, 3)`` [m]."""
        ends = x[self.ends]
        return ends.min(axis=1), ends.max(axis=1)

    def between(self, x: Floats, edge: Ints, n: Floats) -> Floats:
        """Sines of the angles of directions n, ``(m, 3)``, to both facets, ``(m, 2)``.

        Both are positive if n lies between the normals of the facets at an edge.
        """
        normals = unit_normals(x[self.facets[edge]])
        first, second = normals[:, 0], normals[:, 1]
        axis = cross(first, second)
        axis /= np.maximum(np.linalg.norm(axis, axis=1), np.finfo(float).tiny)[:, None]
        sides = (cross(first, n), cross(n, second))
        return np.column_stack([np.einsum("mi,mi->m", side, axis) for side in sides])

    def depth(self, x: Floats, edge: Ints, points: Floats) -> Floats:
        """Largest depth of points, ``(m, k, 3)``, below the facets at an edge, ``(m,)`` [m].

        The depth is the smaller one of both facets.
        """
        normals = unit_normals(x[self.facets[edge]])
        offsets = points - x[self.ends[edge, :1]]
        below: Floats = np.einsum("mfi,mpi->mfp", -normals, offsets).max(axis=2).min(axis=1)
        return below


def pairs_within(
    own: Edges, other: Edges, num_others: int, x: Floats, reach: float
) -> tuple[Ints, GlobalInts]:
    """Pairs of edges with boxes within ``reach`` [m], ``(c, 2)``, and sorted keys. Local.

    ``num_others`` is the number of the other edges on all ranks.
    """
    pairs = _boxes_within(own.boxes(x), other.boxes(x), reach)
    key = num_others * own.key[pairs[:, 0]] + other.key[pairs[:, 1]]
    order = np.argsort(key)
    return pairs[order], key[order]


def _boxes_within(first: Boxes, second: Boxes, reach: float) -> Ints:
    """Pairs of boxes of two groups within a distance [m] of each other, shape ``(c, 2)``."""
    found: list[Ints] = [np.empty((0, 2), dtype=np.int32)]
    (lower, upper), (least, greatest) = first, second
    # Preselection by the bounding box of the other group.
    some = _near((lower, upper), (least, greatest), reach)
    others = _near((least, greatest), (lower, upper), reach)
    step = max(1, _AT_ONCE // max(1, len(others)))
    for start in range(0, len(some), step):
        part = some[start : start + step]
        meets = np.ones((len(part), len(others)), dtype=bool)
        for i in range(3):
            meets &= lower[part, i, None] <= greatest[others, i] + reach
            meets &= least[others, i] <= upper[part, i, None] + reach
        row, column = np.nonzero(meets)
        found.append(np.column_stack([part[row], others[column]]))
    return np.concatenate(found)


def _near(boxes: Boxes, others: Boxes, reach: float) -> Ints:
    """Indices of boxes within a distance of the box around all others."""
    lower, upper = boxes
    least = others[0].min(axis=0, initial=np.inf) - reach
    greatest = others[1].max(axis=0, initial=-np.inf) + reach
    near: Flags = ((lower <= greatest) & (upper >= least)).all(axis=1)
    return indices(near)
