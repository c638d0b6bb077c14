"""Newton's method for one step, with an update of the active set in each iteration."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.timing import Timings
from dolfinx_nts.contact.implicit.contact_step import ContactStep, contact_residual, predict
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.implicit.prescribed import prescribed_nodes
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.cell_sizes import CellSizes
from dolfinx_nts.solvers.drag import Drag
from dolfinx_nts.solvers.free_bodies import FreeBodies
from dolfinx_nts.solvers.krylov import LinearSolver
from dolfinx_nts.solvers.line_search import LineSearch
from dolfinx_nts.solvers.segment_choice import SegmentChoice
from dolfinx_nts.solvers.support_way import SupportWay

__all__ = ["ConvergenceError", "NewtonReport", "closed_within", "last_digits", "solve"]


_logger = logging.getLogger("dolfinx_nts")

_MAX_ITERATIONS = 50  # until another start is tried
_MAX_STICKING = 100  # where nodes with friction slide only near an equilibrium
_MAX_DRAGGED = 20  # until a resistance, or a larger one, is tried
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
_GAP_ROUNDING = 16 * np.finfo(np.float64).eps
# Increment and error of a constraint that positions cannot tell from none, relative to them [-]:
# far from the origin their last digit is longer than the tolerances above.
_LAST_DIGITS = 4 * float(np.finfo(np.float64).eps)
# Longest increment that is trusted, relative to the smallest cell [-], and the number of longer
# ones from which on a step with inertia, whose starts are near its end, is given up.
_LONGEST_INCREMENT, _MOST_LONG = 0.5, 12
# The same where loads push rigid bodies that nothing holds as yet: they must not go by what they
# are to touch.
_LONGEST_FALL = 0.2
# Residual, relative to the target, below which no line is searched [-]: Newton's method is at its
# end, and works of increments are round-off soon.
_NEARLY_SOLVED = 1e3
# Iterations from the first one in which states of contact that contradict themselves may be decided
# all at once, and the period of that later: in between multipliers tell, as they do at points of
# which round-off decides whether they stick.
_FIRST_DECISIONS, _DECISION_PERIOD = 3, 5
# Residual without inertia, relative to the forces at work [-], below which nodes are decided on one
# by one: factors of an earlier state do not tell which of them hardly stick or hardly slide.
_MARGINAL = 1e-5
# Reduction of the residual [-] that is too little if states do not contradict themselves.
_LITTLE_REDUCTION = 0.1
# Reductions asked of the linear solver [-]: the least; the first, as active sets let
# residuals fall by no more than a tenth.
_LEAST_REDUCTION, _FIRST_REDUCTION = 0.3, 0.03
# The least without inertia: what is left moves bodies far that contact alone holds, and wakes
# the friction of nodes that hardly slip.
_STATIC_REDUCTION = 1e-4
# Those that quadratic convergence can use: factor and power of the last reduction
# (S. C. Eisenstat, H. F. Walker, SIAM J. Sci. Comput. 17 (1996), choice 2).
_RATE_FACTOR, _RATE_POWER = 0.9, 1.6
# Share of the target that is aimed at, and how much more than quadratic convergence can
# use may be asked for where that saves an iteration [-].
_AIM, _NEAR = 0.3, 1e3


@dataclass(frozen=True)
class NewtonReport:
    """What the iteration did, and why it stopped.

    Attributes:
        iterations: Linear solves.
        active_set_changes: Pairs that changed, summed over iterations.
        residual_norms: Euclidean norm of the residual before each
            linear solve, and the last one [N].
        num_active: Active pairs at the end.
        reason: Why the iteration stopped, empty if it converged.
        is_hopeless: Whether it would stop as well from any other start.
        is_undecided: Whether it stopped while states of nodes contradicted their conditions.
    """

    iterations: int
    active_set_changes: int
    residual_norms: tuple[float, ...]
    num_active: int
    reason: str
    is_hopeless: bool = False
    is_undecided: bool = False

    @property
    def converged(self) -> bool:
        """Whether the iteration found a solution."""
        return not self.reason

    def __str__(self) -> str:
        """Reason and the last residual norms."""
        norms = ", ".join(f"{norm:.2e}" for norm in self.residual_norms[-6:])
        return f"{self.reason} (iteration {self.iterations}, |R| ... {norms} N)"


class ConvergenceError(RuntimeError):
    """A step could not be solved; the last accepted state is intact.

    Attributes:
        reports: One report for each attempt.

    Example:
        >>> stepper.set_velocity(other, (0.0, 0.0, -100.0))  # too fast for steps of 0.01 s
        >>> try:
        ...     step = stepper.advance()
        ... except nts.ConvergenceError as error:
        ...     print(len(error.reports), stepper.t)
        3 0.0
    """

    def __init__(self, message: str, reports: Sequence[NewtonReport]) -> None:
        """Create the error with a message."""
        super().__init__(message)
        self.reports = tuple(reports)


@dataclass(frozen=True)
class Solution:
    """State of the contacts at the end of the iteration, with the residuals [N].

    ``forces`` is the residual of the bodies on all dofs, given or not.
    """

    states: tuple[ContactContribution, ...]
    R: Floats
    R_bulk: Floats
    forces: Floats
    report: NewtonReport


def last_digits(farthest: float) -> float:
    """What the last digits of positions up to this far from the origin [m] tell, [m]. Local."""
    return _LAST_DIGITS * farthest


def closed_within(size: float, digits: float) -> float:
    """Gap up to which one is closed [m], see `solve`. Local.

    Args:
        size: Size of the smallest cell [m].
        digits: As of `last_digits` [m].
    """
    return max(_GAP_TOLERANCE * size, digits)


def solve(
    bulk: Bulk,
    solver: LinearSolver,
    steps: Sequence[ContactStep],
    X: Floats,
    *,
    free: FreeBodies,
    at_rest: bool,
    sizes: CellSizes,
    force_scale: float,
    inertia: bool,
    jumps: bool,
    timings: Timings,
    drag: Drag | None = None,
    begins_sticking: bool = False,
) -> Solution:
    """Iterate from the present u. Collective.

    Where the guess is behind its conditions, `SupportWay` makes it follow them.

    Args:
        bulk: Forms; ``bulk.u`` is the unknown and holds the guess.
        solver: Solver of the linear systems.
        steps: Contact attempts.
        X: Reference positions of the owned nodes, shape ``(n, 3)`` [m].
        free: Bodies that contact alone may hold.
        at_rest: Whether nothing has changed since a solution, which then still is one.
        sizes: Those of the cells.
        force_scale: Norm of the forces known before the step [N].
        inertia: Whether there is any; without, forces may be as small as
            the round-off of strains.
        jumps: Whether stresses have tangents that jump, so that lines are searched.
        timings: Receives the wall time of the phases.
        drag: Resistance that acts beside the forces, if any.
        begins_sticking: Whether nodes with friction stick at first, as ``steps`` say, and slide
            only near an equilibrium, which takes more iterations.

    Returns:
        The solution; ``report.reason`` is not empty if there is none.
    """
    most = _MAX_DRAGGED if drag is not None else _MAX_ITERATIONS
    if begins_sticking:
        most = _MAX_STICKING
    n, size, dim = bulk.num_owned, sizes.smallest, bulk.rigid.dim
    norms: list[float] = []
    changes = 0
    du_norm = np.inf
    num_long = 0
    last_change = -np.inf  # iteration in which a state contradicted its condition
    given = 0  # iterations after each other in which given displacements violate constraints
    polished = False
    balanced = True  # multipliers from the normal balance at the nodes
    segments = SegmentChoice(bulk.comm, steps, not inertia)
    way = SupportWay(bulk)
    free.begin()
    search = LineSearch(bulk) if jumps else None
    floor = _round_off(bulk, solver.nodal_resistance(), sizes)
    nodes = bulk.u.x.array[:n].reshape(-1, dim)
    x = X + in_space(nodes)
    digits = last_digits(reductions.largest(bulk.comm, float(np.abs(x).max(initial=0.0))))
    negligible = max(_INCREMENT_TOLERANCE * size, digits)
    closed = closed_within(size, digits)
    iteration = 0
    while True:
        x = X + in_space(nodes)
        with timings.phase("assembly"):
            forces = bulk.forces()
            R_bulk = forces.copy()
            R_bulk[bulk.given] = 0
            if drag is not None:
                R_bulk += drag.force()
            if search is not None:
                if search.cuts(R_bulk):
                    continue
                search.forget()
        R_nodes = R_bulk.reshape(-1, dim) - free.force if balanced else None
        with timings.phase("contact"):
            states = tuple(step.evaluate(x, R_nodes, iteration) for step in steps)
            R_contact = contact_residual(steps, states, (len(X), dim))
        R = free.relieve(R_bulk - free.force.ravel() + R_contact, x, force_scale, steps, states)
        R = bulk.rigid.balance(nodes, R.reshape(-1, dim)).ravel()
        R = way.pull(R)

        excess = max((s.constraint_error for s in states), default=0.0)
        counts = [sum(s.changed for s in states), sum(s.failed for s in states)]
        is_open = not excess <= closed
        counts += [is_open, _num_given(steps, states) if is_open and way.is_over else 0]
        # Of the last step statics knows no forces that supports make only now.
        reactions = forces[bulk.supports.fixed] if not inertia else forces[:0]
        squares = [R @ R, R_contact @ R_contact, _round_off_of_contact(states, x) ** 2]
        squares.append(reactions @ reactions)
        sums = reductions.total(bulk.comm, np.array([*squares, *counts]))
        norm, contact_norm, steep, reaction = (float(value) for value in np.sqrt(sums[:4]))
        changed, failed, violated, num_given = (int(value) for value in sums[4:])
        given = given + 1 if num_given else 0
        norms.append(norm)
        changes += changed
        last_change = iteration if changed else last_change
        scale = max(force_scale, reaction) + contact_norm
        # With inertia the floor is that of the heaviest body, too much for others.
        target = max(_RESIDUAL_TOLERANCE * scale, 0.0 if inertia else floor)
        small = norm <= max(_SMALL_RESIDUAL * scale, floor, steep)
        small = small and du_norm <= negligible
        solved = norm <= target or small
        converged = solved and not violated and not changed and way.is_over
        if converged and not polished and iteration and du_norm > negligible:
            # Multipliers are not small where gaps are: what is left of these does work.
            polished = True
            rounding = _GAP_ROUNDING * np.abs(x).max(initial=0.0)
            if reductions.anywhere(bulk.comm, excess > rounding):
                converged = False
        is_near = iteration > 0 and not changed and norm <= _SETTLED * scale
        if at_rest and iteration == 0 and norm <= _SMALL_RESIDUAL * scale:
            converged = not violated
        elif converged and not free.settles():
            continue
        elif steps:
            moved = segments.renew(norm, is_near=is_near, converged=converged)
            if moved:  # this is, or nearly so, the equilibrium on segments that nodes have left
                changes += moved
                norms.pop()
                continue

        if not np.isfinite(norm):
            reason = "the residual is not finite"
        elif failed:
            reason = f"{failed} pairs do not project or have turned by more than 90 degrees"
        elif given == _GIVEN_ITERATIONS:
            reason = f"bcs move {num_given} nodes into surfaces"
        elif not np.isfinite(du_norm) and iteration:
            reason = "the linear system is singular"
        elif num_long == _MOST_LONG and inertia and not converged:
            reason = f"{num_long} increments were longer than half of the smallest cell"
        elif iteration == most and not converged:
            reason = f"no convergence in {iteration} iterations"
        else:
            reason = ""
        _logger.debug("iteration %d: |R| = %.3e N", iteration, norm)
        if converged or reason:
            num_active = sum(step.num_active for step in steps)
            hopeless = given == _GIVEN_ITERATIONS
            undecided = bool(reason) and iteration - last_change < _UNDECIDED
            report = NewtonReport(
                *(iteration, changes, tuple(norms), num_active, reason, hopeless, undecided)
            )
            return Solution(states, R, R_bulk, forces, report)

        if inertia:
            far = norm > _SMALL_RESIDUAL * scale
            slow = iteration == 0 or (far and norm > _LITTLE_REDUCTION * norms[-2])
            doubtful = slow or changed or violated
        else:  # forces of the first guess tell little, one node can change by itself
            far = iteration > 0 and norm > _MARGINAL * scale
            doubtful = changed > 1 and far and not begins_sticking
        if doubtful and _may_decide(iteration):
            with timings.phase("solve"):
                decided = solver.decided(R, steps, states, inertia)
            if decided is not None:
                states = decided
                R = R_bulk + contact_residual(steps, states, (len(X), dim))
                R = way.pull(bulk.rigid.balance(nodes, R.reshape(-1, dim)).ravel())
        with timings.phase("solve"):
            rtol = _forcing(norms, target)
            if not inertia:
                rtol = min(rtol, _STATIC_REDUCTION)
            du, dlambda = solver.solve(R, steps, states, rtol)
        du = way.follow(free.restrain(du))
        balanced = dlambda is None
        if dlambda is not None:
            for step, state, d in zip(steps, states, dlambda, strict=True):
                step.add_multipliers(state, d)
                predict(step, state, du.reshape(-1, dim))
        du_norm = reductions.largest(bulk.comm, float(np.abs(du).max(initial=0.0)))
        longest = (_LONGEST_FALL if bulk.rigid.has_no_inertia else _LONGEST_INCREMENT) * size
        part = 1.0
        if du_norm > longest:
            num_long += 1
            part = longest / du_norm
        if search is not None and way.is_over and norm > _NEARLY_SOLVED * target:
            search.begin(du, part, R, R_bulk)
        if part < 1:
            with np.errstate(invalid="ignore"):  # of a singular system, which is told
                du = part * du
        nodes[:] = bulk.rigid.moved(nodes, du.reshape(-1, dim))
        way.go()
        if du_norm <= longest and not changed:  # nodes that have just become active have far to go
            x = X + in_space(nodes)
            with timings.phase("contact"):
                for step, state in zip(steps, states, strict=True):
                    step.close_gaps(state, x, nodes)
        bulk.u.x.scatter_forward()
        iteration += 1


def _may_decide(iteration: int) -> bool:
    """Whether states of contact are decided all at once in an iteration. Local."""
    later = iteration % _DECISION_PERIOD == _DECISION_PERIOD - 1
    return iteration < _FIRST_DECISIONS or later


def _num_given(steps: Sequence[ContactStep], states: Sequence[ContactContribution]) -> int:
    """Number of this rank's constraints that given displacements alone violate. Local."""
    return sum(len(prescribed_nodes(step, s)) for step, s in zip(steps, states, strict=True))


