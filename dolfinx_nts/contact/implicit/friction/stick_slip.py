"""Friction of the nodes of a pair in one attempt at a step."""

from typing import Any

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.friction.laws import FrictionLaw
from dolfinx_nts.contact.friction.limits import Limits, NodalLimit
from dolfinx_nts.contact.friction.traction import (
    TractionModel,
    exact_model,
    slip_energy,
    slip_stiffness,
    spring_model,
    transport,
)
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.coupled.coupled_friction import NoFriction
from dolfinx_nts.contact.implicit.friction.interface import Friction
from dolfinx_nts.contact.implicit.friction.lagged_limit import LaggedLimit
from dolfinx_nts.contact.implicit.friction.slips import Slips, length_of, with_length
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.implicit.normal.active_set import ROUNDING, BlockPivoting
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.axisymmetry import axis_nodes

__all__ = ["StickSlip"]

# Weight of slip in the test for stick, relative to the stiffness of a node [-]: it changes the
# path of Newton's method, not the solution.
_SLIP_WEIGHT = 0.1
# Weight in the direction of sliding for nodes that cannot be eliminated [-]: their small slips may
# be determined by other nodes.
_DIRECTION_WEIGHT = 1e7


class StickSlip(Friction):
    """Friction with exact stick or with springs.

    Args:
        state: State of the contact pair.
        law: Law of friction of the pair.
        is_static: Whether there is no inertia.
        search: Segments of the nodes.
        stiffness: Stiffness of the nodes, shape ``(n,)`` [N/m].
        acts_at_end: Whether contact forces of the scheme act at the end of a step.
        begins_sticking: Whether all nodes stick at first, and slide only near an equilibrium.
        dt: Length of the step [s].
        fraction: Fraction of the stiffness of default springs that acts, shape ``(n,)`` [-].
    """

    def __init__(
        self,
        state: PairState | JointState,
        law: FrictionLaw,
        is_static: bool,
        search: LocalSearch,
        stiffness: Floats,
        acts_at_end: bool,
        begins_sticking: bool,
        dt: float,
        fraction: Floats,
    ) -> None:
        super().__init__(state)
        self._eps_T = slip_stiffness(law, state.eps_T, fraction)
        history, n = state.history, len(stiffness)
        self._search, self._stiffness, self._measure = search, stiffness, law.law
        if search.pairing.follows:
            of_facets = search.pressed_fractions * state.nodes.positive_area
        else:
            of_facets = None  # contact points, and thus areas, may change within a step
        self._limits = Limits(
            law,
            state.nodes,
            dt,
            lambda: self._search.pairing.area if of_facets is None else of_facets,
            history.slip,
        )
        self._acts_at_end = acts_at_end
        self._has_spring = state.pair.has_slip_spring
        nodes = state.nodes
        self._pivoting = BlockPivoting(
            nodes.V.mesh.comm,
            nodes.node_ids,
            state.ends,
            waits=0 if self._has_spring else np.inf,
            is_patient=begins_sticking,
        )
        self.coupled = None if self._has_spring else self._CoupledStickSlip(self)
        follows = is_static and self._has_spring
        self._slips = Slips(state.segment_sizes, state.search.frame if follows else None)
        # In statics new active nodes stick at first, as friction may be the only support.
        self.sliding = history.sliding | (~history.active & (not is_static))
        if begins_sticking:
            self.sliding[:] = False
        # By symmetry nodes on the axis have no tangential traction: they slide without friction.
        self._on_axis = np.isin(state.nodes.nodes, axis_nodes(state.nodes.V))
        self.sliding |= self._on_axis
        # Nodes whose contact has just begun, so that their normal force is unknown.
        self._is_new: Flags = np.zeros(n, dtype=bool)
        # Linearised traction of the last iteration.
        self._model = TractionModel(np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((n, 2, 2)))
        self._lagged = LaggedLimit(n)
        self._nodal = _kernels.NodalFriction(
            self._has_spring,
            self._on_axis,
            ROUNDING * stiffness * state.segment_sizes,
            self.sliding,
            self.flips,
            self.traction,
            *self._model,
            self._lagged.heading,
            self._slips.present,
            self._slips.modelled,
            self._frame,
        )

    def measure(self, pairs: PairKinematics, x: Floats) -> None:
        slip = self._search.pairing.slip(self._measure, x, pairs.node, pairs.segment)
        if self._acts_at_end:
            slip = slip.at_end()
        self._nodal.turn(pairs.node, slip.frame_n)
        still = None if self._has_spring else self._slips.stick_tolerance(pairs.node)
        pairs.add_slip(slip, self._on_axis[pairs.node], still)
        if (is_fixed := pairs.fixed_components(self._dim)) is not None:
            pairs.remove_slip_across(is_fixed, self._search.pairing.on_segments(pairs), x)
        self._slips.measure(pairs, x)

    def follow_contact(self, pairs: PairKinematics, before: Flags, active: Flags) -> None:
        """Release inactive nodes; new active nodes stick if they are inside the friction cone."""
        changes = active != before
        self._is_new[:] = False
        if not changes.any():
            return
        arrives = changes & active
        self.release(pairs.node[changes & before])
        arrived = pairs.node[arrives]
        slip = np.linalg.norm(pairs.slip.value[arrives], axis=1)
        # The normal forces of new active nodes are unknown.
        mu = self._limits.at(arrived, np.zeros(len(arrived))).by_p
        slides = slip > mu * np.abs(pairs.excess[arrives, 0])
        self.sliding[arrived] = slides | self._on_axis[arrived]
        self._lagged.heading[arrived] = 0.0
        self._is_new[arrived] = True

    def sticks(self, node: Ints, active: Flags) -> Flags:
        return self._nodal.sticks(node, active)

    def largest(self, node: Ints, p: Floats, slip: Floats) -> Floats:
        return self._limits.at(node, p, self.sliding[node] * slip).force

    def update(
        self,
        pairs: PairKinematics,
        p: Floats,
        active: Flags,
        iteration: int,
        linear: Floats | None = None,
    ) -> int:
        node, slip, eps_T = pairs.node, pairs.slip, self._eps_T
        limits, before = self._limits, self.sliding[node]
        measured, p = p, p if linear is None else linear
        if eps_T is not None:
            old, c, value = self._state.history, eps_T[node], self._slips.linear[node]
            t = transport(old.traction[node], old.normal[node], slip.frame_n, slip.normal_n)
            motion = trial = t + c[:, None] * value
        else:
            t, c, value = self.traction[node], self._stiffness[node], self._slips.of(node)
            motion, trial = value, t + (_SLIP_WEIGHT * c)[:, None] * value
        lags = None if self._has_spring else self._pivoting.changes_singly(node)
        limiting = self._lagged.normal_forces(node, p, lags)
        known = float(iteration > 0)  # multipliers at the initial guess are meaningless
        if eps_T is not None:
            judged, limit = limits.of_springs(node, p, length_of(trial), c, before)
        else:
            length = length_of(value) if limits.depends_on_slip else np.zeros(len(node))
            judged = limit = limits.at(node, known * limiting, before * length)
        if iteration == 0 or self.keeps_states:
            heading, sliding, violators = self._first_heading(pairs, motion), before, 0
        else:
            heading, sliding = self._nodal.judge(
                node, self._is_new[node], judged.force, trial, motion
            )
            violates = active & (sliding != before)
            changes, violators = self._pivoting.select(violates, node, iteration)
            sliding ^= violates ^ changes
        if eps_T is not None:
            new = spring_model(limit, trial, p, c, heading, sliding)
            for part in new:
                part[self._on_axis[node]] = 0.0
            of_slip = np.einsum("mij,mj->mi", new.stiffness, slip.value - value)
            new.explicit[:] += of_slip
        else:
            if limits.depends_on_slip:
                limit = limits.at(node, known * limiting, length)
            new = self._exact(pairs, limit, known * t, value, known * limiting, heading, sliding)
        self._nodal.accept(node, active, sliding, measured, value, *new, lags, limiting)
        if eps_T is not None:
            turning = self.traction[node] - of_slip + (p - measured)[:, None] * new.direction
            self._slips.turning[node] = np.where(active[:, None], turning, 0.0)
        if lags is not None:
            violators += int(np.count_nonzero(lags & sliding & active))
        return violators

    def _first_heading(self, pairs: PairKinematics, motion: Floats) -> Floats:
        """Slip directions of nodes in the first iteration, ``(m, 2)``. Local.

        A node without slip has its last slip direction. ``motion`` is the slip of the pairs, shape
        ``(m, 2)`` [m], or with springs their trial traction [N].
        """
        node, old, slip = pairs.node, self._state.history, pairs.slip
        last = transport(old.traction[node], old.normal[node], slip.frame_n, slip.normal_n)
        return np.where(np.any(motion != 0, axis=1)[:, None], motion, last)

    def _exact(
        self,
        pairs: PairKinematics,
        limit: NodalLimit,
        t: Floats,
        slip: Floats,
        p: Floats,
        heading: Floats,
        sliding: Flags,
    ) -> TractionModel:
        """Linearise stick and slip without springs, see `exact_model`.

        At sliding nodes whose displacement cannot be eliminated, the traction has the length of the
        limit; without slip it keeps its direction.
        """
        c = _SLIP_WEIGHT * self._stiffness[pairs.node]
        if not pairs.fixed.any():
            return exact_model(limit, t, slip, p, c, heading, sliding)
        own, largest = ~pairs.fixed, np.maximum(limit.force, 0.0)
        t = np.where((own | ~sliding)[:, None], t, with_length(t, largest))
        c = np.where(own, c, _DIRECTION_WEIGHT * self._stiffness[pairs.node])
        model = exact_model(limit, t, slip, p, c, heading, sliding)
        rests = sliding & ~own & ~slip.any(axis=1)
        model.explicit[rests] = model.stiffness[rests] = 0.0
        slides = sliding & ~own
        scaled = p[:, None] * model.direction
        model.explicit[slides] = (with_length(model.explicit + scaled, largest) - scaled)[slides]
        return model

    def balance(self, pairs: PairKinematics, R: Floats, active: Flags) -> Floats:
        node = pairs.node
        rank, known, direction = self._nodal.known(node, active, pairs.fixed, self._dim)
        friction = known, direction
        multipliers = pairs.blocks.balance(pairs.normal, R, pairs.columns, rank, friction)
        self._nodal.balance(node, active, rank, multipliers, known)
        lambda_N: Floats = multipliers[:, 0]
        return lambda_N

    def follow_multipliers(self, pairs: PairKinematics, lambda_N: Floats, active: Flags) -> None:
        node = pairs.node
        slides = active & ~self.sticks(node, active)
        _, known, direction = self._nodal.known(node, active, pairs.fixed, self._dim)
        traction = known - lambda_N[:, None] * direction
        self.traction[node[slides]] = traction[slides]

    def add_to(
        self, pairs: PairKinematics, active: Flags, force: Floats, tangent: Floats
    ) -> tuple[Floats, Floats]:
        node = pairs.node
        is_linear = isinstance(self._state.pair.enforcement, Penalty)
        turning = self._slips.turning if is_linear else self.traction
        tangent += pairs.slip.tangent(turning[node])
        return self._nodal.add_to(node, active, pairs.force, pairs.columns, force)

    def scheme_work(self, pairs: PairKinematics, dx: Floats) -> Floats:
        if not self._acts_at_end:
            return super().scheme_work(pairs, dx)
        t = self.traction[pairs.node]
        work: Floats = np.einsum("mi,mid,md->m", t, pairs.force[:, 1:], dx)
        return work - pairs.slip.work(t, dx)

    def accepted(self, pairs: PairKinematics, x: Floats) -> tuple[Floats, dict[str, Any]]:
        old, node, slip = self._state.history, pairs.node, pairs.slip
        t = self.traction[node]
        parts: dict[str, Any] = {
            "traction": np.zeros_like(old.traction),
            "normal": np.zeros_like(old.normal),
            "slip": old.slip.copy(),
            "dissipation": np.zeros_like(old.dissipation),
        }
        parts["traction"][node] = np.einsum("mi,mij->mj", t, slip.frame)
        parts["normal"][node] = slip.normal
        length = np.linalg.norm(slip.value, axis=1)
        parts["slip"][node] += np.where(self.sliding[node], length, 0.0)
        dx = (x - self._search.x_n)[pairs.dofs]
        parts["dissipation"][node] = slip.work(t, dx.reshape(pairs.contact.force.shape))
        energy = slip_energy(parts["traction"], self._eps_T)
        parts["dissipation"] -= energy - slip_energy(old.traction, self._eps_T)
        return energy, parts

    class _CoupledStickSlip(NoFriction):
        """Application of the coupled solution to the friction of the pairs."""

        def __init__(self, friction: "StickSlip") -> None:
            self._of = friction

        def coefficients(self, node: Ints) -> Floats:
            """Friction limits per normal force in the last iteration, 0 on an axis of symmetry."""
            of, p = self._of, self._of._lagged.last[node]
            limit = of._limits.at(node, p, of.sliding[node] * length_of(of._slips.of(node)))
            is_cone = (limit.force == limit.by_p * p) | (p == 0)
            secant = np.where(is_cone, limit.by_p, limit.force / np.where(is_cone, 1.0, p))
            return np.where(of._on_axis[node], 0.0, secant)

        def use_all_slips(self, pairs: PairKinematics) -> None:
            """Use all slips in constraints."""
            self._of._slips.use_all(pairs)

        def set_states(
            self, pairs: PairKinematics, slides: Flags, active: Flags, forces: Floats, slip: Floats
        ) -> None:
            """Set the states, and linearise the traction at the coupled solution."""
            of, node, t, p = self._of, pairs.node, forces[:, 1:], -forces[:, 0]
            of.sliding[node] = np.where(active, slides | of._on_axis[node], of.sliding[node])
            slip = of._slips.without_round_off(pairs, slip)
            moves = slides & slip.any(axis=1)
            limit = of._limits.at(node, p, length_of(slip))
            t = np.where(moves[:, None], with_length(slip, limit.force), t)
            model = of._exact(pairs, limit, t, slip, p, t, of.sliding[node])
            for part in model:
                part[of._on_axis[node]] = 0.0
            of._slips.modelled[node], of._lagged.heading[node] = slip, model.direction
            for values, part in zip(of._model, model, strict=True):
                values[node] = part
            of.traction[node] = np.where(active[:, None], t, 0.0)
            of.follow_multipliers(pairs, forces[:, 0], active)

        def predict(self, pairs: PairKinematics, change: Floats) -> None:
            """Predict the slips of the next evaluation, see `Slips.predict`."""
            self._of._slips.predict(pairs, change)
