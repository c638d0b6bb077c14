r"""Implicit steppers, which solve the balance of momentum of a step by Newton's method.

The unknown is u_{n+1}. The velocity follows from it as
:math:`v_{n+1} = 2 (u_{n+1} - u_n)/\Delta t - v_n`. The balance of momentum of a step, divided
by its length, is

.. math:: M \frac{2}{\Delta t} \left( \frac{u_{n+1} - u_n}{\Delta t} - v_n
   \right) + f_{int} + f_{damp} + \sum \lambda_N F = f_{ext}.

Schemes differ in the stress of f_int and in the kernel of the contact force F, see `Scheme`;
statics and the generalised-alpha method also in the inertia, see `Rates`.
"""

import logging
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any, NamedTuple, cast

import numpy as np
from dolfinx import fem

from dolfinx_nts import _kernels, compat
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arguments import kind_of, with_article
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.checks.short_contacts import ShortContacts
from dolfinx_nts.contact.checks.stiff_nodes import warn_of_stiff_nodes
from dolfinx_nts.contact.enforcement import LagrangeMultiplier, Penalty
from dolfinx_nts.contact.implicit.accepted_contact import (
    contact_history,
    contact_work,
    obstacle_work,
)
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.implicit.normal.interface import eligible_or_excluded
from dolfinx_nts.contact.implicit.solution_checks import (
    check_boundaries,
    check_forces,
    check_penetration,
    passing_without_contact,
)
from dolfinx_nts.contact.massless import is_resolved, massless_nodes
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.vertices import VertexState, add_vertices, release_vertices
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.fem.node_numbering import geometry_unchanged
from dolfinx_nts.integrators.implicit.attempt import AdmissibleMotion, Start, StepProblem
from dolfinx_nts.integrators.implicit.inertia import ConsistentInertia, Inertia
from dolfinx_nts.integrators.implicit.released_springs import ReleasedSprings
from dolfinx_nts.integrators.implicit.scheme_checks import check_stress, make_rates
from dolfinx_nts.integrators.implicit.sleeping import SleepingBodies
from dolfinx_nts.integrators.implicit.static_stiffness import choose_default_stiffness
from dolfinx_nts.integrators.implicit.step_forces import Reactions, StepForces, StepWorks
from dolfinx_nts.integrators.implicit.step_solver import StepSolver
from dolfinx_nts.integrators.massless.resolved_impact import ResolvedImpact
from dolfinx_nts.integrators.rates import MidpointRates, NoRates, Rates
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.rigid import (
    check_closed_contact,
    check_statics,
    gives_rigid_nodes,
    rigid_motion,
)
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.integrators.statics.mean_forces import MeanForces
from dolfinx_nts.integrators.statics.relaxation import IF_IT_MOVES
from dolfinx_nts.integrators.step_failure import SHORTER_STEP_HELPS, StepFailure
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.loads.load import Load
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers import newton
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.cell_sizes import CellSizes
from dolfinx_nts.solvers.convergence import gap_tolerance, position_rounding
from dolfinx_nts.solvers.linear.krylov import LinearSolver
from dolfinx_nts.solvers.linear.statistics import SolverStatistics
from dolfinx_nts.solvers.newton_report import ConvergenceError, NewtonReport
from dolfinx_nts.solvers.precond.tangent import Tangent
from dolfinx_nts.solvers.prescribed_motion import PrescribedMotion
from dolfinx_nts.solvers.statics.inertia_relief import InertiaRelief

__all__ = ["ImplicitStepper", "StepEquations", "equations_of", "observed"]

_logger = logging.getLogger("dolfinx_nts")

# Largest number of solutions of a step [-]. Each one searches for contact along the motion of the
# previous one. Two nearly always suffice; more take time in steps that are rejected in the end.
_MOST_SEARCHES = 4
# Number of increments longer than the trust radius after which an attempt with inertia fails [-].
# Its starting guesses are close to the solution, so more iterations rarely help.
_MOST_LONG = 12


