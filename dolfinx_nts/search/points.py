"""Contact points: material points of a surface that are projected on segments.

The position of a contact point is a constant linear combination of nodal positions.
Node-to-segment contact has one point at each node, with weight one; for mortar contact see
`mortar_points`. Kernels work on points and segments. Their results are then summed for the nodes
that carry the multipliers.
"""

from typing import Protocol

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.obstacles.facing import Facing

__all__ = ["ContactPoints", "NodalPoints"]


class ContactPoints(Protocol):
    """Material points whose positions are linear in the nodal positions. Local.

    ``p`` is the number of points.
    """

    @property
    def facing(self) -> Facing:
        """Admissible directions of contact of the points."""

    @property
    def nodes(self) -> Ints:
        """Local node at each point, -1 for points within a facet, shape ``(p,)``."""

    def of(self, values: Floats) -> Floats:
        """Evaluate a nodal field, shape ``(l, 3)``, at the points, shape ``(p, 3)``."""

    def take(self, nodes: Ints) -> "ContactPoints":
        """Select the points of nodes, by indices among the nodes with multipliers."""


class NodalPoints:
    """One contact point at each node: node-to-segment contact, see `ContactPoints`. Local.

    Args:
        nodes: Local nodes, shape ``(n,)``.
        facing: Admissible directions of contact; None for any.

    Attributes:
        nodes, facing: The arguments.
    """

    def __init__(self, nodes: Ints, facing: Facing | None = None) -> None:
        self.nodes: Ints = nodes
        self.facing: Facing = Facing.everywhere(len(nodes)) if facing is None else facing
        # Cache of the last selection, which is often repeated.
        self._taken: tuple[Ints, NodalPoints] | None = None

    def of(self, values: Floats) -> Floats:
        return values.take(self.nodes, axis=0)

    def take(self, nodes: Ints) -> "NodalPoints":
        if self._taken is None or self._taken[0] is not nodes:
            self._taken = nodes, NodalPoints(self.nodes[nodes], self.facing.take(nodes))
        return self._taken[1]

    def dofs(self, vertices: Ints) -> Ints:
        """Each node, then the ``vertices`` of its segment, ``(n, k)``; shape ``(n, 1 + k)``."""
        dofs = np.empty((len(vertices), 1 + vertices.shape[1]), dtype=np.int32)
        dofs[:, 0], dofs[:, 1:] = self.nodes, vertices
        return dofs
