"""Interface of tangential contact: forces of the nodes of a pair in one attempt at a step."""

from typing import Any

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.coupled.coupled_friction import CoupledFriction, NoFriction
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.components import dimension

__all__ = ["Friction"]


class Friction:
    """Tangential forces of the nodes of a pair. This base class has none.

    Methods are local unless noted. Common arguments: ``pairs`` are the pairs of ``m`` of the ``n``
    nodes of the surface; ``node`` are indices of these nodes, shape ``(m,)``; ``active`` are flags
    of pairs that transmit force, shape ``(m,)``.

    Args:
        state: State of the contact pair.

    Attributes:
        sliding: Nodes that slide where they are active, shape ``(n,)``.
        traction: Traction in the frames of the segments at t_n, shape ``(n, 2)`` [N].
        flips: How often a node has changed between stick and slip, shape ``(n,)``.
        coupled: Applies the coupled solution for all pairs; None with tangential springs.
        keeps_states: Whether nodes keep to stick or to slide, as in differences of forces.
    """

    coupled: CoupledFriction | None
    keeps_states = False

    def __init__(self, state: PairState | JointState) -> None:
        """Start with all nodes sliding, without traction."""
        n = len(state.nodes.nodes)
        self._state, self._dim = state, dimension(state.nodes.V)
        self.coupled = NoFriction()
        self.sliding: Flags = np.ones(n, dtype=bool)
        self.traction: Floats = np.zeros((n, 2))
        # Frames of the tractions, 0 at nodes without a frame so far.
        self._frame: Floats = np.zeros((n, 2, 3))
        self.flips: Ints = np.zeros(n, dtype=np.int32)

    def start_from(self, other: "Friction") -> None:
        """Start with the sticking nodes and tractions of another attempt. Local."""
        self.sliding[:], self.traction[:] = other.sliding, other.traction
        self._frame[:] = other._frame

    def measure(self, pairs: PairKinematics, x: Floats) -> None:
        """Add the slip of the pairs to their kinematics; x has ghosts, shape ``(l, 3)`` [m]."""

    def release(self, node: Ints) -> None:
        """Discard the traction of nodes that have become inactive."""
        self.traction[node] = 0.0

    def follow_contact(self, pairs: PairKinematics, before: Flags, active: Flags) -> None:
        """Release nodes that became inactive; set stick or slip of newly active ones."""

    def sticks(self, node: Ints, active: Flags) -> Flags:
        """Flags of active nodes with tangential (stick) constraints, shape ``(m,)``."""
        return np.zeros(len(node), dtype=bool)

    def largest(self, node: Ints, p: Floats, slip: Floats) -> Floats:
        """Limits of tractions of nodes, ``(m,)`` [N].

        ``p`` are normal forces [N], ``slip`` lengths of slip [m], of nodes that slide.
        """
        return np.zeros(len(node))

    def update(
        self,
        pairs: PairKinematics,
        p: Floats,
        active: Flags,
        iteration: int,
        linear: Floats | None = None,
    ) -> int:
        """Decide on stick and slip, and linearise the tractions. Collective.

        ``p`` is the normal force, shape ``(m,)`` [N], and ``iteration`` counts the Newton
        iterations of the step from 0; ``linear`` is the normal force of the linear system; None if
        it equals p. Returns the number of pairs of this rank that violate the conditions of their
        state.
        """
        return 0

    def balance(self, pairs: PairKinematics, R: Floats, active: Flags) -> Floats:
        """Normal multipliers of active pairs that balance the residual. Collective.

        Also sets the tractions of these pairs. ``R`` is the residual at the nodes of the pairs,
        shape ``(m, 3)`` [N]; the result, ``(m,)`` [N], is undefined for inactive pairs.
        """
        rank = (active & ~pairs.fixed).astype(np.int32)
        return pairs.blocks.balance(pairs.normal, R, pairs.columns, rank, None)[:, 0]

    def follow_multipliers(self, pairs: PairKinematics, lambda_N: Floats, active: Flags) -> None:
        """Set tractions of sliding nodes from solved normal multipliers, ``(m,)`` [N]."""

    def add_to(
        self, pairs: PairKinematics, active: Flags, force: Floats, tangent: Floats
    ) -> tuple[Floats, Floats]:
        """Add frictional forces to forces ``(m, d)`` [N] and to tangents of `PairBlocks`.

        Returns columns and slopes of the `ContactContribution`; slopes exclude normal springs.
        """
        return pairs.columns, np.zeros((len(pairs.node), 3, 3))

    def scheme_work(self, pairs: PairKinematics, dx: Floats) -> Floats:
        """Work of tractions that is neither dissipated nor stored, shape ``(m,)`` [J].

        ``dx`` is the displacement of the pairs in the step, shape ``(m, d)`` [m].
        """
        return np.zeros(len(pairs.node))

    def accepted(self, pairs: PairKinematics, x: Floats) -> tuple[Floats, dict[str, Any]]:
        """Energy of the springs, ``(n,)`` [J], and values of the history, by name.

        ``x`` are the positions with ghosts at the end of the step, shape ``(l, 3)`` [m].
        """
        return np.zeros(len(self.flips)), {"slip": self._state.history.slip.copy()}
