"""Contact points: the material points of a surface that look for segments.

The position of a contact point is a constant linear combination of nodal positions.
Node-to-segment contact has one point at each node, with weight one. Kernels see points and
segments only; what they return is then summed up for the nodes that carry the multipliers.
Mortar contact has points of its own, see `mortar_points`.
"""

from typing import Protocol

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.facing import Facing

__all__ = ["ContactPoints", "NodalPoints"]


class ContactPoints(Protocol):
    """Material points whose positions are linear in those of the nodes. Local.

    ``p`` is the number of points.
    """

    @property
    def facing(self) -> Facing:
        """What the points may touch."""

    @property
    def nodes(self) -> Ints:
        """Local node that each point is, -1 within a facet, shape ``(p,)``."""

    def of(self, values: Floats) -> Floats:
        """Evaluate a nodal field, shape ``(l, 3)``, at the points, shape ``(p, 3)``."""

    def take(self, nodes: Ints) -> "ContactPoints":
        """Select the points of some nodes, by their positions among those with multipliers."""


class NodalPoints:
    """One contact point at each node: node-to-segment contact, see `ContactPoints`. Local.

    Args:
        nodes: Local nodes, shape ``(n,)``.
        facing: What they may touch; None: anything.

    Attributes:
        nodes, facing: The arguments.
    """

    def __init__(self, nodes: Ints, facing: Facing | None = None) -> None:
        self.nodes: Ints = nodes
        self.facing: Facing = Facing.everywhere(len(nodes)) if facing is None else facing
        # The last selection: an iterate asks for the same nodes again and again.
        self._taken: tuple[Ints, NodalPoints] | None = None

    def of(self, values: Floats) -> Floats:
        return values.take(self.nodes, axis=0)

    def take(self, nodes: Ints) -> "NodalPoints":
        if self._taken is None or self._taken[0] is not nodes:
            self._taken = nodes, NodalPoints(self.nodes[nodes], self.facing.take(nodes))
        return self._taken[1]

    def dofs(self, vertices: Ints) -> Ints:
        """Each node and the vertices of its segment, ``(n, k)``, as nodes of pairs ``(n, 1+k)``."""
        dofs = np.empty((len(vertices), 1 + vertices.shape[1]), dtype=np.int32)
        dofs[:, 0], dofs[:, 1:] = self.nodes, vertices
        return dofs
