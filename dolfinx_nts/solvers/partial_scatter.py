"""Exchange of the few values of a nodal vector that contacts need."""

import numpy as np
from dolfinx import la

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["PartialScatter"]


class PartialScatter:
    """Takes values at some nodes from a nodal vector, and puts them into it.

    Only values that these nodes or other ranks need are touched. Vectors are
    over the owned nodes, shape ``(n, d)``, parts over these nodes, ``(m, d)``, d up to 3.

    Args:
        scatter: Brings values of nodes to this rank.
        nodes: Numbers in its index map, ascending, shape ``(m,)``.
    """

    def __init__(self, scatter: NodalScatter, nodes: Ints) -> None:
        """Create the lists of owned nodes and of ghosts."""
        self._scatter, self._num_nodes = scatter, len(nodes)
        self._num_owned = int(np.searchsorted(nodes, scatter.index_map.size_local))
        self._owned, self._ghosts = np.split(nodes, [self._num_owned])

    def take(self, x: Floats) -> Floats:
        """Part of a vector. Collective."""
        shared, values = self._scatter.shared, self._values[:, : x.shape[1]]
        values[shared] = x[shared]
        self._scatter.vector.scatter_forward()
        return np.concatenate([x[self._owned], values[self._ghosts]])

    def owned(self, y: Floats) -> Floats:
        """Part of a vector, with zeros at ghosts. Local."""
        part = np.zeros((self._num_nodes, y.shape[1]))
        part[: self._num_owned] = y[self._owned]
        return part

    def put(self, part: Floats, y: Floats) -> None:
        """Set a vector at owned nodes to a part, and add the values of ghosts. Collective."""
        y[self._owned], ghosts = np.split(part, [self._num_owned])
        shared, values = self._scatter.shared, self._values[:, : y.shape[1]]
        values[shared] = values[self._scatter.index_map.size_local :] = 0.0
        values[self._ghosts] = ghosts
        self._scatter.vector.scatter_reverse(la.InsertMode.add)
        y[shared] += values[shared]

    @property
    def _values(self) -> Floats:
        values: Floats = self._scatter.vector.array.reshape(-1, 3)
        return values