class ImplicitStepper(Stepper):
    """Base class of steppers that solve for the displacement at the end of a step.

    A subclass has the attribute ``scheme``, a `Scheme`: of the class, or of the object and set
    before ``super().__init__()``. Arguments, attributes and errors as for `EnergyMomentum`.
    Collective, as are all its methods.

    Example:
        >>> class MyMidpoint(nts.ImplicitStepper):
        ...     scheme = nts.Midpoint.scheme
        >>> MyMidpoint(bodies, dt=0.01).step
        0
    """

    # Called with the contact of each step before it is accepted, see `observed`.
    _observer: Callable[[Sequence[ContactStep], Sequence[ContactContribution]], None] | None = None

    @geometry_unchanged()
    @compat.quicker_ffcx()  # UFL derivatives query cells as often as FFCx does.
    def __init__(
        self,
        bodies: Sequence[Body],
        pairs: Sequence[ContactPair] = (),
        *,
        dt: float,
        bcs: Sequence[fem.DirichletBC] = (),
        loads: Sequence[Load] = (),
        update: Callable[[float], None] | None = None,
        petsc_options: Mapping[str, Any] | None = None,
    ) -> None:
        self._check_scheme()
        super().__init__(bodies, pairs, dt=dt, bcs=bcs, loads=loads, update=update)
        check_stress(self.scheme, self.bodies)
        self._rates = make_rates(self.scheme, self, self._dt, bodies)
        self.watch.overlaps.is_static = self._is_static
        if self._is_static:
            check_statics(self.bodies, self.supports.fixed)
            warn_of_stiff_nodes(self.bodies, self.pairs)
        elif self.scheme.contact == "static":
            check_closed_contact(self.bodies, self.pairs, type(self).__name__)
        ends = self.scheme.ends_for_loads(self.u_n, self.u)
        works = [load.form(*ends) for load in self.loads]
        if self.scheme.load_point != 1:
            both = zip(self.loads, works, strict=True)
            works = [self._script.with_copies(load, work) for load, work in both]
        massless = massless_nodes(self.bodies, self.pairs)
        self._inertia: Inertia
        if any(map(is_resolved, self.pairs)):
            rates = cast(MidpointRates, self._rates)
            self._inertia = ResolvedImpact(
                bodies, rates, self.scheme, bcs, works, massless, self.memory
            )
        else:
            self._inertia = ConsistentInertia(
                bodies, self._rates, self.scheme, bcs, works, self.memory
            )
        self._bulk.rigid = rigid_motion(bodies, self._rates, self.scheme, self._bulk.supports)
        self.supports = self._bulk.supports
        self._motion = AdmissibleMotion(self._bulk, self.u, self.u_n)
        # For norms of forces lumped masses are accurate enough.
        nodal_mass = lumped_mass(bodies)
        self._lumped_mass: Floats = np.repeat(nodal_mass, self._bulk.rigid.dim)
        # A multiplier at a node of a rigid body stops the whole body, from which GeneralizedAlpha
        # gains energy.
        stops_rigid = self._is_static or self.scheme.contact != "static"
        excluded = () if stops_rigid else self.bodies
        vertices = add_vertices(self.contacts, excluded, is_static=self._is_static)
        self._all_contacts = (*self.contacts, *vertices)
        self._step_solver = StepSolver(
            self._bulk,
            self._tangent,
            self._rates,
            self.scheme,
            self.bodies,
            self._all_contacts,
            self.loads,
            self._lumped_mass,
            petsc_options,
            flows=self.memory.flows,
        )
        self._released_springs = None
        if not self._is_static:
            self.watch.impacts = ShortContacts(bodies, self.contacts, nodal_mass)
            free = self._step_solver.free
            self._released_springs = ReleasedSprings(bodies, self._bulk, self.v, free)
        self._reactions = Reactions(
            self._bulk,
            self.bodies,
            MeanForces(self.node_ids, self._bulk.rigid.dim, 1 + len(self.loads))
            if self._is_static
            else None,
            at_mean=self.scheme.loads_at == "mean",
        )
        self._forces = StepForces(self._bulk, self._lumped_mass)

    @property
    def _bulk(self) -> Bulk:
        return self._inertia.bulk

    @property
    def _tangent(self) -> Tangent:
        return self._inertia.tangent

    @property
    def _solver(self) -> LinearSolver:
        return self._step_solver.linear

    def _with_defaults(self, pair: ContactPair) -> ContactPair:
        """Pair with default laws: springs with inertia, multipliers in statics. Collective.

        Multipliers at nodes of rigid bodies, and their friction, alternate from step to step.
        """
        rigid = gives_rigid_nodes(pair, self.bodies)
        law = LagrangeMultiplier() if self.scheme.rates is NoRates else Penalty()
        return pair.with_defaults(law, nodal=rigid)

    @property
    def _sleeping(self) -> SleepingBodies:
        return self._step_solver.sleeping

    @property
    def _sizes(self) -> CellSizes:
        return self._step_solver.sizes

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute.

        Raises:
            AttributeError: It is the scheme, which has been evaluated.
        """
        if name == "scheme" and "_rates" in vars(self):
            kind = type(self).__name__
            raise AttributeError(
                f"expected no change of scheme after the creation of {with_article(kind)}: set it "
                "before super().__init__(), or create another stepper"
            )
        super().__setattr__(name, value)

    def _check_scheme(self) -> None:
        """Check that there is a scheme for this kind of stepper.

        Raises:
            TypeError: There is none.
        """
        if not isinstance(given := getattr(self, "scheme", None), Scheme):
            raise TypeError(
                f"expected a Scheme as the attribute scheme of {type(self).__name__}, set before "
                f"super().__init__(), given {'none' if given is None else kind_of(given)}"
            )

    @property
    def _is_static(self) -> bool:
        return self._rates.acceleration is None

    @property
    def _copies(self) -> Mapping[Any, Any]:
        return self._script.copies

    @property
    def _updates(self) -> bool:
        return self._script.updates

    def serialize(self, archive: Archive) -> None:
        """Serialize the state, including the rates and the linear solver."""
        super().serialize(archive)
        self._forces.serialize(archive)
        if self._reactions.means is not None:
            self._reactions.means.serialize(archive)
        self._rates.serialize(archive, self.node_ids)
        self._solver.serialize(archive)
        if archive.restores:
            self._bulk.rigid.restored()

    def copy_state(
        self,
        archive: Archive,
        contacts: Mapping[int, str],
        *,
        same_scheme: bool,
        same_bodies: bool,
    ) -> None:
        """Copy the state of another scene, and its rates if the scheme is the same."""
        super().copy_state(archive, contacts, same_scheme=same_scheme, same_bodies=same_bodies)
        if self._reactions.means is not None:
            self._reactions.means.forget()
        if same_scheme:
            self._rates.serialize(archive, self.node_ids)

    def nodal_momentum(self) -> Floats:
        return self._inertia.momentum()

    def carried(self, forces: Floats) -> Floats:
        return self._inertia.carried(forces)

    def _check_state(self) -> None:
        super()._check_state()
        self._bulk.rigid.check(self._motion.owned(self._u), self._motion.owned(self.v.x.array))

    def _set(self, function: fem.Function, body: Body, value: Any) -> None:
        super()._set(function, body, value)
        self._bulk.rigid.mark_set(body, function.name)

    def _state_was_set(self) -> None:
        self._rates.forget()
        self.watch.forget()
        self._forces.forget()

    def _begin(self, t_n: float, t: float) -> None:
        super()._begin(t_n, t)
        self._bulk.rigid.guides.prescribe(t_n, t)

    def _prescribed(self) -> list[tuple[str, Any]]:
        return self._bulk.rigid.guides.by_name()

    def _turns(self) -> list[tuple[str, float]]:
        return super()._turns() + self._bulk.rigid.guides.turns()

    def _step(self) -> StepReport:
        """Try Newton's method from each starting guess until one succeeds."""
        mass, share = self._step_solver.mass, self.scheme.stress_share
        choose_default_stiffness(
            *(self._all_contacts, self.bodies, self._tangent, self._rates, mass, self._dt, share),
            self._step_solver.free,
        )
        load = self._forces.norm(self._forces.loads()) if self.loads else 0.0
        if not np.isfinite(load):
            raise ValueError(f"expected finite loads, given loads of {load} N in this step")
        self._bulk.rigid.begin(self._motion.owned(self._u_n))
        is_unchanged = partial(self._is_unchanged, load)
        forces = self._forces_at_start
        prescribed = partial(self._motion.prescribed, self.x, self.contacts)
        self._rates.begin(
            forces, self._step_solver.free, self._bulk.rigid, is_unchanged, prescribed
        )
        starts = [
            Start(name, self._motion.displacements(u), u, most_long=self._most_long(name))
            for name, u in self._rates.starts().items()
        ]
        problem = self._problem(starts, load)
        reports: dict[str, NewtonReport] = {}
        for start in self._attempts(starts, reports) if self._tries else ():
            steps, solution = self._solve(start, problem)
            if self._sleeping.must_wake(steps):
                steps, solution = self._solve(start, problem, all_awake=True)
            reports[start.name] = self._checked_report(steps, solution, problem)
            if reports[start.name].converged:
                self.watch.vertices.accept()
                return self._accepted(steps, solution, reports.values(), load)
            if solution.report.is_hopeless:
                break
        advice = self._step_solver.relief.advice() or self._step_length_advice()
        hopeless = any(report.is_hopeless for report in reports.values())
        if self._relaxes and not hopeless and (found := self._relaxed(starts[-1], problem)):
            steps, solution = found
            reports["relaxed"] = solution.report
            if solution.report.converged:
                report = self._accepted(steps, solution, reports.values(), load)
                self._rates.forget()  # After a jump the rate is no predictor.
                return report
            advice += f"; {IF_IT_MOVES}"
        self._u[:] = self._u_n
        if self._relaxes and not hopeless:
            between = release_vertices((step.state, step.normal.active) for step in steps)
            if between:
                self._tries = True
                report = self._step()
                self._warn_of_released(between)
                return report
        raise self._failure(reports, steps, solution.end.states, advice)

    def _warn_of_released(self, between: Sequence[str]) -> None:
        """Warn of pairs whose vertices have no contact in the accepted step."""
        if self._comm.rank == 0:
            _logger.warning(
                "step %d to t = %g has no solution with contact of the vertices on edges and "
                "corners: vertices between %s have no contact in it, and may penetrate between "
                "nodes; a later step tries their contact again; smaller facets there help",
                *(self.step + 1, self.t + self._dt, ", ".join(between)),
            )

    def _has_last_resort(self) -> bool:
        return super()._has_last_resort() or any(
            isinstance(each, VertexState) and not each.is_released for each in self._all_contacts
        )

    def _most_long(self, start: str) -> int | None:
        """Number of long increments after which an attempt fails, see `Start.most_long`. Local.

        With inertia all starting guesses are close to the solution.
        """
        return _MOST_LONG

    def _solve(
        self, start: Start, problem: StepProblem, **options: Any
    ) -> tuple[list[ContactStep], newton.Solution]:
        """Solve the step; ``options`` are passed to `StepSolver.solve`.

        If the solution has reached contact outside the searched range, the step is solved again
        from the same starting guess, with this solution as the trial motion of the search.
        """
        iterations = 0
        for _ in range(_MOST_SEARCHES):
            steps, solution = self._step_solver.solve(
                start, problem, self._motion_from, self.timings, **options
            )
            iterations += solution.report.iterations
            if not solution.report.converged:
                break
            with self.timings.phase("passage"):
                missed = self._step_solver.missed_contact(steps, problem, self.x)
            report = replace(solution.report, iterations=iterations, reason=missed)
            solution = replace(solution, report=report)
            if not missed:
                break
            admitted = {step.state: eligible_or_excluded(step.normal) for step in steps}
            problem = replace(problem.with_trial(self.x), admitted=admitted)
        return steps, solution

    def _problem(self, starts: Iterable[Start], load: float) -> StepProblem:
        """Data of the step that begins; ``load`` is the norm of its loads [N]."""
        by_name = {start.name: start for start in starts}
        trial, points = by_name[self._rates.trial], by_name[self._rates.spring_points]
        intermediate = {
            part: self._X + self._in_space(self._motion.displacements(trial.guess, part))
            for part in _release_fractions(() if self._is_static else self.pairs)
        }
        v = self.v.x.array[: len(self._lumped_mass)]
        force_scale = self._forces.scale(load, v, self.dt)
        return StepProblem(
            self.x,
            self._X + self._in_space(trial.u),
            self._X + self._in_space(points.u),
            intermediate,
            load,
            force_scale,
        )

    def _attempts(
        self, starts: Iterable[Start], failed: Mapping[str, NewtonReport]
    ) -> Iterator[Start]:
        """Starting guesses to try in turn; ``failed`` has the reports of previous ones by name."""
        yield from starts

    def _checked_report(
        self, steps: Sequence[ContactStep], solution: newton.Solution, problem: StepProblem
    ) -> NewtonReport:
        """Report of an attempt, with the reason if its solution is rejected."""
        report = solution.report
        if not report.converged:
            return report
        largest = _kernels.farthest(self.x, problem.x_n)
        self._increment = reductions.largest(self._comm, largest)
        return replace(report, reason=self._rejection(steps, solution, problem.x_n))

    def _warn_if_unstable(self, steps: Sequence[ContactStep], solution: newton.Solution) -> None:
        """Warn of an unstable equilibrium, in statics only."""

    def _relaxed(
        self, start: Start, problem: StepProblem
    ) -> tuple[list[ContactStep], newton.Solution] | None:
        """Solve the step by relaxation in statics; None with inertia."""
        return None

    def _motion_from(self, start: Start, steps: Sequence[ContactStep]) -> PrescribedMotion:
        """Prescribed motion from a starting guess u. Collective.

        With inertia increments are small, and the motion is applied in one increment.
        """
        return PrescribedMotion(self._bulk, steps)

    def _rejection(
        self, steps: Sequence[ContactStep], solution: newton.Solution, x_n: Floats
    ) -> str:
        """Reason why a solution is rejected, or ""; ``x_n`` are the positions at t_n [m]."""
        if inverted := self._volume_ratio.inverted():
            return inverted
        residual = min(solution.report.residual_norms[-1:], default=0.0)
        reasons = chain(
            (check_penetration(step, self.dt) for step in steps),
            (
                check_forces(step, last, residual)
                for step, last in zip(steps, solution.end.states, strict=True)
            ),
        )
        with self.timings.phase("passage"):
            return (
                next(filter(None, reasons), "")
                or self.watch.springs.pushed_through(self.x)
                or self.watch.vertices.check(x_n, self.x, self._increment)
                or check_boundaries(
                    *(self.watch.overlaps, steps, (x_n, self.x)),
                    (self.t, self.t + self.dt),
                    self._increment,
                )
            )

    def _forces_at_start(self) -> Floats:
        """Residual with loads and contact springs at the time t, on the owned dofs [N]."""
        # The user may have set velocities of sleeping bodies.
        self._sleeping.wake()
        self._load_at(0.0)
        forces: Floats = self._bulk.forces() + self._step_solver.spring_forces(self.x)
        self._load_at(self.scheme.load_point)
        return forces

    def _is_unchanged(self, load: float) -> bool:
        """Whether supports, obstacles, materials and loads [N] have not changed in this step."""
        fixed, u = self.supports.fixed, self._u
        moves = any(contact.search.frame.moves for contact in self.contacts) or self.memory.exists
        stays = np.array_equal(self.supports.applied(u)[fixed], u[fixed])
        stays = stays and not (moves or self._bulk.rigid.guides.are_moving)
        return self._forces.stays(load) and reductions.everywhere(self._comm, stays)

    def _failure(
        self,
        attempts: Mapping[str, NewtonReport],
        steps: Sequence[ContactStep],
        states: Sequence[ContactContribution],
        advice: str,
    ) -> ConvergenceError:
        """Error of a failed step, from the reports of all attempts and the last contact."""
        passing = (passing_without_contact(step, self.dt) for step in steps)
        if found := next(filter(None, passing), ""):
            advice = f"{found}; {advice}"
        return StepFailure(attempts, steps, states, self._comm).error(
            f"step {self.step + 1} from t = {self.t:.10g} to {self.t + self.dt:.10g}",
            self.bodies,
            self.contacts,
            self.watch.springs.yielding(),
            advice,
        )

    def _step_length_advice(self) -> str:
        """Advice if no specific cause is known. Collective."""
        return SHORTER_STEP_HELPS

    def _accepted(
        self,
        steps: Sequence[ContactStep],
        solution: newton.Solution,
        attempts: Collection[NewtonReport],
        load: float,
    ) -> StepReport:
        """Accept velocity and contact of the solution, and compute all works.

        ``attempts`` are the reports of all attempts, ``load`` is the norm of the loads [N].
        """
        self._warn_if_unstable(steps, solution)
        if self._observer is not None:
            self._observer(steps, solution.end.states)
        n = len(self._lumped_mass)
        works = {}
        # In statics the work that end forces of obstacles would do beyond that of mean forces.
        means, excess = self._reactions.means, 0.0
        for step, pairs in zip(steps, solution.end.states, strict=True):
            history = contact_history(step, pairs)
            mean = history.force
            if means is not None:
                mean = means.of_contact(step.state.history.force, mean)
                excess += obstacle_work(step, history.force - mean)
            works[step.state] = contact_work(step, pairs, history, mean)
            if self._released_springs is not None:
                self._released_springs.collect(step, pairs)
            step.state.accept(history)
        self.watch.springs.check()
        self._step_solver.relief.warn(steps)
        x, v, du = self.x, self.v.x.array[:n], (self._u - self._u_n)[:n]
        reactions, loads, constraints = self._reactions.of(
            steps, solution, x, self._motion.owned(du)
        )
        self.memory.accept()
        v_n = v.copy()
        update = self._inertia.accept(steps)
        if update.reactions:
            both = zip(reactions, update.reactions, strict=True)
            reactions = tuple(last + more for last, more in both)
        if self._released_springs is not None:
            given = self._released_springs.give_back(self._motion.owned(self._u), self.t + self.dt)
            works |= {state: works[state] + work for state, work in given.items()}
        digits = position_rounding(_kernels.largest_size(x))
        total = StepWorks.of(
            self._bulk,
            self._inertia,
            self._forces,
            steps,
            solution,
            defect=update.defect + constraints + excess,
            loads=loads,
            du=du,
            v_n=v_n,
            v=v,
            closed_within=gap_tolerance(self._sizes.smallest, digits),
        )
        self.inertia_defect, t = total.inertia, self.t + self.dt
        self.watch.turned.check_at(self.step + 1, x, t)
        if not self._is_static:
            self.watch.gains.check(works, total.kinetic, t, total.open_gaps)
        if self.watch.impacts is not None:
            self.watch.impacts.check(total.kinetic[0], t, self.dt)
        # In statics all forces may be reactions, so that only internal forces give a scale.
        internal = self._bulk.forces() if self._is_static else solution.end.R_bulk
        internal = internal - self._lumped_mass * (v - v_n) / self.dt
        # The norm excludes constraint forces of rigid bodies.
        self._forces.accept(load, self._bulk.rigid.without(self._motion.owned(internal)).ravel())
        return StepReport(
            step=self.step + 1,
            t=t,
            dt=self.dt,
            newton_iterations=sum(attempt.iterations for attempt in attempts),
            active_set_changes=solution.report.active_set_changes,
            residual_norms=solution.report.residual_norms,
            num_active=solution.report.num_active,
            num_segments=total.num_segments,
            num_sleeping=len(self._sleeping.bodies),
            contact_work=sum(works.values(), update.work),
            damping_work=total.damping,
            solver_work=total.solver,
            load_works=total.loads,
            reactions=reactions,
        )

    def _set_data(self, t_n: float, dt: float, point: float | None = None) -> None:
        """Set loads, supports and motions as in a former step of length dt from t_n, both [s].

        ``point`` is the time of the loads as a fraction of the step; None for the time of the
        scheme.
        """
        self.t, self._dt.value[...] = t_n, dt
        with self._steps_of(dt):
            self._script.update(t_n + dt)
            self._load_at(self.scheme.load_point if point is None else point)
            self._begin(t_n, t_n + dt)

    def _work_of_solvers(self) -> tuple[int, SolverStatistics]:
        return self._bulk.num_assembled[0], self._solver.statistics

    def _in_space(self, values: Floats) -> Floats:
        return in_space(values.reshape(-1, self._bulk.rigid.dim))


