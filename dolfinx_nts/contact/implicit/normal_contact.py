"""Normal contact in one attempt at a step: what multipliers and springs share."""

from abc import ABC, abstractmethod

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.implicit.stick_slip import Friction
from dolfinx_nts.contact.pair_state import PairState

__all__ = ["NormalContact"]


class NormalContact(ABC):
    """Normal forces of the nodes of a pair: by multipliers or by springs.

    Args:
        state: State of the contact pair.
        search: Segments of the nodes.
        eligible: Nodes that may transmit force, shape ``(n,)``.

    Attributes:
        nodes: The eligible nodes, positions in the surface's, ``(e,)``.
        active: Whether a node transmits force, shape ``(n,)``.
        lambda_N: Normal multipliers, shape ``(n,)`` [N, <= 0].
        flips: How often a node has changed between contact and none.
    """

    def __init__(self, state: PairState, search: LocalSearch, eligible: Flags) -> None:
        """Begin with the nodes that were active in the last step and may be in this."""
        self._state, self._search, self._eligible = state, search, eligible
        self.nodes: Ints = eligible.nonzero()[0].astype(np.int32)
        self.active: Flags = state.history.active & eligible
        self.lambda_N: Floats = np.where(self.active, state.history.lambda_N, 0.0)
        self.flips: Ints = np.zeros(len(eligible), dtype=np.int32)

    @property
    def may_touch(self) -> Flags:
        """Whether a node may touch within the step, shape ``(n,)``. Local."""
        flags: Flags = self._search.may_close | self._state.history.active
        return flags

    def needs(self, node: Ints) -> Flags:
        """Whether the kinematics of nodes matter in this iteration. Local."""
        return np.ones(len(node), dtype=bool)

    @abstractmethod
    def update(
        self, pairs: PairKinematics, x: Floats, R: Floats | None, friction: Friction, iteration: int
    ) -> int:
        """Decide which pairs transmit force and compute it, friction too. Collective.

        Args:
            pairs: The pairs.
            x: Positions with ghosts, shape ``(l, 3)`` [m].
            R: Residual without contact at the owned nodes, ``(n, 3)`` [N];
                None: multipliers stay as they are.
            friction: Friction of the pairs.
            iteration: Number of the Newton iteration, from 0.

        Returns:
            How many pairs of this rank do not fit, or did not.
        """

    def close_gaps(  # noqa: B027 (springs want no gap)
        self, pairs: PairKinematics, x: Floats, u: Floats, friction: Friction
    ) -> None:
        """Move nodes to where constraints want them. Collective.

        Args:
            pairs: The pairs.
            x: Positions of the owned nodes, shape ``(n, 3)`` [m].
            u: Their displacements, shape ``(n, 3)`` [m], changed. They are
                known to more digits than positions.
            friction: Friction of the pairs.
        """

    @abstractmethod
    def rank(self, active: Flags) -> Ints:
        """Number of normal constraints of each pair, shape ``(m,)``. Local."""

    def add_slope(  # noqa: B027 (multipliers do not follow gaps)
        self, pairs: PairKinematics, columns: Floats, tangent: Floats
    ) -> None:
        """Add how the forces follow the gaps to the tangent ``(m, d, d)``. Local."""

    def energy(self, pairs: PairKinematics) -> tuple[Floats, Floats]:
        """Energy of springs [J], and gap at which they start [m], ``(m,)``. Local."""
        zero = np.zeros(len(pairs.node))
        return zero, zero

    def stored(self, pairs: PairKinematics) -> Floats | float:
        """Energy that springs took in the step, shape ``(m,)`` [J]. Local."""
        return 0.0

    def lost_energy(self, node: Ints) -> float:
        """Energy of springs at all but some nodes at t_n [J]. Local."""
        return 0.0
