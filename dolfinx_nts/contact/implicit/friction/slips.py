"""Slips of the nodes of a pair in one attempt at a step, more accurate than positions.

Round-off of positions changes the direction of small slips: with a slip of 1e-10 m and forces of 10
N, friction changes by 1e-5 N. Slip increments of linear systems do not have this round-off.
"""

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.normal.active_set import ROUNDING
from dolfinx_nts.contact.implicit.normal.linear_values import LinearValues
from dolfinx_nts.model.frames import Frame

__all__ = ["Slips", "length_of", "with_length"]

# Slip relative to the size of a segment [-] that counts as zero at nodes that cannot be eliminated:
# if a rigid body sticks at redundant points, not all slips can be zero to round-off. It is as small
# as admissible violations of constraints.
_STILL = 1e-11


class Slips:
    """Slips in the frames of the segments at t_n. Local.

    Args:
        size: Size of the segments of each node, shape ``(n,)`` [m].
        frame: Frame of the segments, for springs in statics, whose slips are linearly extrapolated
            (`LinearValues`); otherwise None.

    Attributes:
        present: Slips in the last evaluation, 0 in place of round-off, shape ``(n, 2)`` [m].
        modelled: Slips at the last linearisation of the tractions, shape ``(n, 2)`` [m].
        linear: Linearly extrapolated slips of the last evaluation, shape ``(n, 2)`` [m].
        turning: Spring tractions at the slips `linear`, shape ``(n, 2)`` [N].
    """

    def __init__(self, size: Floats, frame: Frame | None = None) -> None:
        n = len(size)
        self.linear, self.turning = np.zeros((n, 2)), np.zeros((n, 2))
        self._values = None if frame is None else LinearValues(frame, n, 2)
        self._size = size
        self.modelled: Floats = np.zeros((n, 2))
        self.present: Floats = np.zeros((n, 2))
        self._all: Floats = np.zeros((n, 2))
        self._predicted: Floats = np.full((n, 2), np.nan)

    def measure(self, pairs: PairKinematics, x: Floats) -> None:
        """Set the slips of ``m`` pairs as measured at positions ``x``.

        ``x`` are positions with ghosts, shape ``(l, 3)`` [m].
        """
        node, value = pairs.node, pairs.slip.value
        self.linear[node] = value
        if self._values is not None:
            self.linear[node] = self._values.of(pairs, x, value, pairs.slip.gradient)
        if not pairs.fixed.any():  # no slip counts as zero
            self._all[node] = self.present[node] = value
            return
        predicted = self._predicted[node]
        is_same = length_of(value - predicted) <= ROUNDING * self._size[node]
        is_same &= pairs.fixed
        self._all[node] = np.where(is_same[:, None], predicted, value)
        self.present[node] = self.without_round_off(pairs, self._all[node])
        none = np.where(pairs.fixed, self.stick_tolerance(node), 0.0)
        left = np.maximum(length_of(self._all[node]) - none, 0.0)
        pairs.excess[:, 1:] = with_length(self._all[node], left)

    def use_all(self, pairs: PairKinematics) -> None:
        """Set the constraint residuals to the slips of the last evaluation, without a threshold."""
        pairs.excess[:, 1:] = self._all[pairs.node]

    def predict(self, pairs: PairKinematics, change: Floats) -> None:
        """Predict the next slips by adding increments to the present ones, ``(m, 2)`` [m]."""
        self._predicted[pairs.node] = self._all[pairs.node] + change

    def without_round_off(self, pairs: PairKinematics, slip: Floats) -> Floats:
        """Slips, ``(m, 2)`` [m], with 0 in place of round-off."""
        still: Flags = pairs.fixed & (length_of(slip) <= self.stick_tolerance(pairs.node))
        return np.where(still[:, None], 0.0, slip)

    def stick_tolerance(self, node: Ints) -> Floats:
        """Slip below which a node on a rigid body or a prescribed node sticks, ``(m,)`` [m]."""
        lengths: Floats = _STILL * self._size[node]
        return lengths

    def of(self, node: Ints) -> Floats:
        """Slips of nodes in the last evaluation, 0 in place of round-off, shape ``(m, 2)`` [m]."""
        slips: Floats = self.present[node]
        return slips


def length_of(vectors: Floats) -> Floats:
    """Lengths of vectors, ``(m, 2)``."""
    length: Floats = np.linalg.norm(vectors, axis=1)
    return length


def with_length(vectors: Floats, length: Floats) -> Floats:
    """Vectors ``(m, 2)`` scaled to lengths ``(m,)``; zero vectors stay zero."""
    present = length_of(vectors)
    scaled: Floats = vectors * (length / np.where(present > 0, present, 1.0))[:, None]
    return scaled