class StepEquations(NamedTuple):
    """Equations of the steps of a stepper, for derivatives of their solutions.

    Attributes:
        bulk: Residual of the bodies and loads, with the supports.
        tangent: Matrix for preconditioners.
        rates: Relation between velocities and displacements.
        copies: Copies of the user's Constants and Functions in the forms of loads.
        contacts: States of all pairs, including those of vertices.
        released: Springs that return energy to the bodies; None without inertia.
        relief: Motions of bodies that nothing resists in statics.
        updates: Whether ``update`` sets values of supports and loads.
        set_data: Function ``set_data(t_n, dt)`` that sets loads, supports and motions as in a
            former step of length dt from t_n, both [s]. Collective.
        set_start: Function of t_n and dt that sets the loads at t_n instead. Collective.
        bodies: All bodies.
    """

    bulk: Bulk
    tangent: Tangent
    rates: Rates
    copies: Mapping[Any, Any]
    contacts: Sequence[PairState]
    released: ReleasedSprings | None
    relief: InertiaRelief
    updates: bool
    set_data: Callable[[float, float], None]
    set_start: Callable[[float, float], None]
    bodies: Sequence[Body]

    def in_forms(self, value: fem.Constant | fem.Function) -> list[Any]:
        """A Constant or Function of the user, and its copy in the forms of loads. Local."""
        return [value, self.copies[value]] if value in self.copies else [value]


def equations_of(stepper: ImplicitStepper) -> StepEquations:
    """Equations of the steps of a stepper. Local."""
    return StepEquations(
        stepper._bulk,
        stepper._tangent,
        stepper._rates,
        stepper._copies,
        stepper._all_contacts,
        stepper._released_springs,
        stepper._step_solver.relief,
        stepper._updates,
        stepper._set_data,
        partial(stepper._set_data, point=0.0),
        stepper.bodies,
    )


@contextmanager
def observed(
    stepper: ImplicitStepper,
    observer: Callable[[Sequence[ContactStep], Sequence[ContactContribution]], None],
) -> Iterator[None]:
    """Context in which a function sees the contact of each step before it is accepted. Local."""
    stepper._observer = observer
    try:
        yield
    finally:
        stepper._observer = None


def _release_fractions(pairs: Sequence[ContactPair]) -> list[float]:
    """Step fractions at which nodes separate by their coefficients of restitution, sorted."""
    laws = (pair.enforcement for pair in pairs)
    return sorted({law.part for law in laws if isinstance(law, LagrangeMultiplier) and law.part})
