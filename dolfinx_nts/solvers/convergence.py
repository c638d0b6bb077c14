"""Convergence of Newton's method: what the residual of an iterate says of it."""

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
# In so many iterations after each other given displacements violate constraints: none is left
# to help, as only given displacements can change these gaps.
_GIVEN_ITERATIONS = 6
# Iterations before the last one in which a state contradicted its condition: contact and friction
# of these nodes are why there is no solution.
_UNDECIDED = 6
# Residual of a solution, relative to the forces at work [-]; and where the increments
# have become negligible.
_RESIDUAL_TOLERANCE, _SMALL_RESIDUAL = 1e-12, 1e-8
# Residual, relative to the same, of an iterate that is near enough to the solution for the choice
# of segments [-].
_SETTLED = 1e-3
# Negligible increment and error of a constraint, relative to the smallest cell [-].
_INCREMENT_TOLERANCE, _GAP_TOLERANCE = 5e-14, 2e-11
# Error of a constraint that is round-off, relative to the positions [-].
_GAP_ROUNDING = 16 * _EPS
# Increment and error of a constraint that positions cannot tell from none, relative to them [-]:
# far from the origin their last digit is longer than the tolerances above.
_LAST_DIGITS = 4 * _EPS
# Number of long increments from which on a step with inertia, whose starts are near its end, is
# given up.
_MOST_LONG = 12
# Reduction of the residual [-] that is too little if states do not contradict themselves.
_LITTLE_REDUCTION = 0.1
# Iterations from the first one in which states of contact that contradict themselves may be decided
# all at once, and the period of that later: in between multipliers tell, as they do at points of
# which round-off decides whether they stick. Far from equilibrium statics decides in each where
# there is no friction, so that a minimum of energy is decided, and where only contact holds bodies.
_FIRST_DECISIONS, _DECISION_PERIOD = 3, 5
# Increment, relative to the smallest cell [-], after which slips of bodies that contact alone holds
# decide on something: those that a turn leaves grow with its square.
_NEAR = 0.1
# Residual without inertia, relative to the forces at work [-], below which nodes are decided on one
# by one: factors of an earlier state do not tell which of them hardly stick or hardly slide.
_MARGINAL = 1e-5


class Iterate(NamedTuple):
    """Forces at a displacement.

    Attributes:
        x: Positions of the owned nodes, shape ``(n, 3)`` [m].
        states: Contact, one for each attempt of a pair.
        R: Residual on the owned dofs, with contact, shape ``(d n,)`` [N].
        R_bulk: Residual of the bodies and loads alone, shape ``(d n,)`` [N].
        R_contact: Residual of contact alone, shape ``(d n,)`` [N].
        forces: ``R_bulk`` on all dofs, where displacements are given too [N].
    """

    x: Floats
    states: tuple[ContactContribution, ...]
    R: Floats
    R_bulk: Floats
    R_contact: Floats
    forces: Floats


class Measures(NamedTuple):
    """What an iterate is measured by, the same on all ranks.

    Attributes:
        norm: Norm of the residual [N].
        scale: Norm of the forces at work [N].
        target: Norm of the residual of a solution [N].
        changed: Number of states that contradicted their conditions.
        failed: Number of pairs that do not project.
        is_open: Whether a constraint is not met.
        num_given: Number of constraints that given displacements alone violate.
        solves: Whether forces are in balance and all conditions are met.
    """

    norm: float
    scale: float
    target: float
    changed: int
    failed: int
    is_open: bool
    num_given: int
    solves: bool

    @property
    def is_small(self) -> bool:
        """Whether the residual is small beside the forces at work."""
        return self.norm <= _SMALL_RESIDUAL * self.scale

    @property
    def is_near(self) -> bool:
        """Whether it is that of a state near a solution, without contradictions."""
        return not self.changed and self.norm <= _SETTLED * self.scale


