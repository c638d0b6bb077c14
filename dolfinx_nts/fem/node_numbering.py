"""Numbers of nodes that do not depend on the partition of the mesh.

A vertex has its number in the mesh as read. Any other node is the middle of
an edge, a face or a cell, and is called by the numbers of its two ends: the
least vertex of the edge, face or cell and the one opposite.
"""

import numpy as np
from dolfinx import fem

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import GlobalInts
from dolfinx_nts.fem.elements import Element

__all__ = ["input_ids", "listed"]


_BITS = 31  # of the number of a vertex


def input_ids(V: fem.FunctionSpace) -> GlobalInts:
    """Number of every local node of V: of a vertex as read.

    Shape ``(l,)``; of the middle between vertices a < b it is
    :math:`2^{31} (a + 1) + b`.
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
    """The first of some nodes, as ``12`` or, in the middle of two, ``12-13``."""
    names = []
    for node in nodes[:5]:
        end, other = divmod(int(node), 1 << _BITS)
        names.append(f"{end - 1}-{other}" if end else str(other))
    return ", ".join(names) + (", ..." if len(nodes) > 5 else "")
