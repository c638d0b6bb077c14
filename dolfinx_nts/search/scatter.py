"""Carries values of nodes between the ranks, for the candidates of one search."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from dolfinx import common, la

from dolfinx_nts import _kernels, compat
from dolfinx_nts.common.arrays import Floats, Ints

__all__ = ["NodalScatter", "joint_scatter"]


class NodalScatter:
    """Sends values of nodes from owners to ghosts and back.

    Methods are collective, and local if `is_local`.

    Args:
        index_map: Owned nodes of the space, then the ghosts that segments on this rank need.
        is_local: Whether no rank needs anything of another.

    Attributes:
        index_map, is_local: The arguments.
        vector: Carries values of nodes between ranks, shape ``(3 l,)``.
        shared: Owned nodes that are ghosts of other ranks.
    """

    def __init__(self, index_map: common.IndexMap, *, is_local: bool) -> None:
        """Allocate the vector that carries values between ranks."""
        self.index_map, self.is_local = index_map, is_local
        self.vector: Any = la.vector(index_map, 3)
        self.shared: Ints = compat.shared(index_map)

    @property
    def num_local(self) -> int:
        """Number of owned nodes and ghosts. Local."""
        return int(self.index_map.size_local + self.index_map.num_ghosts)

    def global_nodes(self, nodes: Ints) -> Any:
        """Global numbers of local nodes, of the same shape. Local."""
        if self.index_map.size_local == self.index_map.size_global:
            return nodes
        return np.asarray(self.index_map.local_to_global(nodes.ravel())).reshape(nodes.shape)

    def forward(self, values: Floats) -> Floats:
        """Send values of the owned nodes, the first rows of ``values``, to the ghosts.

        Returns values at all nodes of the map, shape ``(l, 3)``; a view if `is_local`.
        """
        owned = values[: self.index_map.size_local]
        if self.is_local:
            return owned
        self.vector.array[: owned.size] = owned.ravel()
        self.vector.scatter_forward()
        everywhere: Floats = self.vector.array.reshape(-1, 3).copy()
        return everywhere

    def reverse(self, values: Floats) -> Floats:
        """Sum at owned nodes, ``(n, 3)``, what all ranks have at nodes of the map, ``(l, 3)``."""
        if self.is_local:
            return values
        self.vector.array[:] = values.ravel()
        self.vector.scatter_reverse(la.InsertMode.add)
        sums: Floats = self.vector.array.reshape(-1, 3)[: self.index_map.size_local].copy()
        return sums

    def add(self, total: Floats, nodes: Ints, values: Floats) -> None:
        """Add values of some nodes, also of other ranks, to those of the owned nodes.

        ``total`` are the values at the owned nodes, shape ``(n, 3)``, changed; ``nodes`` are
        nodes of the map, of any shape, and values have the shape ``(*nodes.shape, 3)``.
        """
        if self.is_local:
            _kernels.add_rows(total, nodes, values)
            return
        sums = self.vector.array.reshape(-1, 3)
        sums[:] = 0
        _kernels.add_rows(sums, nodes, values)
        self.vector.scatter_reverse(la.InsertMode.add)
        total += sums[: len(total)]


def joint_scatter(scatters: Sequence[NodalScatter]) -> tuple[NodalScatter, list[Ints | None]]:
    """Map with the ghosts of several, and the nodes of each in it. Collective.

    Args:
        scatters: They have the same owned nodes.

    Returns:
        The map, and the numbers in it of the nodes of each, None where they are the same.
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
    return NodalScatter(joint, is_local=False), rows
