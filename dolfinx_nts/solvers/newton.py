"""Newton's method for one step, with an update of the active set in each iteration.

An iteration evaluates the residual with the states of contact, measures it, and adds the solution
of the linear system, shortened to the trust radius. `_Iteration` has one method for each of these.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.timing import Timings
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.implicit.contact_step import ContactStep, contact_residual
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.implicit.coupled.cone_states import predict_slips
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.cell_sizes import CellSizes
from dolfinx_nts.solvers.convergence import Convergence, Iterate, Measures
from dolfinx_nts.solvers.line_search import LineSearch
from dolfinx_nts.solvers.linear.krylov import LinearSolver
from dolfinx_nts.solvers.newton_report import NewtonReport
from dolfinx_nts.solvers.nonlinear_elimination import NonlinearElimination
from dolfinx_nts.solvers.prescribed_motion import PrescribedMotion
from dolfinx_nts.solvers.segment_choice import SegmentChoice
from dolfinx_nts.solvers.statics.drag import Drag
from dolfinx_nts.solvers.statics.inertia_relief import InertiaRelief

__all__ = ["Attempt", "NewtonSystem", "Solution", "solve"]

_logger = logging.getLogger("dolfinx_nts")

# Largest numbers of iterations.
_MAX_ITERATIONS = 50  # for an attempt from one starting guess
_MAX_STICKING = 100  # for attempts in which all nodes with friction stick at first
_MAX_RESISTED = 20  # for an attempt with viscous resistance
# Trust radius relative to the smallest cell, and to the prescribed increment [-].
_LONGEST_INCREMENT, _ALONG = 0.5, 2.0
# Trust radius, relative to the smallest cell, for rigid bodies without inertia or support: they
# must not pass through their contact partners.
_LONGEST_FALL = 0.2
# Residual, relative to the target, below which the line search is off [-], as virtual works of the
# last increments are round-off.
_NEARLY_SOLVED = 1e3
# Requested reductions of the linear solver [-]: weakest one; and in the first iteration, as changes
# of the active set limit the reduction of the residual to about a tenth.
_LEAST_REDUCTION, _FIRST_REDUCTION = 0.3, 0.03
# Weakest reduction in statics [-]: larger errors would move bodies supported only by contact, and
# cause sliding of nodes with small slips.
_STATIC_REDUCTION = 1e-4
# Largest number of linear systems in an iteration that remove suppressed motions, and remaining
# fraction of the motions [-] below which no further system is solved. One system is enough for a
# brick that slides along one axis.
_MOST_RESPONSES, _SLIDES = 6, 1e-3
# Reduction in the first iteration of an impact [-], if one application of the preconditioner
# achieves it: the nonlinearity of the step is of similar size.
_ROUGH_REDUCTION = 0.15
# Forcing terms for quadratic convergence: factor and exponent of the last reduction (S. C.
# Eisenstat, H. F. Walker, SIAM J. Sci. Comput. 17 (1996), choice 2).
_RATE_FACTOR, _RATE_POWER = 0.9, 1.6
# Residual of the last iteration relative to the target [-], and ratio of the forcing term to the
# reduction for this residual [-] up to which the iteration is the last one.
_AIM, _NEAR = 0.3, 1e3


@dataclass(frozen=True)
class NewtonSystem:
    """Nonlinear system that all steps of a stepper have in common.

    Attributes:
        bulk: Forms; ``bulk.u`` is the unknown and holds the starting guess.
        linear: Solver of the linear systems.
        X: Reference positions of the owned nodes, shape ``(n, 3)`` [m].
        relief: Inertia relief of bodies that only contact supports.
        sizes: Sizes of the cells.
        inertia: Whether there is inertia; in statics, forces may be as small as the round-off of
            strains.
        jumps: Whether stresses have discontinuous tangents, which need a line search.
        elimination: Solver for the nodes around contacts, applied to the first iterate, if any.
    """

    bulk: Bulk
    linear: LinearSolver
    X: Floats
    relief: InertiaRelief
    sizes: CellSizes
    inertia: bool
    jumps: bool
    elimination: NonlinearElimination | None


@dataclass(frozen=True)
class Attempt:
    """Attempt at a step from one starting guess.

    Attributes:
        steps: Contact of the pairs.
        motion: Prescribed motion of supports, guides and obstacles.
        force_scale: Norm of the forces known before the step [N].
        timings: Receives the wall time of the phases.
        is_unchanged: Whether the starting guess is a previous solution and nothing has changed
            since; it is then accepted.
        drag: Viscous resistance, if any.
        begins_sticking: Whether nodes with friction stick at first and slide only near an
            equilibrium, which takes more iterations.
        most_long: Number of increments longer than the trust radius after which the attempt fails;
            None if there is no limit.
    """

    steps: Sequence[ContactStep]
    motion: PrescribedMotion
    force_scale: float
    timings: Timings
    is_unchanged: bool = False
    drag: Drag | None = None
    begins_sticking: bool = False
    most_long: int | None = None

    @property
    def most_iterations(self) -> int:
        """Largest number of iterations without those that apply prescribed increments."""
        if self.begins_sticking:
            return _MAX_STICKING
        return _MAX_RESISTED if self.drag is not None else _MAX_ITERATIONS


@dataclass(frozen=True)
class Solution:
    """Last iterate of Newton's method, and its report.

    Attributes:
        end: Forces and contact of the last iterate.
        report: Iterations, norms and the reason of a failure.
    """

    end: Iterate
    report: NewtonReport


def solve(system: NewtonSystem, attempt: Attempt) -> Solution:
    """Iterate from the current u. Collective.

    Returns:
        The solution; ``report.reason`` is not empty if there is none.
    """
    iteration = _Iteration(system, attempt)
    while True:
        iterate = iteration.evaluate()
        if iterate is None:
            continue
        seen = iteration.measure(iterate)
        converged = iteration.is_converged(seen)
        if converged is None:
            continue
        reason = iteration.failure(seen, is_solution=converged)
        if converged or reason:
            return Solution(iterate, iteration.convergence.report(reason))
        if not iteration.eliminates(iterate):
            iteration.update(iterate, seen)


class _Iteration:
    """State of the iteration of an attempt. Methods are collective unless noted."""

    def __init__(self, system: NewtonSystem, attempt: Attempt) -> None:
        self._system, self._attempt = system, attempt
        bulk, dim = system.bulk, system.bulk.rigid.dim
        self._nodes = bulk.u.x.array[: bulk.num_owned].reshape(-1, dim)
        self._balanced = True  # whether multipliers are computed from the nodal balance
        self._segments = SegmentChoice(bulk.comm, attempt.steps, not system.inertia)
        self._target = 0.0  # target of the last residual
        system.relief.begin()
        springs = system.inertia and bool(attempt.steps) and all(map(_has_springs, attempt.steps))
        self._search = LineSearch(bulk, springs=springs) if system.jumps or springs else None
        # In statics the cone problem uses factors of the elastic tangent, which are wrong in
        # plastic flow.
        may_decide = system.inertia or not system.jumps
        self._may_decide = may_decide and not attempt.begins_sticking
        self._num_local = 0  # number of contact evaluations in the nonlinear elimination
        farthest = _kernels.largest_size(self._x)
        self.convergence = Convergence(
            bulk,
            attempt.steps,
            system.sizes,
            system.linear.nodal_resistance(),
            force_scale=attempt.force_scale,
            farthest=reductions.largest(bulk.comm, farthest),
            inertia=system.inertia,
        )

    @property
    def _x(self) -> Floats:
        """Current positions of the owned nodes, ``(n, 3)`` [m]. Local."""
        return self._system.X + in_space(self._nodes)

    @property
    def _is_first(self) -> bool:
        """Whether neither a linear system nor the nonlinear elimination was solved yet. Local."""
        return self.convergence.iteration == self._num_local == 0

    def evaluate(self) -> Iterate | None:
        """Forces and contact of the current u; None if the line search has shortened it."""
        system, attempt, x = self._system, self._attempt, self._x
        bulk, relief, motion, steps = system.bulk, system.relief, attempt.motion, attempt.steps
        with attempt.timings.phase("assembly"):
            forces = bulk.forces()
            R_bulk = forces.copy()
            R_bulk[bulk.is_prescribed] = 0
            if attempt.drag is not None:
                R_bulk += attempt.drag.force()
            if self._search is not None and not self._search.springs:
                if self._search.cuts(R_bulk):
                    return None
                self._search.forget()
        R_free = R_bulk - relief.force.ravel()
        R_nodes = R_free.reshape(self._nodes.shape) if self._balanced else None
        with attempt.timings.phase("contact"):
            number = self.convergence.iteration + self._num_local
            states = tuple(step.evaluate(x, R_nodes, number) for step in steps)
            R_contact = contact_residual(steps, states, self._nodes.shape)
        R = relief.relieve(R_free + R_contact, x, attempt.force_scale, steps, states)
        R = bulk.rigid.balance(self._nodes, R.reshape(self._nodes.shape)).ravel()
        R = motion.add_forces(R, states, self._target)
        if self._search is not None and self._search.springs:
            if self._search.cuts(R):
                return None
            self._search.forget()
        return Iterate(x, states, R, R_bulk, R_contact, forces)

    def measure(self, iterate: Iterate) -> Measures:
        """Norms and counts of an iterate."""
        seen = self.convergence.measure(iterate, is_complete=self._attempt.motion.is_complete)
        self._target = seen.target
        return seen

    def is_converged(self, seen: Measures) -> bool | None:
        """Whether an iterate is a solution; None if it changed and has to be evaluated again."""
        iteration = self.convergence.iteration
        if self._attempt.is_unchanged and iteration == 0 and seen.is_small:
            return not seen.is_violated
        if seen.solves and not self._system.relief.accept():
            return None
        if self._attempt.steps:
            is_near = iteration > 0 and seen.is_near
            moved = self._segments.renew(seen.norm, is_near=is_near, converged=seen.solves)
            if moved:  # near equilibrium, but nodes have left their segments
                self.convergence.discard_last(moved)
                return None
        return seen.solves

    def failure(self, seen: Measures, *, is_solution: bool) -> str:
        """Reason to stop without a solution, or "". Local."""
        attempt, number = self._attempt, self.convergence.iteration
        most = attempt.most_iterations + attempt.motion.duration
        reason = self.convergence.failure(
            seen, most, is_solution=is_solution, most_long=attempt.most_long
        )
        _logger.debug("iteration %d: |R| = %.3e N", number, seen.norm)
        return reason

    def eliminates(self, iterate: Iterate) -> bool:
        """Whether the nonlinear elimination has changed the first iterate."""
        system = self._system
        if not self._is_first or system.elimination is None:
            return False
        self._num_local = system.elimination.eliminate(self._attempt.steps, iterate, system.X)
        if self._num_local:
            self.convergence.discard_last(0)
        return self._num_local > 0

    def update(self, iterate: Iterate, seen: Measures) -> None:
        """Solve the linear system of an iterate and add its solution to u."""
        R, states = iterate.R, self._attempt.motion.predict(iterate.states)
        decided = self._set_contact_states(iterate, states, seen)
        R, states = decided or (R, states)
        du, du_norm, longest = self._increment(R, states, seen)
        if decided:
            is_supported = not self._system.relief.bodies
            longest = min(longest, self.convergence.cone_trust_radius(is_supported=is_supported))
        system, attempt, motion = self._system, self._attempt, self._attempt.motion
        part = longest / du_norm if du_norm > longest else 1.0
        if self._search is not None and not motion.advances:
            if seen.norm > _NEARLY_SOLVED * seen.target:
                self._search.begin(du, part, R, iterate.R_bulk)
        if part < 1:
            with np.errstate(invalid="ignore"):  # a singular system is reported by `failure`
                du = part * du
        self._nodes[:] = motion.advance(self._nodes, du.reshape(self._nodes.shape), part)
        if du_norm <= longest:
            with attempt.timings.phase("contact"):
                for step, state in zip(attempt.steps, states, strict=True):
                    step.close_gaps(state, self._x, self._nodes)
        system.bulk.u.x.scatter_forward()
        self.convergence.count_increment(du_norm, is_long=du_norm > longest)

    def _set_contact_states(
        self, iterate: Iterate, states: tuple[ContactContribution, ...], seen: Measures
    ) -> tuple[Floats, tuple[ContactContribution, ...]] | None:
        """Set contact states by the cone problem if due; return residual and states, or None."""
        system, attempt, R = self._system, self._attempt, iterate.R
        steps, relief = attempt.steps, system.relief
        is_supported = not relief.bodies
        if not self._may_decide:
            return None
        if not self.convergence.needs_cone_problem(seen, is_supported=is_supported):
            return None
        with attempt.timings.phase("solve"):
            decided = system.linear.consistent_states(R, steps, states, system.inertia, relief)
        if decided is None:
            return None
        R_contact = contact_residual(steps, decided, self._nodes.shape)
        R = iterate.R_bulk - relief.force.ravel() + R_contact
        R = system.bulk.rigid.balance(self._nodes, R.reshape(self._nodes.shape)).ravel()
        return attempt.motion.add_forces(R, decided), decided

    def _increment(
        self, R: Floats, states: tuple[ContactContribution, ...], seen: Measures
    ) -> tuple[Floats, float, float]:
        """Solution of the linear system [m], its largest component and the trust radius [m]."""
        system, attempt, dim = self._system, self._attempt, self._nodes.shape[1]
        with attempt.timings.phase("solve"):
            rtol = self._reduction(seen)
            du, dlambda = system.linear.solve(R, attempt.steps, states, rtol)
            if len(system.relief.loads) and self.convergence.reduces_little:
                du, dlambda = self._without_suppressed_motions(R, states, rtol, du, dlambda)
        du = attempt.motion.limit(system.relief.restrain(du))
        self._balanced = dlambda is None
        if dlambda is not None:
            for step, state, d in zip(attempt.steps, states, dlambda, strict=True):
                step.add_multipliers(state, d)
                predict_slips(step, state, du.reshape(-1, dim))
        du_norm = reductions.largest(system.bulk.comm, _kernels.largest_size(du))
        if system.bulk.rigid.has_no_inertia:
            return du, du_norm, _LONGEST_FALL * system.sizes.smallest
        longest = max(_LONGEST_INCREMENT * system.sizes.smallest, _ALONG * attempt.motion.length)
        return du, du_norm, longest

    def _without_suppressed_motions(
        self,
        R: Floats,
        states: tuple[ContactContribution, ...],
        rtol: float,
        du: Floats,
        dlambda: list[Floats] | None,
    ) -> tuple[Floats, list[Floats] | None]:
        """Solution of the linear system, with the suppressed motions removed almost completely.

        Bodies that slide far along each other deform, so that removing only the rigid motion from
        the increment would leave forces out of balance. Instead, inertial forces that stop the
        motions are added, with amplitudes by least squares from a few linear solutions.
        """
        system, relief, comm = self._system, self._system.relief, self._system.bulk.comm
        rest = amplitudes = relief.amplitudes(du)
        moved, responses, others = list[Floats](), list[Floats](), list[list[Floats] | None]()
        parts: Floats = np.zeros(0)
        while len(moved) < min(_MOST_RESPONSES, len(rest)):
            load = rest @ relief.loads
            size, of_load = reductions.total(comm, np.array([R @ R, load @ load]))
            if not (np.isfinite(of_load) and of_load > 0):
                break
            forces = R + np.sqrt(size / of_load) * load
            other, d_other = system.linear.solve(forces, self._attempt.steps, states, rtol)
            response = relief.amplitudes(other - du)
            if not np.isfinite(response).all():
                break
            moved.append(other - du)
            responses.append(response)
            others.append(d_other)
            parts = np.linalg.lstsq(np.array(responses).T, -amplitudes, rcond=None)[0]
            rest = amplitudes + parts @ np.array(responses)
            if np.linalg.norm(rest) <= _SLIDES * np.linalg.norm(amplitudes):
                break
        if not moved:
            return du, dlambda
        if dlambda is not None:
            known = [other for other in others if other is not None]
            if len(known) < len(others):
                return du + parts @ np.array(moved), None
            for i, own in enumerate(dlambda):
                change = (p * (each[i] - own) for p, each in zip(parts, known, strict=True))
                dlambda[i] = own + sum(change)
        return du + parts @ np.array(moved), dlambda

    def _reduction(self, seen: Measures) -> float:
        """Requested reduction of the residual by the linear solver [-]. Local."""
        rtol = _forcing(self.convergence.norms, seen.target)
        if self._is_first and seen.changed > 0:
            if self._system.linear.one_application_reduction <= _ROUGH_REDUCTION:
                rtol = max(rtol, _ROUGH_REDUCTION)
        return rtol if self._system.inertia else min(rtol, _STATIC_REDUCTION)


def _has_springs(step: ContactStep) -> bool:
    """Whether contact is by springs in a step. Local."""
    return isinstance(step.state.pair.enforcement, Penalty)


def _forcing(norms: Sequence[float], target: float) -> float:
    """Requested reduction of the linear solver: forcing term of an inexact Newton method.

    If it would almost reach the target, it is reduced to reach it, which saves the last iteration.
    """
    if norms[-1] <= _AIM * target:
        return _LEAST_REDUCTION
    rate = norms[-1] / norms[-2] if len(norms) > 1 and norms[-2] > 0 else 1.0
    quadratic = min(_FIRST_REDUCTION, _RATE_FACTOR * rate**_RATE_POWER)
    last = _AIM * target / norms[-1]
    return min(_LEAST_REDUCTION, last if quadratic < _NEAR * last else quadratic)
