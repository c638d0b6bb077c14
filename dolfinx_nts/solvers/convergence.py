"""Convergence criteria of Newton's method."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.implicit.prescribed import prescribed_nodes
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.cell_sizes import CellSizes
from dolfinx_nts.solvers.newton_report import NewtonReport

__all__ = ["Convergence", "Iterate", "Measures", "gap_tolerance", "position_rounding"]

_EPS = float(np.finfo(np.float64).eps)
# Consecutive iterations with constraints violated by prescribed displacements alone, after which
# the step is infeasible: no unknown changes these gaps.
_INFEASIBLE_ITERATIONS = 6
# Number of last iterations [-] in which a change of contact or friction states makes a failed
# attempt undecided.
_UNDECIDED = 6
# Residual of a solution relative to the force scale [-]; and its limit if increments are
# negligible.
_RESIDUAL_TOLERANCE, _SMALL_RESIDUAL = 1e-12, 1e-8
# Residual, relative to the force scale [-], below which segments are chosen again.
_SETTLED = 1e-3
# Negligible increment and error of a constraint, relative to the smallest cell [-].
_INCREMENT_TOLERANCE, _GAP_TOLERANCE = 5e-14, 2e-11
# Round-off of a constraint, relative to the positions [-].
_GAP_ROUNDING = 16 * _EPS
# Resolution of increments and constraints, relative to the positions [-]. Far from the origin it
# exceeds the tolerances above.
_LAST_DIGITS = 4 * _EPS
# Reduction of the residual by an iteration [-] that counts as slow.
_LITTLE_REDUCTION = 0.1
# Number of initial iterations in which the cone problem may be solved, and period of iterations in
# which it may be solved later. In the other iterations multipliers determine the states, which is
# better where round-off decides between stick and slip. Far from equilibrium statics solves it in
# every iteration, if there is no friction (the problem is a minimisation) or if only contact
# supports bodies.
_FIRST_DECISIONS, _DECISION_PERIOD = 3, 5
# Increment relative to the smallest cell [-] below which linearised slips of bodies supported only
# by contact are accurate enough for the cone problem: errors due to rotation grow with its square.
_NEAR = 0.1
# Residual in statics, relative to the force scale [-], below which states change node by node:
# factors of an earlier state are too inaccurate for nodes close to the limit of sliding.
_MARGINAL = 1e-5


class Iterate(NamedTuple):
    """Forces at a displacement.

    Attributes:
        x: Positions of the owned nodes, shape ``(n, 3)`` [m].
        states: Evaluated contact of each pair.
        R: Residual on the owned dofs, with contact, shape ``(d n,)`` [N].
        R_bulk: Residual of the bodies and loads alone, shape ``(d n,)`` [N].
        R_contact: Residual of contact alone, shape ``(d n,)`` [N].
        forces: ``R_bulk`` on all dofs, also where displacements are prescribed [N].
    """

    x: Floats
    states: tuple[ContactContribution, ...]
    R: Floats
    R_bulk: Floats
    R_contact: Floats
    forces: Floats


class Measures(NamedTuple):
    """Norms and counts of an iterate, the same on all ranks.

    Attributes:
        norm: Norm of the residual [N].
        scale: Norm of the current forces [N].
        target: Norm of the residual of a solution [N].
        changed: Number of states that violated their conditions.
        failed: Number of pairs without a valid projection.
        is_violated: Whether a constraint is violated.
        num_prescribed: Number of constraints violated by prescribed displacements alone.
        solves: Whether forces are in balance and all conditions are satisfied.
    """

    norm: float
    scale: float
    target: float
    changed: int
    failed: int
    is_violated: bool
    num_prescribed: int
    solves: bool

    @property
    def is_small(self) -> bool:
        """Whether the residual is small relative to the force scale."""
        return self.norm <= _SMALL_RESIDUAL * self.scale

    @property
    def is_near(self) -> bool:
        """Whether the iterate is close to a solution, and no state violates its condition."""
        return not self.changed and self.norm <= _SETTLED * self.scale


class _Scales(NamedTuple):
    """Tolerances of a step.

    Attributes:
        increment: Increment that counts as zero [m].
        near: Increment up to which linearised slips are accurate [m].
        gap: Gap that counts as closed [m].
        rounding: Round-off of the residual [N].
        forces: Norm of the forces known before the step [N].
    """

    increment: float
    near: float
    gap: float
    rounding: float
    forces: float


class Convergence:
    """Measures the iterates of one attempt at a step, and keeps their history.

    Args:
        bulk: Residual of the bodies.
        steps: Contact attempts.
        sizes: Sizes of the cells.
        stiffness: Stiffness of the owned nodes, shape ``(n,)`` [N/m].
        force_scale: Norm of the forces known before the step [N].
        farthest: Largest coordinate of a node [m].
        inertia: Whether there is inertia; in statics, forces may be as small as the round-off of
            strains.

    Attributes:
        iteration: Number of linear systems solved so far.
        norms: Norms of the residuals before each linear system, and the last one [N].
    """

    def __init__(
        self,
        bulk: Bulk,
        steps: Sequence[ContactStep],
        sizes: CellSizes,
        stiffness: Floats,
        *,
        force_scale: float,
        farthest: float,
        inertia: bool,
    ) -> None:
        self._bulk, self._steps, self._inertia = bulk, steps, inertia
        digits = position_rounding(farthest)
        self._scales = _Scales(
            max(_INCREMENT_TOLERANCE * sizes.smallest, digits),
            _NEAR * sizes.smallest,
            gap_tolerance(sizes.smallest, digits),
            _round_off(bulk, stiffness, sizes),
            force_scale,
        )
        self.iteration = 0
        self.norms: list[float] = []
        self._du_norm, self._num_long = np.inf, 0
        self._changes, self._last_change = 0, -np.inf
        # Number of consecutive iterates in which prescribed displacements violate constraints.
        self._num_infeasible = 0
        self._is_polished = False

    def measure(self, iterate: Iterate, *, is_complete: bool) -> Measures:
        """Measure an iterate. Collective.

        Args:
            iterate: Forces at the current displacement.
            is_complete: Whether the prescribed motion has been applied completely.
        """
        R, states, scales = iterate.R, iterate.states, self._scales
        excess = max((state.constraint_error for state in states), default=0.0)
        is_violated = not excess <= scales.gap
        num_prescribed = _num_prescribed(self._steps, states) if is_violated and is_complete else 0
        counts = [
            sum(s.changed for s in states),
            sum(s.failed for s in states),
            is_violated,
            num_prescribed,
        ]
        # In statics, forces of the last step do not include the reactions to new prescribed
        # displacements.
        fixed = self._bulk.supports.fixed[: 0 if self._inertia else None]
        reactions, contact = iterate.forces[fixed], iterate.R_contact
        squares = [R @ R, contact @ contact, reactions @ reactions]
        squares.append(_round_off_of_contact(states, iterate.x) ** 2)
        sums = reductions.total(self._bulk.comm, list(map(float, [*squares, *counts])))
        norm, contact_norm, reaction, steep = map(math.sqrt, sums[:4])
        changed, failed, num_open, num_prescribed = map(int, sums[4:])
        self.norms.append(norm)
        self._num_infeasible = self._num_infeasible + 1 if num_prescribed else 0
        self._changes += changed
        self._last_change = self.iteration if changed else self._last_change
        scale = max(scales.forces, reaction) + contact_norm
        # With inertia the round-off of the heaviest body dominates, which is too large for other
        # bodies.
        target = max(_RESIDUAL_TOLERANCE * scale, 0.0 if self._inertia else scales.rounding)
        # Forces that begin in this step, such as those of heat, are in the first residual.
        largest = max(scale, self.norms[0])
        is_small = norm <= max(_SMALL_RESIDUAL * largest, scales.rounding, steep)
        is_balanced = norm <= target or (is_small and self._du_norm <= scales.increment)
        solves = is_balanced and is_complete and not (num_open or changed)
        solves = solves and not self._has_to_be_polished(excess, iterate.x)
        return Measures(norm, scale, target, changed, failed, num_open > 0, num_prescribed, solves)

    def _has_to_be_polished(self, excess: float, x: Floats) -> bool:
        """Whether to refine a solution by one additional linear system, at most once. Collective.

        Multipliers may be large, so that they do work on tiny remaining gaps.

        Args:
            excess: Largest error of a constraint on this rank [m].
            x: Positions of the owned nodes, shape ``(n, 3)`` [m].
        """
        if self._is_polished or not self.iteration or self._du_norm <= self._scales.increment:
            return False
        self._is_polished = True
        rounding = _GAP_ROUNDING * _kernels.largest_size(x)
        return reductions.anywhere(self._bulk.comm, bool(excess > rounding))

    def discard_last(self, moved: int) -> None:
        """Discard the last norm, after a number of segments have changed. Local."""
        self._changes += moved
        self.norms.pop()

    def count_increment(self, du_norm: float, *, is_long: bool) -> None:
        """Record an increment with the largest component ``du_norm`` [m]. Local.

        ``is_long`` is whether it exceeded the trust radius.
        """
        self._du_norm = du_norm
        self._num_long += is_long
        self.iteration += 1

    def needs_cone_problem(self, seen: Measures, *, is_supported: bool) -> bool:
        """Whether the states of all contact points should be set by the cone problem. Local.

        ``is_supported`` is whether no body is supported only by contact. In statics the cone
        problem is not used at the initial guess, whose forces are far from the solution, nor for a
        single violated state.
        """
        later = self.iteration % _DECISION_PERIOD == _DECISION_PERIOD - 1
        is_due = later or self.iteration < _FIRST_DECISIONS
        if self._inertia:
            return is_due and (seen.changed > 0 or seen.is_violated or self._is_slow(seen))
        if self.iteration == 0 or seen.changed < 2:
            return False
        if self._du_norm > self.cone_trust_radius(is_supported=is_supported):
            return False
        is_far = seen.norm > _SETTLED * seen.scale
        if is_far and (self._has_minimum or not is_supported):
            return True
        return is_due and seen.norm > _MARGINAL * seen.scale

    def cone_trust_radius(self, *, is_supported: bool) -> float:
        """Trust radius of increments after a cone problem has set the contact states [m]. Local.

        In statics, the problem contains linearised slips. If only friction supports a body, wrong
        slips let it drift away. Otherwise there is no limit. ``is_supported`` is as for
        `needs_cone_problem`.
        """
        has_limit = not (self._inertia or is_supported or self._has_minimum)
        return self._scales.near if has_limit else math.inf

    @property
    def _has_minimum(self) -> bool:
        """Whether a solution minimises an energy: statics without friction. Local."""
        return not self._inertia and all(step.state.pair.friction is None for step in self._steps)

    @property
    def reduces_little(self) -> bool:
        """Whether the last iteration left more than a tenth of the residual. Local."""
        return len(self.norms) > 1 and self.norms[-1] > _LITTLE_REDUCTION * self.norms[-2]

    def _is_slow(self, seen: Measures) -> bool:
        """Whether the last iteration hardly reduced the residual. Local."""
        if self.iteration == 0:
            return True
        return not seen.is_small and self.reduces_little

    def failure(
        self, seen: Measures, most: int, *, is_solution: bool, most_long: int | None = None
    ) -> str:
        """Reason to stop without a solution, or "". Local.

        Args:
            seen: Measures of the last iterate.
            most: Largest number of iterations.
            is_solution: Whether the iterate is accepted.
            most_long: Largest number of increments longer than the trust radius; None without a
                limit.
        """
        if not np.isfinite(seen.norm):
            return "the residual is not finite"
        if seen.failed:
            return (
                f"{seen.failed} contact points do not project on their segments, or their normals "
                "have turned by more than 90 degrees"
            )
        if self._is_hopeless:
            return f"bcs move {seen.num_prescribed} nodes into surfaces"
        if not np.isfinite(self._du_norm) and self.iteration:
            return "the linear system is singular"
        if is_solution:
            return ""
        if self._num_long == most_long:
            return f"{self._num_long} increments were longer than half of the smallest cell"
        if self.iteration == most:
            return f"no convergence in {self.iteration} iterations"
        return ""

    @property
    def _is_hopeless(self) -> bool:
        """Whether prescribed displacements alone have violated constraints in too many iterates."""
        return self._num_infeasible == _INFEASIBLE_ITERATIONS

    def report(self, reason: str) -> NewtonReport:
        """Create the report, with the reason of a failure or "". Local."""
        return NewtonReport(
            self.iteration,
            self._changes,
            tuple(self.norms),
            sum(step.num_active for step in self._steps),
            reason,
            is_hopeless=self._is_hopeless,
            is_undecided=bool(reason) and self.iteration - self._last_change < _UNDECIDED,
        )


def position_rounding(farthest: float) -> float:
    """Resolution [m] of positions up to a distance [m] from the origin. Local."""
    return _LAST_DIGITS * farthest


def gap_tolerance(size: float, digits: float) -> float:
    """Largest gap that counts as closed [m]. Local.

    Args:
        size: Size of the smallest cell [m].
        digits: Result of `position_rounding` [m].
    """
    return max(_GAP_TOLERANCE * size, digits)


def _num_prescribed(steps: Sequence[ContactStep], states: Sequence[ContactContribution]) -> int:
    """Number of constraints of this rank that prescribed displacements alone violate. Local."""
    return sum(len(prescribed_nodes(step, s)) for step, s in zip(steps, states, strict=True))


def _round_off(bulk: Bulk, stiffness: Floats, sizes: CellSizes) -> float:
    """Norm of the round-off of the residual [N]. Collective.

    The error of a strain is eps (1 + |u|/h) with the machine epsilon. With the stiffness k of a
    node and the size h of its cells this is a force of eps k (h + |u|). In rigid bodies k is the
    inertial stiffness, whose increment has an error of eps |u|.
    """
    u = bulk.u.x.array[: bulk.num_owned].reshape(-1, bulk.rigid.dim)
    length = np.sqrt((u * u) @ np.ones(bulk.rigid.dim))
    forces = _EPS * stiffness * (sizes.nodal + length)
    return math.sqrt(reductions.total(bulk.comm, float(forces @ forces)))


def _round_off_of_contact(states: Sequence[ContactContribution], x: Floats) -> float:
    """Norm of the forces caused by round-off of gaps and slips [N]. Local.

    Their error is eps |x|. Round-off also changes the direction of friction at sliding nodes with
    small slips.
    """
    slopes = sum(float(np.vdot(state.slopes, state.slopes)) for state in states)
    if slopes == 0:
        return 0.0
    return _EPS * _kernels.largest_size(x) * math.sqrt(slopes)
