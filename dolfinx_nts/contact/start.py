"""The start of a run: bodies that overlap."""

import logging

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.node_numbering import listed
from dolfinx_nts.model.obstacles import Obstacle

__all__ = ["check_start"]

_logger = logging.getLogger("dolfinx_nts")

# Depths that are reported, relative to the size of a segment [-]: meshes of curved surfaces
# overlap by less, and a body and a rigid obstacle not at all but for round-off.
_OVERLAP, _OVERLAP_RIGID = 0.02, 1e-6


def check_start(state: PairState, x: Floats) -> None:
    """Raise on all ranks if nodes lie inside a rigid obstacle. Collective.

    Inside another deformable body they may start, which is only logged: elastic impact holds
    their depth, plastic impact and springs push them out.

    Args:
        state: State of the contact pair.
        x: Positions of the local nodes of the space, shape ``(l, 3)`` [m].

    Raises:
        ValueError: Nodes are deeper than a millionth of the size of the surface's facets.
    """
    pair, depth = state.pair, -state.gap(x)
    rigid = isinstance(pair.segments, Obstacle)
    comm = pair.nodes.V.mesh.comm
    allowed = (_OVERLAP_RIGID if rigid else _OVERLAP) * pair.segment_size
    nodes = np.sort(np.concatenate(comm.allgather(pair.nodes.node_ids[depth > allowed])))
    if not len(nodes):
        return
    deepest = max(comm.allgather(float(np.nanmax(depth, initial=0.0))))
    where = listed(nodes)
    if rigid:
        raise ValueError(
            f"expected bodies outside a {type(pair.segments).__name__}, given {len(nodes)} "
            f"nodes up to {deepest:.3g} inside: {where}"
        )
    if comm.rank == 0:
        _logger.warning("%d nodes start up to %.3g inside: %s", len(nodes), deepest, where)
