"""What was decided on the pairs of one contact pair beside those of others, and what takes it."""

from typing import Protocol

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.implicit.contributions import PairKinematics

__all__ = ["DecidedFriction", "Decision", "NoFriction"]


class Decision(Protocol):
    """What was decided on ``m`` pairs, see `friction_cones.ConeSolution`."""

    @property
    def force(self) -> Floats:
        """Forces on the points, normal first, shape ``(m, d)`` [N]."""

    @property
    def motion(self) -> Floats:
        """Gaps and slips, shape ``(m, d)`` [m]."""

    @property
    def presses(self) -> Flags:
        """Whether a pair transmits force, shape ``(m,)``."""

    @property
    def slides(self) -> Flags:
        """Whether one that does slides, shape ``(m,)``."""


class DecidedFriction(Protocol):
    """Friction of pairs on which is decided beside others. Local."""

    def coefficients(self, node: Ints) -> Floats:
        """Coefficients of friction of nodes, shape ``(m,)`` [-], 0 where there is none."""

    def show_slips(self, pairs: PairKinematics) -> None:
        """Let constraints of pairs see their slips, however small."""

    def decide(
        self, pairs: PairKinematics, slides: Flags, active: Flags, forces: Floats, slip: Floats
    ) -> None:
        """Take over stick and slip, with forces and slips by which they were decided.

        Args:
            pairs: The pairs.
            slides: Whether they slide where they are active, shape ``(m,)``.
            active: Which pairs transmit force, shape ``(m,)``.
            forces: Multipliers, normal and tangential, shape ``(m, 3)`` [N].
            slip: Slips at the end of the iteration, shape ``(m, 2)`` [m].
        """

    def predict(self, pairs: PairKinematics, change: Floats) -> None:
        """Know the change of slips in an iteration, ``(m, 2)`` [m], which positions round."""


class NoFriction:
    """No friction, see `DecidedFriction`."""

    def coefficients(self, node: Ints) -> Floats:
        """Return 0 for all nodes."""
        return np.zeros(len(node))

    def show_slips(self, pairs: PairKinematics) -> None:
        """There are none."""

    def decide(
        self, pairs: PairKinematics, slides: Flags, active: Flags, forces: Floats, slip: Floats
    ) -> None:
        """There is nothing to take over."""

    def predict(self, pairs: PairKinematics, change: Floats) -> None:
        """There is nothing to know."""
