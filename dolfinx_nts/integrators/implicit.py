r"""Implicit steppers, which solve the balance of momentum of a step by Newton's method.

The unknown is u_{n+1}, from which the velocity follows,
:math:`v_{n+1} = 2 (u_{n+1} - u_n)/\Delta t - v_n`. The balance of momentum of a step, divided
by its length, is

.. math:: M \frac{2}{\Delta t} \left( \frac{u_{n+1} - u_n}{\Delta t} - v_n
   \right) + f_{int} + f_{damp} + \sum \lambda_N F = f_{ext}.

Schemes differ in the stress of f_int and in the kernel of the contact force F, see `Scheme`;
statics and the generalised-alpha method also in the inertia, see `Rates`.
"""

import logging
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, cast

import numpy as np
from dolfinx import fem

from dolfinx_nts import _kernels, compat
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.implicit.accepted_contact import contact_history, contact_work
from dolfinx_nts.contact.implicit.certificate import check_penetration
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.massless import is_resolved, massless_nodes
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.integrators.admissible_motion import AdmissibleMotion
from dolfinx_nts.integrators.attempt import Start, StepProblem
from dolfinx_nts.integrators.inertia import ConsistentInertia, Inertia
from dolfinx_nts.integrators.open_springs import choose_springs
from dolfinx_nts.integrators.rates import MidpointRates
from dolfinx_nts.integrators.reactions import Reactions
from dolfinx_nts.integrators.relaxation import IF_IT_MOVES
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.resolved_impact import ResolvedImpact
from dolfinx_nts.integrators.rigid import check_statics, rigid_motion
from dolfinx_nts.integrators.sleeping import SleepingBodies
from dolfinx_nts.integrators.step_failure import SHORTER_STEP_HELPS, StepFailure
from dolfinx_nts.integrators.step_forces import StepForces
from dolfinx_nts.integrators.step_solver import StepSolver
from dolfinx_nts.integrators.step_works import StepWorks
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.dirichlet import Supports
from dolfinx_nts.model.loads import Load
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers import newton
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.cell_sizes import CellSizes
from dolfinx_nts.solvers.convergence import gap_tolerance, position_rounding
from dolfinx_nts.solvers.krylov import LinearSolver
from dolfinx_nts.solvers.newton_report import ConvergenceError, NewtonReport
from dolfinx_nts.solvers.prescribed_motion import PrescribedMotion
from dolfinx_nts.solvers.statistics import SolverStatistics
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["ImplicitStepper"]

_logger = logging.getLogger("dolfinx_nts")

# Number of solutions of a step [-], of which each is searched with the motion of the one before. A
# second one nearly always suffices; more cost time in steps that are refused in the end.
_MOST_SEARCHES = 4