class _Scales(NamedTuple):
    """What is small in a step.

    Attributes:
        increment: Increment that is none [m].
        near: Increment up to which linear slips are good [m].
        gap: Gap that is closed [m].
        rounding: Norm of the residual that rounding leaves [N].
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
        stiffness: That of the owned nodes, shape ``(n,)`` [N/m].
        force_scale: Norm of the forces known before the step [N].
        farthest: Largest coordinate of a node [m].
        inertia: Whether there is any; without, forces may be as small as the round-off of strains.

    Attributes:
        iteration: Number of linear systems solved so far.
        norms: Norms of the residuals before each of them, and the last one [N].
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
        """Begin without an iterate. Collective."""
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
        # Iterates after each other in which given displacements violate constraints.
        self._given = 0
        self._is_polished = False

    def measure(self, iterate: Iterate, *, is_complete: bool) -> Measures:
        """Measure an iterate. Collective.

        Args:
            iterate: Forces at the present displacement.
            is_complete: Whether all displacements are as given.
        """
        R, states, scales = iterate.R, iterate.states, self._scales
        excess = max((state.constraint_error for state in states), default=0.0)
        is_open = not excess <= scales.gap
        num_given = _num_given(self._steps, states) if is_open and is_complete else 0
        counts = [sum(s.changed for s in states), sum(s.failed for s in states), is_open, num_given]
        # Of the last step statics knows no forces that supports make only now.
        fixed = self._bulk.supports.fixed[: 0 if self._inertia else None]
        reactions, contact = iterate.forces[fixed], iterate.R_contact
        squares = [R @ R, contact @ contact, reactions @ reactions]
        squares.append(_round_off_of_contact(states, iterate.x) ** 2)
        sums = reductions.total(self._bulk.comm, list(map(float, [*squares, *counts])))
        norm, contact_norm, reaction, steep = map(math.sqrt, sums[:4])
        changed, failed, num_open, num_given = map(int, sums[4:])
        self.norms.append(norm)
        self._given = self._given + 1 if num_given else 0
        self._changes += changed
        self._last_change = self.iteration if changed else self._last_change
        scale = max(scales.forces, reaction) + contact_norm
        # With inertia the round-off is that of the heaviest body, too much for others.
        target = max(_RESIDUAL_TOLERANCE * scale, 0.0 if self._inertia else scales.rounding)
        is_small = norm <= max(_SMALL_RESIDUAL * scale, scales.rounding, steep)
        is_balanced = norm <= target or (is_small and self._du_norm <= scales.increment)
        solves = is_balanced and is_complete and not (num_open or changed)
        solves = solves and not self._has_to_be_polished(excess, iterate.x)
        return Measures(norm, scale, target, changed, failed, num_open > 0, num_given, solves)

    def _has_to_be_polished(self, excess: float, x: Floats) -> bool:
        """Whether a solution deserves one more linear system, which happens once. Collective.

        Multipliers are not small where gaps are, and what is left of gaps does work.

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
        """Forget the last norm, as so many segments have been chosen anew. Local."""
        self._changes += moved
        self.norms.pop()

    def count_increment(self, du_norm: float, *, is_long: bool) -> None:
        """Note an increment whose largest component is ``du_norm`` [m]. Local.

        ``is_long`` is whether it was too long to be trusted.
        """
        self._du_norm = du_norm
        self._num_long += is_long
        self.iteration += 1

    def needs_cone_problem(self, seen: Measures, *, is_supported: bool) -> bool:
        """Whether states of contact should be decided on all at once. Local.

        ``is_supported`` is whether more than contact supports all bodies. In statics forces of the
        first guess are no basis, and a single node is left to the active-set update.
        """
        later = self.iteration % _DECISION_PERIOD == _DECISION_PERIOD - 1
        is_due = later or self.iteration < _FIRST_DECISIONS
        if self._inertia:
            return is_due and (seen.changed > 0 or seen.is_open or self._is_slow(seen))
        if self.iteration == 0 or seen.changed < 2:
            return False
        if not (is_supported or self._has_minimum or self._du_norm <= self._scales.near):
            return False
        is_far = seen.norm > _SETTLED * seen.scale
        if is_far and (self._has_minimum or not is_supported):
            return True
        return is_due and seen.norm > _MARGINAL * seen.scale

    @property
    def _has_minimum(self) -> bool:
        """Whether a solution is a minimum of an energy, without inertia and friction. Local."""
        return not self._inertia and all(step.state.pair.friction is None for step in self._steps)

    def _is_slow(self, seen: Measures) -> bool:
        """Whether the last increment has not brought the iterate much nearer. Local."""
        if self.iteration == 0:
            return True
        return not seen.is_small and seen.norm > _LITTLE_REDUCTION * self.norms[-2]

    def failure(self, seen: Measures, most: int, *, is_solution: bool) -> str:
        """Say why there is no use in going on, or "". Local.

        Args:
            seen: What the last iterate was measured by.
            most: Number of iterations that are allowed.
            is_solution: Whether it is accepted.
        """
        if not np.isfinite(seen.norm):
            return "the residual is not finite"
        if seen.failed:
            return f"{seen.failed} pairs do not project or have turned by more than 90 degrees"
        if self._is_hopeless:
            return f"bcs move {seen.num_given} nodes into surfaces"
        if not np.isfinite(self._du_norm) and self.iteration:
            return "the linear system is singular"
        if is_solution:
            return ""
        if self._num_long == _MOST_LONG and self._inertia:
            return f"{self._num_long} increments were longer than half of the smallest cell"
        if self.iteration == most:
            return f"no convergence in {self.iteration} iterations"
        return ""

    @property
    def _is_hopeless(self) -> bool:
        """Whether given displacements move nodes into surfaces, from wherever it starts."""
        return self._given == _GIVEN_ITERATIONS

    def report(self, reason: str) -> NewtonReport:
        """Report at the end, for which there is a reason if it is no solution. Local."""
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
    """What the last digits of positions up to this far from the origin [m] tell, [m]. Local."""
    return _LAST_DIGITS * farthest


