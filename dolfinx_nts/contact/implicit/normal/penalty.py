"""Normal contact by penalty springs in a step."""

from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.friction.traction import slip_energy, slip_stiffness
from dolfinx_nts.contact.history import NEVER
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.friction.interface import Friction
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.implicit.normal.active_set import ROUNDING
from dolfinx_nts.contact.implicit.normal.interface import NormalContact
from dolfinx_nts.contact.implicit.normal.linear_values import LinearValues
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.springs import spring_energy, spring_force, spring_slopes

__all__ = ["PenaltyContact", "SpringDerivatives"]


class SpringDerivatives(NamedTuple):
    """Derivatives of the springs of ``m`` pairs in a step.

    Inputs are the gaps at both ends of the step, then the offset, gap and soft depth of the history
    at its start, and the approach of the trial motion: six lengths [m]. Outputs are the multiplier
    [N], and offset, gap and soft depth of the history at the end [m].

    Attributes:
        matrix: Derivatives of the outputs, shape ``(m, 4, 6)``.
        of_stiffness: Derivative of the multiplier with respect to eps_N, shape ``(m,)`` [m].
    """

    matrix: Floats
    of_stiffness: Floats


class PenaltyContact(NormalContact):
    """Forces and energies of the springs.

    Args:
        state: State of the contact pair, with springs.
        is_static: Whether there is no inertia.
        search: Segments of the nodes.
        share: Weight of the end of the step in forces, see `Scheme`.
        dt: Length of the step [s].
    """

    def __init__(
        self,
        state: PairState | JointState,
        is_static: bool,
        search: LocalSearch,
        share: float,
        dt: float,
    ) -> None:
        assert state.eps_N is not None
        super().__init__(state, search)
        self._eps_N, self._is_static = state.eps_N, is_static
        self._share = share
        # Derivative of the soft depth with respect to the approach of the trial motion [-].
        self._depth_by_approach: Floats = np.zeros(len(self.active))
        layers = state.layers
        if layers is not None and not is_static and not state.pair.is_convective:
            of_segments = layers.of_candidates(search.candidates)
            faced = None if of_segments is None else search.least_faced(of_segments)
            fraction, height = self._pressed_layers(layers.deforms)
            self.soft_depth = self._soft_depth(layers.depth_per_speed(faced, height), dt)
            arriving = fraction * layers.stiffness_fraction(faced, height)
            # Constant while a spring is loaded.
            self.stiffness_fraction = np.where(self._is_loaded, state.history.part, arriving)
            self._eps_N = self.stiffness_fraction * state.eps_N
        self._slope: Floats = np.empty(0)  # derivative of lambda_N w.r.t. the gap [N/m]
        # In statics, linearly extrapolated gaps and forces.
        n = len(self.active) if is_static else 0
        self._linear_gaps, self._linear_force = LinearValues(state.search.frame, n), np.zeros(n)
        self._rounding: Floats = np.empty(0)
        if self._is_static:
            self._begin_in_touch()
            self._rounding = ROUNDING * state.segment_sizes

    def update(
        self, pairs: PairKinematics, x: Floats, R: Floats | None, friction: Friction, iteration: int
    ) -> int:
        # Springs with convective friction act at the midpoint of the step.
        node, eps_N = pairs.node, self._eps_N[pairs.node]
        if self._state.pair.is_convective:
            # Eqs. (60)-(64) of Franke, Hesch and Betsch (2011).
            gap = self._search.pairing.gaps((self._search.x_n + x) / 2, node, pairs.segment)
            pairs.gradients[:, 0] = pairs.columns[:, 0]
            lambda_N, active = eps_N * np.minimum(gap, 0.0), gap < 0
            self._slope = np.where(active, eps_N / 2, 0.0)
        else:
            offset = self._offset(pairs)
            gap_n, gap = pairs.contact.gap_n - offset, pairs.contact.gap - offset
            if self._is_static:
                return self._update_statics(pairs, x, gap, offset, friction, iteration)
            else:
                lambda_N, self._slope = self._force(node, gap_n, gap)
                active = lambda_N < 0
        changes = friction.update(pairs, -lambda_N, active, iteration)
        self.active[node], self.lambda_N[node] = active, lambda_N
        return changes

    def _update_statics(
        self,
        pairs: PairKinematics,
        x: Floats,
        gap: Floats,
        offset: Floats,
        friction: Friction,
        iteration: int,
    ) -> int:
        """Compute spring forces with extrapolated gaps, see `LinearValues`.

        ``gap`` are the gaps minus the ``offset`` of the springs, both ``(m,)`` [m]. The first
        iteration uses the forces of the last step.
        """
        node, eps_N, before = pairs.node, self._eps_N[pairs.node], self.active[pairs.node]
        contact = pairs.contact
        linear = self._linear_gaps.of(pairs, x, contact.gap, contact.gradient)
        if iteration == 0:
            linear = np.where(before & (self.lambda_N[node] < 0), self.lambda_N[node] / eps_N, gap)
            active = before | (linear < 0)
        else:
            linear, active = linear - offset, linear < offset
        self._slope = np.where(active, eps_N, 0.0)
        self._linear_force[node] = np.where(active, eps_N * np.minimum(linear, 0.0), 0.0)
        self.active[node], self.lambda_N[node] = active, np.where(active, eps_N * gap, 0.0)
        # In equilibrium springs do not pull.
        rounding = np.maximum(self._rounding[node], ROUNDING * np.abs(x).max(initial=0.0))
        pulls = (active != (gap < 0)) & (np.abs(gap) > rounding)
        changes = friction.update(
            pairs, -self.lambda_N[node], active, iteration, -self._linear_force[node]
        )
        return changes + int(np.count_nonzero(pulls))

    def renew(self, x: Floats, *, moved: bool) -> int:
        # The gaps of new contact points at t_n are unknown.
        if moved:
            self._linear_gaps.forget()
        return super().renew(x, moved=moved)

    def needs(self, x: Floats, node: Ints) -> Flags | None:
        search, old = self._search, self._state.history
        if search.pairing.follows:  # gaps on other segments may differ
            return super().needs(x, node)
        inside = (self.gaps(x, node) < 0) | (search.approach.gap_n[node] < 0)
        flags: Flags = self.active[node] | old.active[node] | (old.offset[node] != 0) | inside
        return flags

    def largest_gaps(self, pairs: PairKinematics) -> Floats:
        return np.maximum(self._offset(pairs), 0.0)

    def rank(self, active: Flags) -> Ints:
        # Springs are not constraints.
        return np.zeros(len(active), dtype=np.int32)

    def tangent(self, node: Ints) -> tuple[Floats, Floats | float]:
        force = self._linear_force if self._is_static else self.lambda_N
        return force[node], self._slope

    def energy(self, pairs: PairKinematics) -> tuple[Floats, Floats]:
        offset = self._offset(pairs)
        gap = pairs.contact.gap - offset
        energy = self._energy(pairs.node, gap)
        # The offset of open nodes is reset; penetrating nodes must not gain energy.
        return energy, np.where((gap >= 0) & (pairs.contact.gap >= 0), 0.0, offset)

    def surplus_energy(self, pairs: PairKinematics) -> Floats:
        kept, gap_n = self._offset_of_compression(pairs), pairs.contact.gap_n
        energy = self._energy(pairs.node, gap_n - kept)
        surplus = energy - self._energy(pairs.node, gap_n - self._offset(pairs))
        return np.where(self._state.history.active[pairs.node], surplus, 0.0)

    def stored(self, pairs: PairKinematics) -> Floats:
        offset, node = self._offset(pairs), pairs.node
        at_n = self._energy(node, pairs.contact.gap_n - offset)
        # An initially penetrating node has energy at t_n.
        before = np.where(self._state.history.active[node], at_n, 0.0)
        stored: Floats = self._energy(node, pairs.contact.gap - offset) - before
        return stored

    def derivatives(self, pairs: PairKinematics) -> SpringDerivatives:
        """Derivatives of the springs for given decisions. Local."""
        old, node, eps_N = self._state.history, pairs.node, self._eps_N[pairs.node]
        gap_n, gap, offset = pairs.contact.gap_n, pairs.contact.gap, self._offset(pairs)
        if self._is_static:
            slopes: Floats = np.zeros((3, len(node)))
            slopes[1] = np.where(self.active[node], eps_N, 0.0)
        else:
            ends = gap_n - offset, gap - offset
            slopes = spring_slopes(*ends, eps_N, self._share, self.soft_depth[node])
        # Offsets follow the gaps at t_n if points have changed, with inertia up to a limit.
        begins, moved = self._begins_and_moves(pairs)
        is_limited = (old.key[node] != NEVER) & (not self._is_static)
        is_limited &= self._offset_of_compression(pairs) > np.fmax(-gap_n, 0.0)
        of_offset = np.zeros((len(node), 6))
        of_offset[:, 0] = moved | (begins & (gap_n < 0))
        of_offset[:, 2], of_offset[:, 3] = ~begins, -1.0 * moved
        of_offset[is_limited] = 0.0
        of_offset[is_limited, 0] = -1.0 * (gap_n[is_limited] < 0)
        of_depth = np.zeros((len(node), 6))
        is_loaded = self._is_loaded[node]
        of_depth[:, 4] = is_loaded
        of_depth[:, 5] = np.where(is_loaded, 0.0, self._depth_by_approach[node])
        matrix = np.zeros((len(node), 4, 6))
        matrix[:, 0, :2] = slopes[:2].T
        matrix[:, 0] -= slopes[:2].sum(axis=0)[:, None] * of_offset
        matrix[:, 0] += slopes[2][:, None] * of_depth
        is_open = (gap >= offset) & (gap >= 0)
        matrix[:, 1] = np.where(is_open[:, None], 0.0, of_offset)
        matrix[:, 2, 1], matrix[:, 3] = 1.0, of_depth
        stiffness = self._state.eps_N
        assert stiffness is not None
        return SpringDerivatives(matrix, self.lambda_N[node] / stiffness[node])

    def released_energy(self, node: Ints) -> Floats:
        state, history = self._state, self._state.history
        eps_T = slip_stiffness(state.pair.friction, state.eps_T, self.stiffness_fraction)
        energy: Floats = history.energy - slip_energy(history.traction, eps_T)
        energy[node] = 0.0
        return energy

    def _energy(self, node: Ints, gap: Floats) -> Floats:
        """Energy of springs, shape ``(m,)`` [J], for gaps less their offsets, ``(m,)`` [m]."""
        return spring_energy(gap, self._eps_N[node], self.soft_depth[node])

    def _force(self, node: Ints, gap_n: Floats, gap: Floats) -> tuple[Floats, Floats]:
        """Multipliers and slopes, see `spring_force`, for gaps less their offsets [m]."""
        soft_depth = self.soft_depth[node]
        return spring_force(gap_n, gap, self._eps_N[node], self._share, soft_depth)

    def _soft_depth(self, depth_per_speed: Floats, dt: float) -> Floats:
        """Compression up to which each spring is soft, shape ``(n,)`` [m].

        It is constant while the spring is loaded, so that its energy is a function of the gap.
        """
        old, approach = self._state.history, self._search.approach
        speed = np.fmax(approach.gap_n - approach.gap, 0.0) / dt  # 0 at nodes without a segment
        deforms = np.isfinite(depth_per_speed)
        # Springs that are loaded by a displacement set by the user had no impact: they stay soft.
        overlaps = (old.key == NEVER) & (approach.gap_n < 0) & ~self._search.touches
        deforms &= ~overlaps
        arriving = np.where(deforms, speed * np.where(deforms, depth_per_speed, 0.0), np.inf)
        depth: Floats = np.where(self._is_loaded, old.soft_depth, arriving)
        self._depth_by_approach = np.where(deforms & (speed > 0), depth_per_speed / dt, 0.0)
        return depth

    def _pressed_layers(self, deforms: Flags) -> tuple[Floats | float, Floats | None]:
        """Fractions of the nodal areas that are pressed, and relative heights there. Collective.

        They are 1 with edge contact and between bodies that do not deform (flags ``deforms``,
        ``(n,)``), whose stiffness is not per area. See `LocalSearch.pressed_layers`.
        """
        layers = None if self._state.pair.method == EDGES else self._search.pressed_layers
        if layers is None:
            return 1.0, None
        fractions, heights = (np.where(deforms, each, 1.0) for each in layers)
        return fractions, heights

    @property
    def _is_loaded(self) -> Flags:
        """Whether each spring, or its tangential one, has energy at t_n, ``(n,)``. Local."""
        old = self._state.history
        flags: Flags = (old.gap < old.offset) | old.traction.any(axis=1)
        return flags

    def _offset(self, pairs: PairKinematics) -> Floats:
        """Gap at which springs begin on the current segments, shape ``(m,)`` [m].

        With inertia, the offset of a spring with new contact points is limited to the penetration
        at t_n; otherwise it would press where the gap is open. The limit costs 3 % more Newton
        iterations in impacts on corners, no positive offsets at all 9 %. The energy that a spring
        loses is its `surplus_energy`.
        """
        offset = self._offset_of_compression(pairs)
        if self._is_static:
            return offset
        changes = self._state.history.key[pairs.node] != NEVER
        limit = np.fmax(-pairs.contact.gap_n, 0.0)
        return np.where(changes, np.minimum(offset, limit), offset)

    def _offset_of_compression(self, pairs: PairKinematics) -> Floats:
        """Gap at which springs begin if they keep their compression, shape ``(m,)`` [m].

        At new contact points it changes by the difference of the gaps at t_n, so that the energy is
        continuous. A spring without energy begins where its node is now, so that it resists as soon
        as the node goes deeper, however deep it has been before.
        """
        old, node, gap_n = self._state.history, pairs.node, pairs.contact.gap_n
        begins, moved = self._begins_and_moves(pairs)
        offset: Floats = old.offset[node] + np.where(moved, gap_n - old.gap[node], 0.0)
        return np.where(begins, np.fmin(gap_n, 0.0), offset)

    def _begins_and_moves(self, pairs: PairKinematics) -> tuple[Flags, Flags]:
        """Whether springs have no energy at t_n, and whether loaded ones have new contact points.

        Shapes ``(m,)``. In statics springs without energy at the same points keep their offsets.
        Local.
        """
        node, pairing = pairs.node, self._search.pairing
        known, is_loaded = self._state.history.key[node] != NEVER, self._is_loaded[node]
        changes: Flags | bool = ~pairing.is_same(pairs) if pairing.follows else not self._is_static
        begins = known & ~is_loaded & (changes | (not self._is_static))
        return begins, known & is_loaded & changes
