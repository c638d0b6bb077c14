"""Partition of a mesh by recursive coordinate bisection.

The partition is the same in each run, unlike partitions of the graph of cells. If a plane cuts
bodies of different sizes, parts in contact mostly stay on one rank. Bodies of the same size are not
cut but separated; if they touch, ranks then exchange less data than if both bodies were cut.
"""

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats, Ints

__all__ = ["ranks_of_cells"]

# Distance of midpoints along an axis, relative to the extent [-], that counts as zero, so that
# cells of one layer are ordered in rows.
_SAME = 1e-6


def ranks_of_cells(X: Floats, cells: Array, num_ranks: int) -> Ints:
    """Divide cells evenly among ranks. Local.

    Each part is cut normal to the axis that gives the fewest common nodes.

    Args:
        X: Positions of the nodes, shape ``(n, 3)`` [m].
        cells: Rows of X of the vertices of each cell, shape ``(c, k)``.
        num_ranks: Number of ranks.

    Returns:
        Rank of each cell, shape ``(c,)``.
    """
    ranks = np.zeros(len(cells), dtype=np.int32)
    midpoints = X[cells].mean(axis=1)
    parts = [(np.arange(len(cells)), 0, num_ranks)]
    while parts:
        part, first, number = parts.pop()
        if number == 1:
            ranks[part] = first
            continue
        lower = number // 2
        nodes = np.unique(cells[part], return_inverse=True)[1].reshape(len(part), cells.shape[1])
        size = round(len(part) * lower / number)
        cuts = [np.split(order, [size]) for order in _orders(midpoints[part])]
        one, other = min(cuts, key=lambda cut: _num_common(nodes, *cut))
        parts += [(part[one], first, lower), (part[other], first + lower, number - lower)]
    return ranks


def _orders(points: Floats) -> list[Array]:
    """Orders of points along each axis; equal coordinates are ordered along the other axes."""
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    same = _SAME * (high - low).max() or 1.0
    place = np.rint((points - low) / same)
    return [np.lexsort(np.roll(place, -axis, axis=1).T[::-1]) for axis in range(3)]


def _num_common(nodes: Array, one: Array, other: Array) -> int:
    """Number of common nodes of two sets of cells, ``(c, k)`` each."""
    marks = np.zeros((2, nodes.max(initial=-1) + 1), dtype=bool)
    marks[0, nodes[one]] = marks[1, nodes[other]] = True
    return int(np.count_nonzero(marks.all(axis=0)))
