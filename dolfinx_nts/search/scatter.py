"""Exchange of nodal values between ranks for the candidates of one search."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from dolfinx import common, la

from dolfinx_nts import _kernels, compat
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.parallel import reductions

__all__ = ["NodalScatter", "joint_scatter"]


class NodalScatter:
    """Exchange of nodal values between owners and ghosts.

    All methods are collective, and local if `is_local`. Values have the shape ``(..., d)`` with d
    up to 3. Only values of shared nodes are copied, since a contact has few of them.

    Args:
        index_map: Owned nodes of the space, then the ghosts needed by the segments of this rank.

    Attributes:
        index_map: The argument.
        is_local: Whether no rank has ghosts.
        shared: Owned nodes that are ghosts of other ranks.
    """

    def __init__(self, index_map: common.IndexMap) -> None:
        self.index_map = index_map
        self._num_owned: int = index_map.size_local
        self._num_ghosts: int = index_map.num_ghosts
        self.is_local = not reductions.anywhere(index_map.comm, index_map.num_ghosts > 0)
        self.shared: Ints = compat.shared(index_map)

    @cached_property
    def _vector(self) -> Any:
        """Vector for the exchange, created on demand."""
        return la.vector(self.index_map, 3)

    @cached_property
    def _values(self) -> Floats:
        """Cached values of the vector, as access to the array of a DOLFINx vector is slow."""
        values: Floats = self._vector.array.reshape(-1, 3)
        return values

    @property
    def num_local(self) -> int:
        """Number of owned nodes and ghosts. Local."""
        return self._num_owned + self._num_ghosts

    def global_nodes(self, nodes: Ints) -> Any:
        """Global numbers of local nodes, of the same shape. Local."""
        if self.index_map.size_local == self.index_map.size_global:
            return nodes
        return np.asarray(self.index_map.local_to_global(nodes.ravel())).reshape(nodes.shape)

    def forward(self, values: Floats) -> Floats:
        """Values at all nodes of the map, shape ``(l, 3)``; a view if `is_local`.

        The first rows of ``values`` are the values of the owned nodes.
        """
        owned = values[: self._num_owned]
        return owned if self.is_local else np.concatenate([owned, self.at_ghosts(owned)])

    def reverse(self, values: Floats) -> Floats:
        """Sums at owned nodes, ``(n, 3)``, of values of all ranks at local nodes, ``(l, 3)``."""
        if self.is_local:
            return values
        sums = values[: self._num_owned].copy()
        self.add_of_ghosts(sums, values[self._num_owned :])
        return sums

    def add(self, total: Floats, nodes: Ints, values: Floats) -> None:
        """Add values at nodes of the map on all ranks to the values of owned nodes.

        Args:
            total: Values of the owned nodes, shape ``(n, 3)``, changed in place.
            nodes: Nodes of the map, of any shape.
            values: Values, shape ``(*nodes.shape, 3)``.
        """
        ghosts = self.no_values(3)
        _kernels.add_rows(total, ghosts, nodes, values)
        self.add_of_ghosts(total, ghosts)

    def no_values(self, d: int) -> Floats:
        """Array of zeros for the ghosts, shape ``(g, d)``. Local."""
        return np.zeros((self._num_ghosts, d))

    def at_ghosts(self, values: Floats) -> Floats:
        """Values at the ghosts, shape ``(g, d)``, from values at the owned nodes, ``(n, d)``."""
        d = values.shape[1]
        if self.is_local:
            return self.no_values(d)
        self._values[self.shared, :d] = values.take(self.shared, axis=0)
        self._vector.scatter_forward()
        return self._values[self._num_owned :, :d].copy()

    def add_of_ghosts(self, total: Floats, ghosts: Floats) -> None:
        """Add ghost values of all ranks, ``(g, d)``, to ``total`` of owned nodes, ``(n, d)``."""
        if self.is_local:
            return
        d = total.shape[1]
        self._values[self.shared] = 0.0
        self._values[self._num_owned :, :d] = ghosts
        self._vector.scatter_reverse(la.InsertMode.add)
        total[self.shared] += self._values[self.shared, :d]


def joint_scatter(scatters: Sequence[NodalScatter]) -> tuple[NodalScatter, list[Ints | None]]:
    """Scatter with the ghosts of several scatters. Collective.

    Args:
        scatters: Scatters with the same owned nodes.

    Returns:
        The joint scatter, and for each given scatter the numbers of its nodes in the joint map,
        None if they are the same.
    """
    first = scatters[0]
    if all(scatter.is_local for scatter in scatters):
        return first, [None] * len(scatters)
    maps = [scatter.index_map for scatter in scatters]
    num_owned = first.index_map.size_local
    ghosts, place = np.unique(np.concatenate([m.ghosts for m in maps]), return_index=True)
    owners = np.concatenate([m.owners for m in maps])[place]
    joint = compat.index_map(first.index_map.comm, num_owned, ghosts, owners)
    own = np.arange(num_owned, dtype=np.int32)
    rows: list[Ints | None] = [
        np.concatenate([own, num_owned + np.searchsorted(ghosts, m.ghosts)]).astype(np.int32)
        for m in maps
    ]
    return NodalScatter(joint), rows
