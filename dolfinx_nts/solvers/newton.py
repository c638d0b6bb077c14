"""Newton's method for one step, with an update of the active set in each iteration."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.timing import Timings
from dolfinx_nts.contact.implicit.contact_step import ContactStep, contact_residual
from dolfinx_nts.contact.implicit.decided_step import predict
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.cell_sizes import CellSizes
from dolfinx_nts.solvers.convergence import Convergence, Iterate
from dolfinx_nts.solvers.drag import Drag
from dolfinx_nts.solvers.inertia_relief import InertiaRelief
from dolfinx_nts.solvers.krylov import LinearSolver
from dolfinx_nts.solvers.line_search import LineSearch
from dolfinx_nts.solvers.newton_report import NewtonReport
from dolfinx_nts.solvers.nonlinear_elimination import NonlinearElimination
from dolfinx_nts.solvers.prescribed_motion import PrescribedMotion
from dolfinx_nts.solvers.segment_choice import SegmentChoice

__all__ = ["Solution", "solve"]


_logger = logging.getLogger("dolfinx_nts")

# Largest numbers of iterations, in addition to those with a prescribed increment.
_MAX_ITERATIONS = 50  # before another starting guess
_MAX_STICKING = 100  # if all nodes with friction stick at first
_MAX_RESISTED = 20  # before a larger viscous resistance
# Trust radius relative to the smallest cell, and to the prescribed increment [-].
_LONGEST_INCREMENT, _ALONG = 0.5, 2.0
# Trust radius, relative to the smallest cell, for rigid bodies without inertia or support: they
# must not pass through their contact partners.
_LONGEST_FALL = 0.2
# Residual, relative to the target, below which the line search is off [-], as virtual works of the
# last increments are round-off.
_NEARLY_SOLVED = 1e3
# Reductions asked of the linear solver [-]: the weakest; the first, since changing active sets
# limit the reduction of the residual to about a tenth.
_LEAST_REDUCTION, _FIRST_REDUCTION = 0.3, 0.03
# The weakest in statics: errors would move bodies that only contact supports, and cause sliding of
# nodes that hardly slip.
_STATIC_REDUCTION = 1e-4
# The first one at an impact, if one application of the preconditioner achieves it: the nonlinearity
# of the step is of similar size.
_ROUGH_REDUCTION = 0.15
# Forcing terms for quadratic convergence: factor and power of the last reduction (S. C. Eisenstat,
# H. F. Walker, SIAM J. Sci. Comput. 17 (1996), choice 2).
_RATE_FACTOR, _RATE_POWER = 0.9, 1.6
# Fraction of the target that is aimed at, and factor by which the reduction may exceed the forcing
# term to save the last iteration [-].
_AIM, _NEAR = 0.3, 1e3


@dataclass(frozen=True)
class Solution:
    """Last iterate of the iteration, and its report.

    Attributes:
        end: Forces and contact of the last iterate.
        report: Iterations, norms and the reason of a failure.
    """

    end: Iterate
    report: NewtonReport


def solve(
    bulk: Bulk,
    solver: LinearSolver,
    steps: Sequence[ContactStep],
    X: Floats,
    *,
    motion: PrescribedMotion,
    relief: InertiaRelief,
    is_unchanged: bool,
    sizes: CellSizes,
    force_scale: float,
    inertia: bool,
    jumps: bool,
    timings: Timings,
    drag: Drag | None = None,
    begins_sticking: bool = False,
    nonlinear_elimination: NonlinearElimination | None = None,
) -> Solution:
    """Iterate from the current u. Collective.

    Args:
        bulk: Forms; ``bulk.u`` is the unknown and holds the starting guess.
        solver: Solver of the linear systems.
        steps: Contact attempts.
        X: Reference positions of the owned nodes, shape ``(n, 3)`` [m].
        motion: Prescribed motion of supports, guides and obstacles.
        relief: Inertia relief of bodies that only contact supports.
        is_unchanged: Whether nothing has changed since a solution, which is then accepted.
        sizes: Sizes of the cells.
        force_scale: Norm of the forces known before the step [N].
        inertia: Whether there is inertia; in statics, forces may be as small as the round-off of
            strains.
        jumps: Whether stresses have discontinuous tangents, which need a line search.
        timings: Receives the wall time of the phases.
        drag: Viscous resistance, if any.
        begins_sticking: Whether nodes with friction stick at first and slide only near an
            equilibrium, which takes more iterations.
        nonlinear_elimination: Solver for the nodes around contacts, applied to the first iterate.

    Returns:
        The solution; ``report.reason`` is not empty if there is none.
    """
    most = _MAX_RESISTED if drag is not None else _MAX_ITERATIONS
    if begins_sticking:
        most = _MAX_STICKING
    dim = bulk.rigid.dim
    nodes = bulk.u.x.array[: bulk.num_owned].reshape(-1, dim)
    balanced = True  # whether multipliers follow from the nodal balance
    segments = SegmentChoice(bulk.comm, steps, not inertia)
    target = 0.0  # target of the last residual
    relief.begin()
    search = LineSearch(bulk) if jumps else None
    # In statics the cone problem uses factors of the elastic tangent, wrong in plastic flow.
    may_decide = (inertia or not jumps) and not begins_sticking
    num_local = 0  # contact evaluations of the nonlinear elimination
    farthest = _kernels.largest_size(X + in_space(nodes))
    convergence = Convergence(
        bulk,
        steps,
        sizes,
        solver.nodal_resistance(),
        force_scale=force_scale,
        farthest=reductions.largest(bulk.comm, farthest),
        inertia=inertia,
    )
    while True:
        x, iteration = X + in_space(nodes), convergence.iteration
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
        R_free = R_bulk - relief.force.ravel()
        R_nodes = R_free.reshape(-1, dim) if balanced else None
        with timings.phase("contact"):
            number = iteration + num_local
            states = tuple(step.evaluate(x, R_nodes, number) for step in steps)
            R_contact = contact_residual(steps, states, (len(X), dim))
        R = relief.relieve(R_free + R_contact, x, force_scale, steps, states)
        R = motion.add_forces(bulk.rigid.balance(nodes, R.reshape(-1, dim)).ravel(), states, target)
        iterate = Iterate(x, states, R, R_bulk, R_contact, forces)
        seen = convergence.measure(iterate, is_complete=motion.is_complete)
        target = seen.target

        converged = seen.solves
        if is_unchanged and iteration == 0 and seen.is_small:
            converged = not seen.is_open
        elif converged and not relief.accept():
            continue
        elif steps:
            is_near = iteration > 0 and seen.is_near
            moved = segments.renew(seen.norm, is_near=is_near, converged=converged)
            if moved:  # (nearly) in equilibrium, but on segments that nodes have left
                convergence.discard_last(moved)
                continue

        reason = convergence.failure(seen, most + motion.duration, is_solution=converged)
        _logger.debug("iteration %d: |R| = %.3e N", iteration, seen.norm)
        if converged or reason:
            return Solution(iterate, convergence.report(reason))
        if iteration == num_local == 0 and nonlinear_elimination is not None:
            num_local = nonlinear_elimination.eliminate(steps, iterate, X)
            if num_local:
                convergence.discard_last(0)
                continue

        states = motion.predict(states)
        if may_decide and convergence.needs_cone_problem(seen, is_supported=not relief.bodies):
            with timings.phase("solve"):
                decided = solver.consistent_states(R, steps, states, inertia, relief)
            if decided is not None:
                states = decided
                R_contact = contact_residual(steps, states, (len(X), dim))
                R = R_bulk - relief.force.ravel() + R_contact
                R = motion.add_forces(bulk.rigid.balance(nodes, R.reshape(-1, dim)).ravel(), states)
        with timings.phase("solve"):
            rtol = _forcing(convergence.norms, seen.target)
            begins_in_contact = iteration == num_local == 0 and seen.changed > 0
            if begins_in_contact and solver.one_application_reduction <= _ROUGH_REDUCTION:
                rtol = max(rtol, _ROUGH_REDUCTION)
            if not inertia:
                rtol = min(rtol, _STATIC_REDUCTION)
            du, dlambda = solver.solve(R, steps, states, rtol)
        du = motion.limit(relief.restrain(du))
        balanced = dlambda is None
        if dlambda is not None:
            for step, state, d in zip(steps, states, dlambda, strict=True):
                step.add_multipliers(state, d)
                predict(step, state, du.reshape(-1, dim))
        du_norm = reductions.largest(bulk.comm, _kernels.largest_size(du))
        longest = _LONGEST_FALL if bulk.rigid.has_no_inertia else _LONGEST_INCREMENT
        longest *= sizes.smallest
        if not bulk.rigid.has_no_inertia:
            longest = max(longest, _ALONG * motion.length)
        part = longest / du_norm if du_norm > longest else 1.0
        if search is not None and not motion.advances and seen.norm > _NEARLY_SOLVED * seen.target:
            search.begin(du, part, R, R_bulk)
        if part < 1:
            with np.errstate(invalid="ignore"):  # a singular system is reported below
                du = part * du
        nodes[:] = motion.advance(nodes, du.reshape(-1, dim), part)
        if du_norm <= longest:
            x = X + in_space(nodes)
            with timings.phase("contact"):
                for step, state in zip(steps, states, strict=True):
                    step.close_gaps(state, x, nodes)
        bulk.u.x.scatter_forward()
        convergence.count_increment(du_norm, is_long=du_norm > longest)


def _forcing(norms: Sequence[float], target: float) -> float:
    """Reduction asked of the linear solver: the forcing term of an inexact Newton method.

    If it leads close to the target, the target is aimed at, which saves the last iteration.
    """
    if norms[-1] <= _AIM * target:
        return _LEAST_REDUCTION
    rate = norms[-1] / norms[-2] if len(norms) > 1 and norms[-2] > 0 else 1.0
    quadratic = min(_FIRST_REDUCTION, _RATE_FACTOR * rate**_RATE_POWER)
    last = _AIM * target / norms[-1]
    return min(_LEAST_REDUCTION, last if quadratic < _NEAR * last else quadratic)
