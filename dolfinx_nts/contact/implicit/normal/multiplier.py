"""Normal contact by Lagrange multipliers in a step."""

from collections.abc import Mapping

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints, indices
from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.friction.interface import Friction
from dolfinx_nts.contact.implicit.local_search import LocalSearch, penetrated_nodes
from dolfinx_nts.contact.implicit.normal.active_set import ActiveSet
from dolfinx_nts.contact.implicit.normal.interface import NormalContact
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.pair_state import PairState

__all__ = ["MultiplierContact"]

# Gap relative to the size of a segment [-] up to which nodes are moved along their normals between
# Newton iterations.
_CLOSE = 0.01
# Gap relative to the size of a segment [-] that nodes may close in one iteration.
_NEAR = 0.1
# Additional penetration of an excluded node in a step, relative to the size of a segment [-], above
# which it becomes eligible.
_EXCLUDED_DEPTH = 0.05


class MultiplierContact(NormalContact):
    """Active set and multipliers of normal contact.

    Args:
        state: State of the contact pair.
        law: Enforcement of the pair.
        is_static: Whether there is no inertia.
        search: Segments of the nodes.
        stiffness: Stiffness of the nodes, shape ``(n,)`` [N/m].
        intermediate: Positions of the local nodes after fractions of the ballistic motion, see
            `ContactStep`.
    """

    def __init__(
        self,
        state: PairState | JointState,
        law: LagrangeMultiplier,
        is_static: bool,
        search: LocalSearch,
        stiffness: Floats,
        intermediate: Mapping[float, Floats],
    ) -> None:
        # With inertia, elastic impact keeps gaps; in statics gaps close.
        self._reach = _NEAR if is_static else 0.0
        self._holds, self._law = law.holds_gaps and not is_static, law
        # Mortar quadrature points change in each step: to close the changed mean gap of an active
        # node would do work.
        stays = not (search.pairing.follows or is_static)
        self._stays: Flags = state.history.active & stays
        super().__init__(state, search)
        self._intermediate: Floats | None = None
        if self._holds and law.part:
            x = state.search.frame.intermediate(law.part, intermediate[law.part])
            self._intermediate = search.candidates.scatter.forward(x)
        if is_static:
            self._begin_in_touch()
        self._set = ActiveSet(state, law, stiffness, is_static)
        self._farthest = _CLOSE * state.segment_sizes

    def choose(self) -> Flags:
        search, history = self._search, self._state.history
        approach, candidates = search.approach, search.candidates
        eligible = self._faces_by_law()
        if isinstance(self._state, JointState):  # joint pairs touch only other bodies
            return eligible
        urgency = 2 * history.active + (np.fmin(approach.gap_n, approach.gap) < 0)
        urgency[self._sunk] = 4
        nodes = self._state.nodes
        chosen = candidates.independent(nodes, approach.segment, eligible, urgency)
        self._barred = eligible & ~chosen
        return chosen

    def _faces_by_law(self) -> Flags:
        approach, eligible = self._search.approach, super()._faces_by_law()
        if self._holds:
            # Gaps are compared with a constant length, so that loaded nodes are not released on
            # shorter segments.
            size, active = self._state.segment_sizes, self._state.history.active
            passes = self._law.eligible(approach.gap_n, approach.gap, size, active)
            eligible &= passes | self._admitted
        return eligible

    def renew(self, x: Floats, *, moved: bool) -> int:
        super().renew(x, moved=moved)
        if not (self._choices and self._state.pair.touches_itself):
            return 0
        barred = indices(self._barred)
        return self._admit_penetrating(*penetrated_nodes(self._search, x, barred, _EXCLUDED_DEPTH))

    def may_activate(self, node: Ints, gap_n: Floats, gap: Floats) -> Flags | bool:
        if not self._holds:
            return True
        size, active = self._state.segment_sizes[node], self._state.history.active[node]
        return self._law.eligible(gap_n, gap, size, active)

    def largest_gaps(self, pairs: PairKinematics) -> Floats:
        holds = self._stays[pairs.node] | self._holds
        return np.where(holds, np.maximum(pairs.contact.gap_n, 0.0), 0.0)

    @property
    def may_touch(self) -> Flags:
        return self._eligible if self._holds else super().may_touch

    def needs(self, x: Floats, node: Ints) -> Flags | None:
        # In statics the coupled contact problem also needs nodes that may close in the next
        # increment.
        if self._holds:
            return super().needs(x, node)
        near = self.gaps(x, node) < self._reach * self._state.segment_sizes[node]
        return self.active[node] | self._stays[node] | near

    def _target(self, pairs: PairKinematics) -> Floats:
        """Reference gaps of the multipliers, shape ``(m,)`` [m]."""
        gap_n = pairs.contact.gap_n
        if not self._holds:
            return np.where(self._stays[pairs.node], gap_n, 0.0)
        if self._intermediate is None:
            return gap_n
        # Gaps of a rigid body with many contact points, also to a moving obstacle, must be
        # compatible with one rigid motion.
        gap = self._search.pairing.gaps(self._intermediate, pairs.node, pairs.segment)
        if self._search.candidates.may_curve:
            flat = gap_n + self._approach(self._intermediate, pairs)
            # Nodes without unknown displacements can satisfy no other constraint.
            gap = np.where(pairs.fixed, gap, np.maximum(gap, flat))
        return np.asarray(np.minimum(gap_n, gap))

    def _approach(self, x: Floats, pairs: PairKinematics) -> Floats:
        """Increase of the distance of nodes from the tangent planes at t_n, shape ``(m,)`` [m].

        It excludes the curvature of the surface along a straight path.
        """
        search, rotation = self._search, self._state.search.frame.end.rotation
        start = search.pairing.kinematics("static", search.x_n, pairs.node, pairs.segment, None)
        gradient = start.contact.gradient
        increments = ((x - search.x_n) @ rotation.T)[start.dofs].reshape(gradient.shape)
        change: Floats = np.einsum("md,md->m", gradient, increments)
        return change

    def update(
        self, pairs: PairKinematics, x: Floats, R: Floats | None, friction: Friction, iteration: int
    ) -> int:
        # Multipliers are computed from the balance at the nodes.
        gap = pairs.contact.gap
        pairs.excess[:, 0] = gap - self._target(pairs)
        R = None if R is None else pairs.blocks.gathered(R)
        node, before = pairs.node, self.active[pairs.node]
        # Contact states follow from multipliers, and multipliers from contact states.
        lambda_N = self._balance(pairs, R, self.lambda_N[node], before, friction)
        active, changes = self._set.update(node, pairs.excess[:, 0], before, lambda_N, iteration)
        lambda_N = np.where(active, lambda_N, 0.0)
        if changes:
            self.flips[node] += active != before
        friction.follow_contact(pairs, before, active)
        changes += friction.update(pairs, -lambda_N, active, iteration)
        self.active[node] = active
        # Without changes the balance is the same.
        has_friction = self._state.pair.friction is not None
        if has_friction or self._set.num_violators:
            lambda_N = self._balance(pairs, R, lambda_N, active, friction)
        self.lambda_N[node] = lambda_N
        return changes

    def _balance(
        self,
        pairs: PairKinematics,
        R: Floats | None,
        lambda_N: Floats,
        active: Flags,
        friction: Friction,
    ) -> Floats:
        """Multipliers and tractions that balance the residual at the nodes, if it is given."""
        if R is None:
            friction.follow_multipliers(pairs, lambda_N, active)
            return lambda_N
        return np.where(active, friction.balance(pairs, R, active), 0.0)

    def close_gaps(self, pairs: PairKinematics, x: Floats, u: Floats, friction: Friction) -> None:
        """Move nodes without stick along the normals of the last evaluation.

        This saves an application of the tangent in the linear system. See
        `NormalContact.close_gaps`.
        """
        moves = self.active[pairs.node] & ~pairs.fixed
        moves &= ~friction.sticks(pairs.node, moves)
        x = self._search.candidates.scatter.forward(self._state.search.frame.at_end(x))
        gap = self._search.pairing.gaps(x, pairs.node, pairs.segment)
        gap -= self._target(pairs)
        # Large displacements are left to the linear system.
        farthest = self._farthest[pairs.node]
        pairs.blocks.close_gaps(pairs.normal, pairs.gradients, gap, moves, farthest, u)

    def rank(self, active: Flags) -> Ints:
        """One normal constraint for each active pair."""
        return active.astype(np.int32)
