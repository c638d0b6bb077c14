"""Numbers of nodes that do not depend on the partition of the mesh.

A vertex has its number in the mesh as read. Any other node is the middle of an edge, a face or
a cell. Its number is made of those of two vertices between which it lies: the least vertex of
the edge, face or cell, and the opposite one.
"""

import numpy as np
from dolfinx import fem

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import GlobalInts
from dolfinx_nts.fem.elements import Element

__all__ = ["input_ids", "listed"]

# Bits of the number of a vertex [-]; two numbers fill the 64 bits of a node's number.
_BITS = 31
# Most numbers that a message lists [-].
_MOST = 5


def input_ids(V: fem.FunctionSpace) -> GlobalInts:
    """Number every local node of a space independently of the partition. Local.

    Args:
        V: Space on the mesh.

    Returns:
        Numbers, shape ``(l,)``: of a vertex that in the mesh as read, of the middle between
        vertices a < b :math:`2^{31} (a + 1) + b`.
    """
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
    ids = np.empty(len(V.tabulate_dof_coordinates()), dtype=np.int64)
    ids[V.dofmap.list] = number
    return ids


def listed(nodes: GlobalInts) -> str:
    """Text for messages that lists the first of some nodes. Local.

    Args:
        nodes: Numbers of nodes, as `input_ids` makes them.

    Returns:
        Numbers with commas, ``12`` for a vertex and ``12-13`` for the middle between two.
    """
    names = []
    for node in nodes[:_MOST]:
        end, other = divmod(int(node), 1 << _BITS)
        names.append(f"{end - 1}-{other}" if end else str(other))
    return ", ".join(names) + (", ..." if len(nodes) > _MOST else "")
