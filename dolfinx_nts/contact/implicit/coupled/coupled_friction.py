"""Interfaces between the coupled contact problem and the friction of one contact pair."""

from typing import Protocol

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.implicit.contributions import PairKinematics

__all__ = ["CoupledFriction", "CoupledSolution", "NoFriction"]


class CoupledSolution(Protocol):
    """Solution of the cone problem for ``m`` pairs, see `friction_cones.ConeSolution`."""

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
        """Whether an active pair slides, shape ``(m,)``."""


class CoupledFriction(Protocol):
    """Interface of friction that gets stick and slip from the coupled problem. Local."""

    def coefficients(self, node: Ints) -> Floats:
        """Coefficients of friction of nodes, shape ``(m,)`` [-]."""

    def use_all_slips(self, pairs: PairKinematics) -> None:
        """Use slips of any size in constraint residuals, even if they may be round-off."""

    def set_states(
        self, pairs: PairKinematics, slides: Flags, active: Flags, forces: Floats, slip: Floats
    ) -> None:
        """Set stick and slip, with the forces and slips of the coupled solution.

        Args:
            pairs: The pairs.
            slides: Flags of sliding pairs, shape ``(m,)``.
            active: Flags of active pairs, shape ``(m,)``.
            forces: Multipliers, normal and tangential, shape ``(m, 3)`` [N].
            slip: Slips at the end of the iteration, shape ``(m, 2)`` [m].
        """

    def predict(self, pairs: PairKinematics, change: Floats) -> None:
        """Add slip increments of the linear system, ``(m, 2)`` [m], to the slips of the pairs."""


class NoFriction:
    """Contact without friction, see `CoupledFriction`."""

    def coefficients(self, node: Ints) -> Floats:
        """Return 0 for all nodes."""
        return np.zeros(len(node))

    def use_all_slips(self, pairs: PairKinematics) -> None:
        """Do nothing, without friction."""

    def set_states(
        self, pairs: PairKinematics, slides: Flags, active: Flags, forces: Floats, slip: Floats
    ) -> None:
        """Do nothing, without friction."""

    def predict(self, pairs: PairKinematics, change: Floats) -> None:
        """Do nothing, without friction."""
