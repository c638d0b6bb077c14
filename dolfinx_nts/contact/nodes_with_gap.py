"""Active nodes with a nonzero gap, as elastic impact preserves the gap at contact."""

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.pair_state import PairState

__all__ = ["nodes_with_gap"]


def nodes_with_gap(state: PairState, x: Floats, gap_tol: float) -> Flags:
    """Flags of active nodes with a gap above ``gap_tol`` in magnitude, ``(n,)``. Collective.

    Args:
        state: State of their contact pair.
        x: Positions of the local nodes of the space, owned and ghost, shape ``(l, 3)`` [m].
        gap_tol: Tolerance of the gap [m].
    """
    law = state.pair.enforcement
    if not (isinstance(law, LagrangeMultiplier) and law.holds_gaps):
        return np.zeros(len(state.nodes.nodes), dtype=bool)
    gap, history = state.gap(x), state.history
    if state.pair.method == "mortar":  # mortar multipliers constrain mean gaps
        gap = np.where(history.active, history.gap, gap)
    # Deeper nodes belong to another side of the body.
    deepest = max(_kernels.DEEPEST * state.pair.segment_size, state.search.initial_depth)
    inside = (gap < 0) & (gap > -deepest)
    flags: Flags = (np.abs(gap) > gap_tol) & (inside | history.active)
    return flags
