"""Lagged friction limits while nodes change between stick and slip."""

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints

__all__ = ["LaggedLimit"]


class LaggedLimit:
    """Normal forces of the current or of an earlier iteration that limit friction. Local.

    Coulomb's limit mu p depends on the solution, so that the stick-slip problem is not a convex
    minimisation, and single changes may cycle. With a given limit (Tresca friction) it is convex,
    and single changes terminate. Limits therefore lag while nodes change one at a time, until no
    condition is violated, and are then updated (fixed point of J. Haslinger, Math. Methods Appl.
    Sci. 5 (1983)). No solution with a lagged limit is accepted.

    Args:
        num_nodes: Number ``n`` of nodes.

    Attributes:
        heading: Direction of the traction times the derivative of its limit with respect to the
            normal force, including nodes with a lagged limit, shape ``(n, 2)``.
        last: Normal forces of the last friction limits, shape ``(n,)`` [N, >= 0].
    """

    def __init__(self, num_nodes: int) -> None:
        self.last: Floats = np.zeros(num_nodes)
        self.heading: Floats = np.zeros((num_nodes, 2))

    def normal_forces(self, node: Ints, p: Floats, lags: Flags | None) -> Floats:
        """Normal forces that limit friction, shape ``(m,)`` [N].

        Args:
            node: Indices of ``m`` nodes among all.
            p: Current normal forces, shape ``(m,)`` [N].
            lags: Flags of nodes with a lagged limit, shape ``(m,)``, or None. It uses the normal
                force of the last iteration without lag, or the first normal force that is not zero.
        """
        if lags is None:
            self.last[node] = np.maximum(p, 0.0)
            return p
        stays = lags & (self.last[node] > 0)
        self.last[node] = np.where(stays, self.last[node], np.maximum(p, 0.0))
        limiting: Floats = np.where(lags, self.last[node], p)
        return limiting
