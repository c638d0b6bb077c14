"""Checks for repeated cells, overlapping adjacent cells, and coincident nodes. Local."""

import logging
from collections.abc import Mapping

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats, GlobalInts

__all__ = ["check_repeated_cells", "warn_of_double_nodes", "warn_of_overlapping_cells"]

_logger = logging.getLogger("dolfinx_nts")

# Distance relative to the size of a mesh [-] below which two nodes coincide. Larger: nodes of tiny
# cells coincide; smaller: coordinates in files have fewer digits.
_SAME_PLACE = 1e-8
# Odd factors of a 64-bit hash.
_FIRST, _SECOND = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xC2B2AE3D27D4EB4F)
# Pairs of the vertices of facets in the plane and in space.
_PAIRS = {2: [(0, 1)], 3: [(0, 1), (0, 2), (1, 2)]}
# Shift of the grid to which positions are rounded, relative to its spacing [-], so that round
# numbers are not between two grid points.
_SHIFT = 0.38196601125


def check_repeated_cells(cells: GlobalInts, numbers: GlobalInts) -> None:
    """Check that no two cells have the same nodes.

    Args:
        cells: Nodes of each cell, shape ``(c, k)``.
        numbers: Number of each cell in the model, shape ``(c,)``.

    Raises:
        ValueError: Cells are given twice.
    """
    keys = _hash(np.sort(cells, axis=1))
    order = np.argsort(keys, kind="stable")
    again = np.flatnonzero(keys[order[1:]] == keys[order[:-1]])
    if len(again):
        first, second = numbers[order[again[0]]], numbers[order[again[0] + 1]]
        raise ValueError(
            f"expected each cell once, given {len(again)} with the nodes of another one, first "
            f"the gmsh elements {first} and {second}: remove one of them, in gmsh by "
            "gmsh.model.mesh.removeDuplicateElements()"
        )


def warn_of_double_nodes(
    x: Floats, cells: GlobalInts, tags: GlobalInts, names: Mapping[int, str]
) -> None:
    """Warn of bodies with several nodes at the same position, where they are not connected.

    Args:
        x: Positions of the nodes, shape ``(n, 3)`` [m].
        cells: Rows of x of each cell, shape ``(c, k)``.
        tags: Physical group of each cell, shape ``(c,)``.
        names: Names of the groups.
    """
    size = _SAME_PLACE * float(np.ptp(x, axis=0).max(initial=0.0))
    place = _hash(np.floor((x - x.min(axis=0)) / size + _SHIFT).astype(np.int64))
    for tag in np.unique(tags):
        nodes = np.unique(cells[tags == tag])
        _, first, count = np.unique(place[nodes], return_index=True, return_counts=True)
        if (double := count > 1).any():
            _logger.warning(
                "body %s has %d nodes at the place of another one, for instance at %s: its cells "
                "are not connected there; right for a crack, whose faces self contact keeps apart; "
                "otherwise merge the nodes (gmsh.model.mesh.removeDuplicateNodes(), or "
                "occ.fragment before meshing)",
                *(names[tag], int((count[double] - 1).sum())),
                x[nodes[first[double][0]]].round(6).tolist(),
            )


def warn_of_overlapping_cells(x: Floats, cells: GlobalInts, numbers: GlobalInts) -> None:
    """Warn of triangles or tetrahedra on the same side of their common facet.

    Args:
        x: Positions of the nodes, shape ``(n, d)`` [m].
        cells: Vertices of each cell, shape ``(c, d + 1)``.
        numbers: Number of each cell in the model, shape ``(c,)``.
    """
    dim = x.shape[1]
    turn = np.sign(np.linalg.det(x[cells[:, 1:]] - x[cells[:, :1]])).astype(np.int8)
    keys, sides = [], []
    for vertex in range(dim + 1):
        facet = np.delete(cells, vertex, axis=1)
        # Sign of the permutation that sorts the vertices of the facet.
        order = np.prod([np.sign(facet[:, j] - facet[:, i]) for i, j in _PAIRS[dim]], axis=0)
        keys.append(_hash(np.sort(facet, axis=1)))
        sides.append((1 - 2 * (vertex % 2)) * turn * order)
    key, side = np.concatenate(keys), np.concatenate(sides)
    sorting = np.argsort(key, kind="stable")
    first, second = sorting[:-1], sorting[1:]
    bad = np.flatnonzero((key[first] == key[second]) & (side[first] == side[second]))
    if len(bad):
        two = np.sort(np.array([first[bad[0]], second[bad[0]]]) % len(cells))
        _logger.warning(
            "%d facets have both of their cells on one side, first that of the gmsh elements %d "
            "and %d near %s: a node has passed through a facet, so that the cells overlap and "
            "their common volume counts twice; mesh the part again, or move its nodes back",
            *(len(bad), *numbers[two]),
            x[cells[two[0]]].mean(axis=0).round(6).tolist(),
        )


def _hash(rows: GlobalInts) -> Array:
    """Hash of each row of integers, shape ``(n,)``; the probability of a collision is 2^-64."""
    key: Array = np.zeros(len(rows), dtype=np.uint64)
    for column in rows.T.astype(np.uint64):
        key = (key ^ column) * _FIRST
        key = (key ^ (key >> np.uint64(32))) * _SECOND
    return key
