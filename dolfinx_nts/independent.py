"""Multipliers on a surface that touches itself: which nodes may have one.

Where both sides touch with their nodes there would be twice as many
constraints as there is room for, and a node that gives up its displacement
would be asked for it by another. So no node that may have a multiplier is a
vertex of the segment of another one. All others are held by these: a segment
on which they are, or their own, has a vertex with a multiplier.
"""

import numpy as np
import numpy.typing as npt

from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.neighbourhood import Neighbourhood

__all__ = ["independent"]

Flags = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int32]


def independent(
    here: Neighbourhood,
    surface: Surface,
    segment: Ints,
    candidates: Flags,
    urgency: npt.NDArray[np.int64],
) -> Flags:
    """Nodes of which none is a vertex of the segment of another. Collective.

    Each in turn is taken unless one of those before forbids it: the most
    urgent first, of these the lowest number in the mesh, so that the choice
    does not depend on the partition.

    Args:
        here: Segments in reach.
        surface: The surface.
        segment: Segment of each node or -1, shape ``(n,)``.
        candidates: Nodes that have a segment and may be taken, ``(n,)``.
        urgency: What comes first, shape ``(n,)``.

    Returns:
        Flags, shape ``(n,)``.
    """
    node = np.flatnonzero(candidates)
    dofs = here.dofs(surface.nodes[node], segment[node])
    ids = here.index_map.local_to_global(dofs.ravel()).reshape(dofs.shape)
    order = np.column_stack([-urgency[node], surface.node_ids[node], ids])
    everywhere = np.concatenate(surface.V.mesh.comm.allgather(order))
    everywhere = everywhere[np.lexsort((everywhere[:, 1], everywhere[:, 0]))]
    taken: set[int] = set()
    covered: set[int] = set()  # vertices of the segments of taken nodes
    for first, *vertices in everywhere[:, 2:].tolist():
        if first not in covered and taken.isdisjoint(vertices):
            taken.add(first)
            covered.update(vertices)
    flags: Flags = np.zeros_like(candidates)
    flags[node] = [first in taken for first in ids[:, 0].tolist()]
    return flags
