"""What all kinds of normal contact do in one attempt at a step."""

from typing import Protocol

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.implicit.multiplier import MultiplierContact
from dolfinx_nts.contact.implicit.penalty import PenaltyContact
from dolfinx_nts.contact.implicit.stick_slip import Friction
from dolfinx_nts.contact.pair_state import PairState

__all__ = ["NormalContact", "normal_contact"]


class NormalContact(Protocol):
    """Normal forces of the nodes of a pair: by multipliers or by springs.

    Attributes:
        active: Whether a node transmits force, shape ``(n,)``.
        lambda_N: Normal multipliers, shape ``(n,)`` [N, <= 0].
        flips: How often a node has changed between contact and none.
    """

    active: Flags
    lambda_N: Floats
    flips: Ints

    def eligible(self) -> tuple[Ints, Flags]:
        """Find the nodes that contact has to look at. Local.

        Returns:
            Nodes that may transmit force, positions in the surface's
            nodes, ``(e,)``; whether a node may touch in the step, ``(n,)``.
        """

    def needs(self, node: Ints) -> Flags:
        """Whether the kinematics of nodes matter in this iteration. Local."""

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

    def close_gaps(self, pairs: PairKinematics, x: Floats, u: Floats, friction: Friction) -> None:
        """Move nodes to where constraints want them. Collective.

        Args:
            pairs: The pairs.
            x: Positions of the owned nodes, shape ``(n, 3)`` [m].
            u: Their displacements, shape ``(n, 3)`` [m], changed. They are
                known to more digits than positions.
            friction: Friction of the pairs.
        """

    def rank(self, active: Flags) -> Ints:
        """Number of normal constraints of each pair, shape ``(m,)``. Local."""

    def add_slope(self, pairs: PairKinematics, columns: Floats, tangent: Floats) -> None:
        """Add how the forces follow the gaps to the tangent ``(m, d, d)``. Local."""

    def energy(self, pairs: PairKinematics) -> tuple[Floats, Floats]:
        """Energy of springs [J], and gap at which they start [m], ``(m,)``. Local."""

    def stored(self, pairs: PairKinematics) -> Floats | float:
        """Energy that springs took in the step, shape ``(m,)`` [J]. Local."""

    def lost_energy(self, node: Ints) -> float:
        """Energy of springs at all but some nodes at t_n [J]. Local."""


def normal_contact(
    state: PairState, scheme: str, search: LocalSearch, stiffness: Floats
) -> NormalContact:
    """Normal contact of a pair, by its enforcement. Collective.

    Args:
        state: State of the contact pair.
        scheme: Kernel of contact.
        search: Segments of the nodes.
        stiffness: Stiffness of the nodes, shape ``(n,)`` [N/m].
    """
    law = state.pair.enforcement
    if isinstance(law, LagrangeMultiplier):
        return MultiplierContact(state, law, scheme, search, stiffness)
    return PenaltyContact(state, law, search)
