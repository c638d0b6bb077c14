"""Nodes that supports drive into a surface which supports hold: no force can stop them."""

import numpy as np

from dolfinx_nts.common.arrays import Ints
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution

__all__ = ["prescribed_nodes"]

# Distance from where a multiplier wants a node, relative to its segment [-], that is none.
_CLOSED = 1e-9


def prescribed_nodes(step: ContactStep, last: ContactContribution) -> Ints:
    """Find this rank's nodes whose constraint given displacements alone violate. Local.

    Args:
        step: Attempt at a step that failed.
        last: Its last evaluation.

    Returns:
        Their positions among the nodes of the step.
    """
    pairs = last.pairs
    found = pairs.is_given
    if found.any():
        # Not what is closed, also where it is not a number.
        found &= ~(np.abs(pairs.excess[:, 0]) <= _CLOSED * step.candidates.size[pairs.segment])
        found &= last.rank > 0
    node: Ints = pairs.node[found]
    return node
