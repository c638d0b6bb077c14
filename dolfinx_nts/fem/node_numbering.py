"""Numbers and reference positions of the nodes of a space, computed once per space.

The numbers do not depend on the partition of the mesh. A vertex keeps its number in the input mesh.
Any other node is the midpoint of an edge, a face or a cell. Its number is composed of two vertex
numbers: the smallest one of the edge, face or cell, and the number of the opposite vertex.
"""

import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from dolfinx import fem

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import Floats, GlobalInts
from dolfinx_nts.fem.elements import Element

__all__ = ["geometry_unchanged", "input_ids", "listed", "reference_positions"]

# Bits of the number of a vertex [-]; two numbers fill the 64 bits of a node's number.
_BITS = 31
# Largest number of nodes in a message [-].
_MOST = 5


class _Positions(NamedTuple):
    """Coordinates of the geometry of a mesh, and the positions computed from them [m]."""

    geometry: Floats
    nodes: Floats


# Caches by the `id` of a space, as spaces cannot be hashed. An entry is deleted with its space.
_IDS: dict[int, GlobalInts] = {}
_POSITIONS: dict[int, _Positions] = {}
# Spaces already compared with the geometry of their mesh in the current `geometry_unchanged`, and
# nesting depth of these contexts.
_UNCHANGED: set[int] = set()
_num_contexts = 0


def input_ids(V: fem.FunctionSpace) -> GlobalInts:
    """Number every local node of a space independently of the partition. Local.

    Args:
        V: Space on the mesh.

    Returns:
        Numbers, a read-only array of shape ``(l,)``: for a vertex its number in the input mesh, for
        a midpoint between the vertices a < b :math:`2^{31} (a + 1) + b`.
    """
    known = _IDS.get(id(V))
    if known is None:
        known = _IDS[id(V)] = _input_ids(V)
        known.flags.writeable = False
        weakref.finalize(V, _IDS.pop, id(V))
    return known


def reference_positions(V: fem.FunctionSpace) -> Floats:
    """Reference positions of all local nodes of a space. Local.

    They are computed again when the geometry of the mesh has changed, see also
    `geometry_unchanged`.

    Args:
        V: Space on the mesh.

    Returns:
        Positions, owned and ghost, a read-only array of shape ``(l, 3)`` [m].
    """
    known = _POSITIONS.get(id(V))
    if known is not None and id(V) in _UNCHANGED:
        return known.nodes
    geometry = V.mesh.geometry.x
    if known is None or not np.array_equal(known.geometry, geometry):
        if known is None:
            weakref.finalize(V, _forget_positions, id(V))
        known = _Positions(geometry.copy(), V.tabulate_dof_coordinates())
        known.nodes.flags.writeable = False
        _POSITIONS[id(V)] = known
    if _num_contexts:
        _UNCHANGED.add(id(V))
    return known.nodes


@contextmanager
def geometry_unchanged() -> Iterator[None]:
    """Context in which no mesh geometry changes, for a set-up that needs positions often. Local.

    In the context each space is compared with the geometry of its mesh only once. Otherwise the
    set-up of n bodies would compare all nodes n times.
    """
    global _num_contexts
    _num_contexts += 1
    try:
        yield
    finally:
        _num_contexts -= 1
        if not _num_contexts:
            _UNCHANGED.clear()


def _forget_positions(space: int) -> None:
    _POSITIONS.pop(space)
    _UNCHANGED.discard(space)


def _input_ids(V: fem.FunctionSpace) -> GlobalInts:
    geometry = V.mesh.geometry
    vertices = geometry.input_global_indices[compat.geometry_nodes(V.mesh)]
    element = Element.of(V)
    number = np.empty((len(vertices), len(element.points)), dtype=np.int64)
    for node, pairs in enumerate(element.diagonals):
        ends = vertices[:, pairs]  # (c, diagonals, 2)
        ends = np.sort(ends, axis=2)
        least = ends[np.arange(len(ends)), ends[:, :, 0].argmin(axis=1)]
        a, b = least.T
        number[:, node] = np.where(a == b, b, ((a + 1) << _BITS) + b)
    ids = np.empty(len(reference_positions(V)), dtype=np.int64)
    ids[V.dofmap.list] = number
    return ids


def listed(nodes: GlobalInts) -> str:
    """Text with the numbers of some nodes for messages; of many nodes the first ones. Local.

    Args:
        nodes: Node numbers from `input_ids`.

    Returns:
        Numbers separated by commas, ``12`` for a vertex and ``12-13`` for a midpoint.
    """
    names = []
    for node in nodes[:_MOST]:
        end, other = divmod(int(node), 1 << _BITS)
        names.append(f"{end - 1}-{other}" if end else str(other))
    return ", ".join(names) + (", ..." if len(nodes) > _MOST else "")
