"""The start of a run: bodies inside rigid obstacles."""

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.node_numbering import listed
from dolfinx_nts.model.obstacles import Obstacle

__all__ = ["check_start"]

# Depth, relative to the size of a facet [-], that is more than round-off.
_DEEP = 1e-6


def check_start(state: PairState, x: Floats) -> None:
    """Raise on all ranks if nodes of a pair lie inside its rigid obstacle. Collective.

    Inside another deformable body they may start, see `OverlapWatch`.

    Args:
        state: State of the contact pair.
        x: Positions of the local nodes of the space, shape ``(l, 3)`` [m].

    Raises:
        ValueError: Nodes are deeper than a millionth of the size of the surface's facets.
    """
    pair = state.pair
    if not isinstance(pair.segments, Obstacle):
        return
    depth, comm = pair.segments.depth(x[pair.nodes.nodes]), pair.nodes.V.mesh.comm
    inside = pair.nodes.node_ids[depth > _DEEP * pair.segment_size]
    nodes = np.sort(np.concatenate(comm.allgather(inside)))
    if not len(nodes):
        return
    deepest = max(comm.allgather(float(np.nanmax(depth, initial=0.0))))
    raise ValueError(
        f"expected bodies outside a {type(pair.segments).__name__}, given {len(nodes)} "
        f"nodes up to {deepest:.3g} inside: {listed(nodes)}"
    )