def _round_off(bulk: Bulk, stiffness: Floats, sizes: CellSizes) -> float:
    """Norm of the residual that rounding leaves in any case [N]. Collective.

    A strain is known up to eps, and up to eps |u|/h; with the stiffness k of
    a node and the size h of its cells this is a force of eps k (h + |u|). Where
    bodies are rigid k is that of inertia, whose increment is known up to eps |u|.
    """
    u = np.linalg.norm(bulk.u.x.array[: bulk.num_owned].reshape(-1, bulk.rigid.dim), axis=1)
    forces = np.finfo(np.float64).eps * stiffness * (sizes.nodal + u)
    return float(np.sqrt(reductions.total(bulk.comm, forces @ forces)))


def _round_off_of_contact(states: Sequence[ContactContribution], x: Floats) -> float:
    """Norm of the forces that rounding leaves in gaps and slips [N]. Local.

    They are known up to eps |x|. A node that slides, but has hardly moved, has a direction of
    friction that turns with the last digits.
    """
    slopes = sum(float(np.vdot(state.slopes, state.slopes)) for state in states)
    if slopes == 0:
        return 0.0
    return float(np.finfo(np.float64).eps * np.abs(x).max(initial=0.0) * np.sqrt(slopes))


def _forcing(norms: Sequence[float], target: float) -> float:
    """Reduction asked of the linear solver: no more than Newton's method can use.

    Where this leads close to the target, the target is aimed at, which saves
    the next iteration.
    """
    if norms[-1] <= _AIM * target:
        return _LEAST_REDUCTION
    rate = norms[-1] / norms[-2] if len(norms) > 1 and norms[-2] > 0 else 1.0
    quadratic = min(_FIRST_REDUCTION, _RATE_FACTOR * rate**_RATE_POWER)
    last = _AIM * target / norms[-1]
    return min(_LEAST_REDUCTION, last if quadratic < _NEAR * last else quadratic)
