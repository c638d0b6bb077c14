"""Limits of friction that stay as they are while nodes change between stick and slip."""

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints

__all__ = ["LaggedLimit"]


class LaggedLimit:
    """Pressing forces by which friction is limited, of now or of an earlier iteration. Local.

    With Coulomb's limit mu p, which changes as nodes slide, the choice between stick and slip is
    no problem with a positive matrix: a node may contradict stick and both ways of slip while
    another one slides, though there is a solution with that one sticking, and changing one node
    at a time goes round in a circle. With a given limit (Tresca) it is the minimum of a convex
    energy, and such changes end. So limits lag where nodes change one at a time, until none
    contradicts its state; with the limits of then it begins anew (fixed point of J. Haslinger,
    Math. Methods Appl. Sci. 5 (1983)). No solution is accepted with a limit that lags.

    Args:
        num_nodes: Number ``n`` of nodes.

    Attributes:
        heading: Direction of the traction times mu, also where its limit lags, shape ``(n, 2)``.
    """

    def __init__(self, num_nodes: int) -> None:
        self._p: Floats = np.zeros(num_nodes)
        self.heading: Floats = np.zeros((num_nodes, 2))

    def pressing(self, node: Ints, p: Floats, lags: Flags | None) -> Floats:
        """Forces that limit friction, shape ``(m,)`` [N].

        Args:
            node: Positions of ``m`` nodes among all.
            p: What presses them now, shape ``(m,)`` [N].
            lags: Whose limits lag now, shape ``(m,)``: such a force is that of the last iteration
                in which they did not, or of the first in which something pressed the node.
                None if none does.
        """
        if lags is None:
            self._p[node] = np.maximum(p, 0.0)
            return p
        stays = lags & (self._p[node] > 0)
        self._p[node] = np.where(stays, self._p[node], np.maximum(p, 0.0))
        limiting: Floats = np.where(lags, self._p[node], p)
        return limiting