def gap_tolerance(size: float, digits: float) -> float:
    """Gap up to which one is closed [m]. Local.

    Args:
        size: Size of the smallest cell [m].
        digits: As of `position_rounding` [m].
    """
    return max(_GAP_TOLERANCE * size, digits)


def _num_given(steps: Sequence[ContactStep], states: Sequence[ContactContribution]) -> int:
    """Number of this rank's constraints that given displacements alone violate. Local."""
    return sum(len(prescribed_nodes(step, s)) for step, s in zip(steps, states, strict=True))


def _round_off(bulk: Bulk, stiffness: Floats, sizes: CellSizes) -> float:
    """Norm of the residual that rounding leaves in any case [N]. Collective.

    A strain is known up to eps, and up to eps |u|/h; with the stiffness k of
    a node and the size h of its cells this is a force of eps k (h + |u|). Where
    bodies are rigid k is that of inertia, whose increment is known up to eps |u|.
    """
    u = bulk.u.x.array[: bulk.num_owned].reshape(-1, bulk.rigid.dim)
    length = np.sqrt((u * u) @ np.ones(bulk.rigid.dim))
    forces = _EPS * stiffness * (sizes.nodal + length)
    return math.sqrt(reductions.total(bulk.comm, float(forces @ forces)))


def _round_off_of_contact(states: Sequence[ContactContribution], x: Floats) -> float:
    """Norm of the forces that rounding leaves in gaps and slips [N]. Local.

    They are known up to eps |x|. A node that slides, but has hardly moved, has a direction of
    friction that turns with the last digits.
    """
    slopes = sum(float(np.vdot(state.slopes, state.slopes)) for state in states)
    if slopes == 0:
        return 0.0
    return _EPS * _kernels.largest_size(x) * math.sqrt(slopes)
