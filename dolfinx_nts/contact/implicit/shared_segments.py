"""Evaluation of nodes that are equally near to several segments, see `SharedSegments`.

Each gap is invariant under rigid motions and has a discrete gradient, so a mean of gaps conserves
energy and momenta exactly, too. The segments of a node change only between steps, or with its
candidate segment.
"""

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.implicit.pair_blocks import OwnBlocks
from dolfinx_nts.search.mortar.mortar_points import MortarPoints

__all__ = ["SharedBlocks"]


class SharedBlocks(OwnBlocks):
    """Tangent blocks of nodes with several segments: one block for each segment of a node.

    Args:
        points: Points of the nodes on their segments, see `search/shared_segments.py`.
        dofs: Nodes of the rows, shape ``(m, d)``.
        unknown: 1 where the displacement is unknown, otherwise 0, for the rows, ``(m, 3 d)``, and
            for the points, ``(i, 3 (1 + k))``; None if all are unknown.
        tangent: Derivative of the forces of the points, ``(i, 3 (1 + k), 3 (1 + k))`` [1/m].
    """

    def __init__(
        self,
        points: MortarPoints,
        dofs: Ints,
        unknown: tuple[Floats, Floats] | None,
        tangent: Floats,
    ) -> None:
        """Store the blocks, one for each segment of a node."""
        super().__init__(dofs, None if unknown is None else unknown[0], tangent)
        self.nodes, self._points = points.reached, points
        self._of_points = None if unknown is None else unknown[1]

    def tangent(self, lambda_N: Floats) -> Floats:
        factor = self._points.shares.spread(lambda_N, len(self.nodes))
        blocks: Floats = factor[:, None, None] * self._tangent
        return blocks

    def of(self, active: Flags) -> Ints:
        shares = self._points.shares
        return shares.point[active[shares.node]]

    def restrict(self, force: Floats, tangent: Floats) -> Floats:
        if self._free is None or self._of_points is None:
            return force
        tangent *= self._of_points[:, :, None] * self._of_points[:, None, :]
        return force * self._free
