"""Nodes that contact holds at the end of a step."""

from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.implicit.contact_step import ContactStep

__all__ = ["HeldNodes"]


class HeldNodes(NamedTuple):
    """Nodes of a pair that transmit force, or are inside what they face.

    Attributes:
        node: Positions among the nodes of the surface, shape ``(m,)``.
        dofs: Nodes on which gaps depend, in the map of the candidates' scatter, ``(m, k)``.
        gradient: Gradients of the gaps by these, shape ``(m, 3 k)``.
        gap: Gap, shape ``(m,)`` [m].
        force: Normal force in the step, shape ``(m,)`` [N, >= 0].
    """

    node: Ints
    dofs: Ints
    gradient: Floats
    gap: Floats
    force: Floats

    @classmethod
    def of(cls, step: ContactStep) -> "HeldNodes":
        """Find those of a solved step. Local."""
        search, active = step.search, step.normal.active
        near = (search.segment >= 0) & (active | search.may_close)
        node = near.nonzero()[0].astype(np.int32)
        pairs = search.pairing.kinematics("static", step.x, node, search.segment[node], None)
        gap, gradient = pairs.contact.gap, pairs.contact.gradient
        some = np.isfinite(gap) & np.any(gradient != 0, axis=1) & (active[node] | (gap < 0))
        force = -step.normal.lambda_N[node[some]]
        return cls(node[some], pairs.dofs[some], gradient[some], gap[some], force)
