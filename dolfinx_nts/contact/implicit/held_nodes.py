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
        normal: Direction in which the gap opens, of unit length, shape ``(m, 3)``.
        gap: Gap, shape ``(m,)`` [m].
        force: Normal force in the step, shape ``(m,)`` [N, >= 0].
    """

    node: Ints
    normal: Floats
    gap: Floats
    force: Floats

    @classmethod
    def of(cls, step: ContactStep) -> "HeldNodes":
        """Find those of a solved step. Local."""
        search, active = step.search, step.normal.active
        near = (search.segment >= 0) & (active | search.may_close)
        node = near.nonzero()[0].astype(np.int32)
        points, segment = search.points.take(node), search.segment[node]
        contact = step.candidates.contact("static", points, search.x_n, step.x, segment)
        gradient = contact.gradient[:, :3]
        length = np.linalg.norm(gradient, axis=1)
        some = np.isfinite(contact.gap) & (length > 0) & (active[node] | (contact.gap < 0))
        normal = gradient[some] / length[some, None]
        return cls(node[some], normal, contact.gap[some], -step.normal.lambda_N[node[some]])
