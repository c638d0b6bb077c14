"""Tied contact in one attempt at a step."""

from typing import cast

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.enforcement import Tied
from dolfinx_nts.contact.friction.laws import Coulomb
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.friction.interface import Friction
from dolfinx_nts.contact.implicit.friction.stick_slip import StickSlip
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.implicit.normal.multiplier import MultiplierContact
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.parallel import reductions

__all__ = ["Bond", "TiedContact"]


class TiedContact(MultiplierContact):
    """Multipliers of tied nodes, of either sign, which keep the gap."""

    def choose(self) -> Flags:
        tied, (segment, gap) = self._state.history.active, self._search.start
        if reductions.anywhere(self._comm, bool(tied.any())):
            return tied.copy()
        size, law = self._search.candidates.size, cast(Tied, self._law)
        # Without candidates no node has a segment.
        size = size.take(segment, mode="wrap") if len(size) else np.ones(1)
        tied = (segment >= 0) & (np.abs(gap) <= law.reach * size)
        if not reductions.anywhere(self._comm, bool(tied.any())):
            raise ValueError(
                f"expected nodes within {law.reach:g} of the size of a segment between "
                f"{self._state.pair.between}, given none to tie: increase Tied(reach=)"
            )
        return tied

    def needs(self, x: Floats, node: Ints) -> Flags | None:
        """Flags of tied nodes, all of whose kinematics are needed."""
        return None

    @property
    def may_touch(self) -> Flags:
        """Whether a node may transmit force, shape ``(n,)``: all tied nodes. Local."""
        return self._eligible

    def _target(self, pairs: PairKinematics) -> Floats:
        """Reference gaps of the multipliers: the gaps at t_n, shape ``(m,)`` [m]."""
        return pairs.contact.gap_n

    def update(
        self, pairs: PairKinematics, x: Floats, R: Floats | None, friction: Friction, iteration: int
    ) -> int:
        """Compute multipliers from the balance at the nodes; all nodes stay active."""
        pairs.excess[:, 0] = pairs.contact.gap - self._target(pairs)
        R = None if R is None else R[pairs.dofs[:, 0]]
        active = np.ones(len(pairs.node), dtype=bool)
        self.active[pairs.node] = True
        self.lambda_N[pairs.node] = self._balance(
            pairs, R, self.lambda_N[pairs.node], active, friction
        )
        # An equilibrium with a tied node without a segment is never accepted.
        return len(self.nodes) - len(pairs.node)


class Bond(StickSlip):
    """Tangential forces of tied nodes, which always stick.

    Args:
        state: State of the pair.
        is_static: Whether there is no inertia.
        search: Segments of the nodes.
        stiffness: Stiffness of the nodes, shape ``(n,)`` [N/m].
        acts_at_end: Whether contact forces of the scheme act at the end of a step.
    """

    def __init__(
        self,
        state: PairState | JointState,
        is_static: bool,
        search: LocalSearch,
        stiffness: Floats,
        acts_at_end: bool,
    ) -> None:
        every = np.ones(len(stiffness))
        law = Coulomb(mu=1.0)
        super().__init__(state, law, is_static, search, stiffness, acts_at_end, False, 1.0, every)
        # Nodes on an axis of symmetry have no tangential constraint.
        self.sliding[:] = self._on_axis

    def follow_contact(self, pairs: PairKinematics, before: Flags, active: Flags) -> None:
        """Do nothing: the set of tied nodes is constant."""

    def update(
        self,
        pairs: PairKinematics,
        p: Floats,
        active: Flags,
        iteration: int,
        linear: Floats | None = None,
    ) -> int:
        self._slips.modelled[pairs.node] = pairs.slip.value
        return 0
