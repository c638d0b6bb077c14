"""Sums over all ranks at a few nodes, at a cost independent of the size of the space.

With a new DOLFINx vector for each body and each surface, time and memory of the set-up of n bodies
of equal size would grow as n^2.
"""

import weakref

import numpy as np
from dolfinx import fem, la

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import Floats, Ints

__all__ = ["nodes_on_any_rank", "sums_at"]


class _Sums:
    """Vector that is zero at all local nodes, except while sums are computed.

    Collective, as are its methods.

    Args:
        V: The space.
        width: Number of values of each node.
    """

    def __init__(self, V: fem.FunctionSpace, width: int) -> None:
        index_map = V.dofmap.index_map
        self._vector = la.vector(index_map, width)
        self._values: Floats = self._vector.array.reshape(-1, width)
        n, num_ghosts = index_map.size_local, index_map.num_ghosts
        # Nodes that are shared with other ranks.
        ghosts = np.arange(n, n + num_ghosts, dtype=np.int32)
        self._outer: Ints = np.concatenate([compat.shared(index_map), ghosts])

    def at(self, nodes: Ints, values: Floats, wanted: Ints | None) -> tuple[Ints, Floats]:
        """Sums at the wanted nodes; None for all nodes at which sums may differ from zero."""
        np.add.at(self._values, nodes, values)
        self._vector.scatter_reverse(la.InsertMode.add)
        self._vector.scatter_forward()
        changed: Ints = np.union1d(nodes, self._outer).astype(np.int32)
        wanted = changed if wanted is None else wanted
        sums: Floats = self._values[wanted]
        self._values[changed] = 0.0
        return wanted, sums


# Cache by the `id` of a space, as spaces cannot be hashed, and number of values. An entry is
# deleted with its space.
_KNOWN: dict[int, dict[int, _Sums]] = {}


def nodes_on_any_rank(V: fem.FunctionSpace, nodes: Ints) -> Ints:
    """Local nodes that are given on at least one rank. Collective.

    Args:
        V: The space.
        nodes: Local block indices, owned or ghost, of any shape.

    Returns:
        Local nodes, owned or ghost, that this or another rank has given, sorted, shape ``(n,)``.
    """
    found, count = _sums(V, 1).at(nodes.ravel(), np.ones((nodes.size, 1)), None)
    return found[count[:, 0] > 0]


def sums_at(V: fem.FunctionSpace, wanted: Ints, nodes: Ints, values: Floats) -> Floats:
    """Sums over all ranks of values at nodes. Collective.

    Args:
        V: The space.
        wanted: Local nodes whose sums are returned, shape ``(n,)``.
        nodes: Local block indices, owned or ghost, which may be repeated, shape ``(m,)``.
        values: Values that are added at these nodes, shape ``(m, d)``.

    Returns:
        Sums at the wanted nodes, shape ``(n, d)``.
    """
    return _sums(V, values.shape[1]).at(nodes, values, wanted)[1]


def _sums(V: fem.FunctionSpace, width: int) -> _Sums:
    """Cached vector of a space with a number of values per node. Collective."""
    if id(V) not in _KNOWN:
        _KNOWN[id(V)] = {}
        weakref.finalize(V, _KNOWN.pop, id(V))
    known = _KNOWN[id(V)]
    if width not in known:
        known[width] = _Sums(V, width)
    return known[width]
