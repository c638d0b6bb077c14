"""Active nodes at the end of a step."""

from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints, indices
from dolfinx_nts.contact.implicit.contact_step import ContactStep

__all__ = ["ActiveNodes"]


class ActiveNodes(NamedTuple):
    """Nodes of a pair that transmit force or penetrate their segments.

    Attributes:
        node: Indices among the nodes of the surface, shape ``(m,)``.
        dofs: Nodes on which gaps depend, numbered as in the map of the scatter, shape ``(m, k)``.
        gradients: Gradients of gap and slip with respect to these nodes, shape ``(m, 3, 3 k)``.
        gap: Gap, shape ``(m,)`` [m].
        force: Normal force in the step, shape ``(m,)`` [N, >= 0].
        traction: Traction in the step, in the directions of slip, shape ``(m, 2)`` [N].
        sticks: Flags of sticking nodes, shape ``(m,)``.
        pushes: Normal forces on all nodes of the surface, shape ``(n, 3)`` [N].
    """

    node: Ints
    dofs: Ints
    gradients: Floats
    gap: Floats
    force: Floats
    traction: Floats
    sticks: Flags
    pushes: Floats

    @classmethod
    def of(cls, step: ContactStep) -> "ActiveNodes":
        """Active nodes of a solved step. Local."""
        search, active = step.search, step.normal.active
        near = (search.segment >= 0) & (active | search.may_close)
        node = indices(near)
        pairs = search.pairing.kinematics("static", step.x, node, search.segment[node], None)
        step.friction.measure(pairs, step.x)
        gap, gradients = pairs.contact.gap, pairs.gradients
        some = np.isfinite(gap) & np.any(gradients[:, 0] != 0, axis=1)
        some &= active[node] | (gap < 0)
        forces = np.where(some, -step.normal.lambda_N[node], 0.0)
        pushes = search.pairing.on_nodes(pairs, forces[:, None] * gradients[:, 0])
        node = node[some]
        return cls(
            node,
            pairs.dofs[some],
            gradients[some],
            gap[some],
            -step.normal.lambda_N[node],
            step.friction.traction[node],
            step.friction.sticks(node, active[node]),
            pushes,
        )
