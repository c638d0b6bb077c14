"""Violated constraints with prescribed displacements only, which no contact force can satisfy."""

import numpy as np

from dolfinx_nts.common.arrays import Ints
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution

__all__ = ["prescribed_nodes"]

# Violation relative to the segment [-] that counts as zero.
_CLOSED = 1e-9


def prescribed_nodes(step: ContactStep, last: ContactContribution) -> Ints:
    """Nodes of this rank with constraints violated by prescribed displacements alone. Local.

    Args:
        step: Contact of a failed step.
        last: Its last evaluation.

    Returns:
        Indices among the nodes of the step.
    """
    pairs = last.pairs
    found = pairs.is_prescribed
    if found.any():
        # Negated, to include NaN.
        found &= ~(np.abs(pairs.excess[:, 0]) <= _CLOSED * step.candidates.size[pairs.segment])
        found &= last.rank > 0
    node: Ints = pairs.node[found]
    return node
