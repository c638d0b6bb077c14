"""Nodes at equal distances from several segments, for instance above a common edge.

The gap of such a node is the mean of its gaps to all of them. Otherwise round-off or the numbering
of cells would choose one of the segments.
"""

import numpy as np

from dolfinx_nts.common.arrays import Array, Flags, Floats, GlobalInts, Ints
from dolfinx_nts.search.mortar.mortar_points import MortarPoints, Shares

__all__ = ["SharedSegments", "shared_points"]


class SharedSegments:
    """Segments of the nodes that have several segments. Local.

    Args:
        num_nodes: Number of nodes of the surface, ``n``.

    Attributes:
        many: Whether a node has several segments, shape ``(n,)``.
        node: Nodes of the entries, ascending, shape ``(i,)``.
        segment: Their segments, shape ``(i,)``.
    """

    def __init__(self, num_nodes: int) -> None:
        """Initially give each node one segment."""
        self.many: Flags = np.zeros(num_nodes, dtype=bool)
        self.node: Ints = np.empty(0, dtype=np.int32)
        self.segment: Ints = self.node

    def replace(self, nodes: Ints, row: Ints, segment: Ints) -> None:
        """Replace the segments of some nodes.

        Args:
            nodes: The nodes, shape ``(m,)``.
            row: Index in ``nodes`` of each entry of a node with several segments, ``(e,)``.
            segment: Their segments, shape ``(e,)``.
        """
        if not (len(row) or self.many[nodes].any()):
            return
        self.many[nodes] = False
        kept = self.many[self.node]
        node = np.concatenate([self.node[kept], nodes[row]])
        order = np.argsort(node, kind="stable")
        self.node = node[order]
        self.segment = np.concatenate([self.segment[kept], segment])[order]
        self.many[nodes[row]] = True

    def sums(self, key: GlobalInts) -> GlobalInts:
        """Sum of the keys of the segments of nodes with several segments, otherwise 0, ``(n,)``."""
        sums: GlobalInts = np.zeros(len(self.many), dtype=np.int64)
        np.add.at(sums, self.node, key[self.segment])
        return sums

    def entries(self, node: Ints, segment: Ints) -> tuple[Ints, Ints, Array]:
        """All segments of some nodes, node by node.

        Args:
            node: The nodes, shape ``(m,)``.
            segment: Segments of nodes with one segment, shape ``(m,)``.

        Returns:
            Index of the node and segment of each entry, shape ``(i,)``, and offsets of the entries
            of the nodes, shape ``(m + 1,)``.
        """
        first = np.searchsorted(self.node, node)
        counts = np.where(
            self.many[node], np.searchsorted(self.node, node, side="right") - first, 1
        )
        start = np.concatenate([[0], np.cumsum(counts)])
        row = np.repeat(np.arange(len(node), dtype=np.int32), counts)
        several = self.many[node][row]
        found = segment[row]
        place = (first - start[:-1])[row] + np.arange(len(row))
        found[several] = self.segment[place[several]]
        return row, found, start

    def mean(self, values: Floats, start: Array) -> Floats:
        """Mean of values of `entries`, shape ``(i, ...)``, for each node, ``(m, ...)``."""
        counts = np.diff(start).reshape(-1, *(1,) * (values.ndim - 1))
        means: Floats = np.add.reduceat(values, start[:-1]) / counts
        return means


def shared_points(own: Ints, dofs: Ints, segment: Ints, start: Array) -> MortarPoints:
    """Contact points at nodes, one for each of their segments, with equal shares. Local.

    Args:
        own: The nodes, shape ``(m,)``.
        dofs: Node and vertices of the segment of each point, shape ``(i, 1 + k)``.
        segment: The segments, shape ``(i,)``.
        start: Offsets of the points of the nodes, shape ``(m + 1,)``.
    """
    number, counts = np.arange(len(segment), dtype=np.int32), np.diff(start)
    shares = Shares(own, np.ones(len(own)), start, number, 1 / np.repeat(counts, counts))
    ones, none = np.ones((len(segment), 1)), np.zeros(len(segment))
    return MortarPoints(dofs, ones, segment, none, number, shares)