class ImplicitStepper(Stepper):
    """Base class of steppers that solve for the displacement at the end of a step.

    Arguments, attributes and errors are those of `EnergyMomentum`. Collective, as are all its
    methods.
    """

    @compat.quicker_ffcx()  # Derivatives ask for cells as often as FFCx does.
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
        super().__init__(bodies, pairs, dt=dt, loads=loads, update=update)
        self._rates = self.scheme.rates(self, self._dt, bodies)
        if self._is_static:
            check_statics(self.bodies, Supports(self.u.function_space, bcs).fixed)
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
        # For the size of forces, where lumped masses are exact enough.
        self._lumped_mass: Floats = np.repeat(lumped_mass(bodies), self._bulk.rigid.dim)
        self._step_solver = StepSolver(
            self._bulk,
            self._tangent,
            self._rates,
            self.scheme,
            self.bodies,
            self.contacts,
            self.loads,
            self._lumped_mass,
            petsc_options,
            flows=self.memory.flows,
        )
        self._reactions = Reactions(
            self._bulk,
            self.bodies,
            at_mean=self.scheme.loads_at == "mean",
            is_static=self._is_static,
        )
        self._forces = StepForces(self._bulk, self._lumped_mass)

    @property
    def _bulk(self) -> Bulk:
        """Residual of the bodies. Local."""
        return self._inertia.bulk

    @property
    def _tangent(self) -> Tangent:
        """Matrix of the derivative of the residual. Local."""
        return self._inertia.tangent

    @property
    def _solver(self) -> LinearSolver:
        """Solver of the linear systems. Local."""
        return self._step_solver.linear

    @property
    def _sleeping(self) -> SleepingBodies:
        """Bodies that are not computed. Local."""
        return self._step_solver.sleeping

    @property
    def _sizes(self) -> CellSizes:
        """Sizes of the cells. Local."""
        return self._step_solver.sizes

    @property
    def _is_static(self) -> bool:
        """Whether there is no inertia. Local."""
        return self._rates.acceleration is None

    def serialize(self, archive: Archive) -> None:
        """Serialize the state, also that of the rates and of the linear solver."""
        super().serialize(archive)
        self._forces.serialize(archive)
        self._rates.serialize(archive, self.node_ids)
        self._solver.serialize(archive)
        if archive.giving:
            self._bulk.rigid.restored()

    def adopt(
        self,
        archive: Archive,
        contacts: Mapping[int, str],
        *,
        same_scheme: bool,
        same_bodies: bool,
    ) -> None:
        """Take over another scene, see ``Stepper.adopt``, with the rates of the same scheme."""
        super().adopt(archive, contacts, same_scheme=same_scheme, same_bodies=same_bodies)
        if same_scheme:
            self._rates.serialize(archive, self.node_ids)

    def nodal_momentum(self) -> Floats:
        """Momentum of the owned nodes, shape ``(n, 3)`` [kg m/s]."""
        return self._inertia.momentum()

    def carried(self, forces: Floats) -> Floats:
        """Take forces at the owned nodes, ``(n, 3)`` [N], to those that carry mass."""
        return self._inertia.carried(forces)

    def _check_state(self) -> None:
        super()._check_state()
        self._bulk.rigid.check(self._motion.owned(self._u), self._motion.owned(self.v.x.array))

    def _set(self, function: fem.Function, body: Body, value: Any) -> None:
        super()._set(function, body, value)
        self._bulk.rigid.given(body, function.name)

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
        """Try Newton's method from several states, until one succeeds."""
        mass, share = self._step_solver.mass, self.scheme.stress_share
        choose_springs(
            *(self.contacts, self.bodies, self._tangent, self._rates, mass, self._dt, share),
            self._step_solver.free,
        )
        load = self._forces.norm(self._forces.loads()) if self.loads else 0.0
        if not np.isfinite(load):
            raise ValueError(f"expected finite loads, given loads of {load} N in this step")
        self._bulk.rigid.begin(self._motion.owned(self._u_n))
        at_rest = partial(self._is_at_rest, load)
        forces = self._forces_at_start
        given = partial(self._motion.given, self.x, self.contacts)
        self._rates.begin(forces, self._step_solver.free, self._bulk.rigid, at_rest, given)
        starts = [
            Start(name, self._motion.displacements(u), u)
            for name, u in self._rates.starts().items()
        ]
        problem = self._problem(starts, load)
        reports: dict[str, NewtonReport] = {}
        for start in self._attempts(starts, reports) if self._tries else ():
            steps, solution = self._solve(start, problem)
            if self._sleeping.must_wake(steps):
                steps, solution = self._solve(start, problem, all_awake=True)
            reports[start.name] = self._judged(steps, solution.report, problem)
            if reports[start.name].converged:
                self.watch.vertices.accept()
                return self._accepted(steps, solution, reports.values(), load)
            if solution.report.is_hopeless:
                break
        advice = self._step_solver.relief.advice() or self._time_helps()
        hopeless = any(report.is_hopeless for report in reports.values())
        if self._relaxes and not hopeless and (found := self._elsewhere(starts[-1], problem)):
            steps, solution = found
            reports["relaxed"] = solution.report
            if solution.report.converged:
                report = self._accepted(steps, solution, reports.values(), load)
                self._rates.forget()  # It does not go on like that.
                return report
            advice += f"; {IF_IT_MOVES}"
        self._u[:] = self._u_n
        raise self._failure(reports, steps, solution.end.states, advice)

    def _solve(
        self, start: Start, problem: StepProblem, **how: Any
    ) -> tuple[list[ContactStep], newton.Solution]:
        """Solve the step, see `StepSolver.solve`, which explains ``how``.

        Where the motion made has reached contact that the search did not, the step is solved
        again from the same start, with this motion as the trial motion of the search.
        """
        iterations = 0
        for _ in range(_MOST_SEARCHES):
            steps, solution = self._step_solver.solve(
                start, problem, self._motion_from, self.timings, **how
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
            problem = replace(problem, x_trial=self.x)
        return steps, solution

    def _problem(self, starts: Iterable[Start], load: float) -> StepProblem:
        """What is given in the step that begins; ``load`` is the norm of its loads [N]."""
        trial = next(start for start in starts if start.name == self._rates.trial)
        on_the_way = {
            part: self._X + self._in_space(self._motion.displacements(trial.guess, part))
            for part in _held_parts(() if self._is_static else self.pairs)
        }
        v = self.v.x.array[: len(self._lumped_mass)]
        force_scale = self._forces.scale(load, v, self.dt)
        return StepProblem(self.x, self._X + self._in_space(trial.u), on_the_way, load, force_scale)

    def _attempts(
        self, starts: Iterable[Start], failed: Mapping[str, NewtonReport]
    ) -> Iterator[Start]:
        """Starts to try in turn; ``failed`` has the reports of those before, by their names."""
        yield from starts

    def _judged(
        self, steps: Sequence[ContactStep], report: NewtonReport, problem: StepProblem
    ) -> NewtonReport:
        """Report of an attempt, with the reason why its solution cannot be accepted, if any."""
        if not report.converged:
            return report
        way = _kernels.farthest(self.x, problem.x_n)
        self._way = reductions.largest(self._comm, way)
        return replace(report, reason=self._wrong(steps, problem.x_n))

    def _look_at(self, steps: Sequence[ContactStep], solution: newton.Solution) -> None:
        """Tell what is wrong with an accepted solution; nothing: with inertia none is unstable."""

    def _elsewhere(
        self, start: Start, problem: StepProblem
    ) -> tuple[list[ContactStep], newton.Solution] | None:
        """Look for a solution far from the last state, the start; None: not with inertia."""
        return None

    def _motion_from(self, start: Start, steps: Sequence[ContactStep]) -> PrescribedMotion:
        """What is led has still to go from a start, where u is. Collective.

        With inertia ways are short: all is at their ends at once.
        """
        return PrescribedMotion(self._bulk, steps)

    def _wrong(self, steps: Sequence[ContactStep], x_n: Floats) -> str:
        """Say why a solution cannot be accepted, or "".

        ``x_n`` are positions at t_n, shape ``(l, 3)`` [m].
        """
        if inverted := self._volume_ratio.inverted():
            return inverted
        reasons = (check_penetration(step, self.dt) for step in steps)
        with self.timings.phase("passage"):
            return (
                next(filter(None, reasons), "")
                or self.watch.springs.sunk(self.x)
                or self.watch.vertices.check(x_n, self.x, self._way)
            )

    def _forces_at_start(self) -> Floats:
        """Residual at t with the loads there, on the owned dofs [N]."""
        self._load_at(0.0)
        forces = self._bulk.forces()
        self._load_at(self.scheme.load_point)
        return forces

    def _is_at_rest(self, load: float) -> bool:
        """Whether supports and obstacles stay, nothing relaxes, and the loads [N] are the last."""
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
        """Error that says why all attempts have failed; steps and states are of the last."""
        return StepFailure(attempts, steps, states, self._comm).error(
            f"step {self.step + 1} from t = {self.t:.10g} to {self.t + self.dt:.10g}",
            self.bodies,
            self.contacts,
            self.watch.springs.yielding(),
            advice,
        )

    def _time_helps(self) -> str:
        """Advice where only the length of the step is left to change. Collective."""
        return SHORTER_STEP_HELPS

    def _accepted(
        self,
        steps: Sequence[ContactStep],
        solution: newton.Solution,
        attempts: Collection[NewtonReport],
        load: float,
    ) -> StepReport:
        """Set the velocity and the contact by the solution, and compute all works.

        ``attempts`` are the reports of all attempts, ``load`` is the norm of the loads [N].
        """
        self._look_at(steps, solution)
        n = len(self._lumped_mass)
        works = {}
        for step, pairs in zip(steps, solution.end.states, strict=True):
            history = contact_history(step, pairs)
            works[step.state] = contact_work(step, pairs, history)
            step.state.accept(history)
        self.watch.springs.look()
        self._step_solver.relief.warn(steps)
        x, v, du = self.x, self.v.x.array[:n], (self._u - self._u_n)[:n]
        reactions, constraints = self._reactions.of(steps, solution, x, self._motion.owned(du))
        self.memory.accept()
        v_n = v.copy()
        settled = self._inertia.accept(steps)
        if settled.reactions:
            both = zip(reactions, settled.reactions, strict=True)
            reactions = tuple(last + more for last, more in both)
        digits = position_rounding(_kernels.largest_size(x))
        total = StepWorks.of(
            self._bulk,
            self._inertia,
            self._forces,
            steps,
            solution,
            defect=settled.defect + constraints,
            du=du,
            v_n=v_n,
            v=v,
            closed_within=gap_tolerance(self._sizes.smallest, digits),
        )
        self.inertia_defect, t = total.inertia, self.t + self.dt
        if not self._is_static:
            self.watch.gains.look(works, total.kinetic, t, total.open_gaps)
        # Without inertia bodies may press against supports alone.
        internal = self._bulk.forces() if self._is_static else solution.end.R_bulk
        internal = internal - self._lumped_mass * (v - v_n) / self.dt
        # What keeps a body rigid is no force of the balance.
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
            contact_work=sum(works.values(), settled.work),
            damping_work=total.damping,
            solver_work=total.solver,
            load_works=total.loads,
            reactions=reactions,
        )

    def _work_of_solvers(self) -> tuple[int, SolverStatistics]:
        return self._bulk.num_assembled[0], self._solver.statistics

    def _in_space(self, values: Floats) -> Floats:
        """Vectors at nodes, ``(l, 3)``, of the values of their dofs. Local."""
        return in_space(values.reshape(-1, self._bulk.rigid.dim))


def _held_parts(pairs: Sequence[ContactPair]) -> list[float]:
    """Parts of their ways that nodes of some pairs are let go by a coefficient of restitution."""
    laws = (pair.enforcement for pair in pairs)
    return sorted({law.part for law in laws if isinstance(law, LagrangeMultiplier) and law.part})
