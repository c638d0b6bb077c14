"""Nodes of several contact pairs in common arrays."""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats
from dolfinx_nts.contact.pair import ContactPair

__all__ = ["NodesOfPairs"]


class NodesOfPairs:
    """Base class of states with arrays over the nodes of ``c`` pairs, pair by pair. Local.

    Args:
        pairs: The pairs.

    Attributes:
        ends: Offsets of the nodes of each pair, shape ``(c + 1,)``.
        longest_segment: Longest segment of all pairs [m].
        segment_sizes: Longest segment of the pair of each node, shape ``(n,)`` [m].
    """

    def __init__(self, pairs: Sequence[ContactPair]) -> None:
        counts = [len(pair.nodes.nodes) for pair in pairs]
        sizes = [pair.segment_size for pair in pairs]
        self.ends: Array = np.cumsum([0, *counts])
        self.longest_segment = max(sizes)
        self.segment_sizes: Floats = np.repeat(sizes, counts)
