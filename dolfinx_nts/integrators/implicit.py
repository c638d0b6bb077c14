r"""Implicit steps: Newton's method on the balance of momentum of a step.

The unknown of a step is u_{n+1}; the velocity follows from it,
:math:`v_{n+1} = 2 (u_{n+1} - u_n)/\Delta t - v_n`. The balance of momentum
of a step, divided by its length, is

.. math:: M \frac{2}{\Delta t} \left( \frac{u_{n+1} - u_n}{\Delta t} - v_n
   \right) + f_{int} + f_{damp} + \sum \lambda_N F = f_{ext}.

The schemes differ in the stress of f_int and in the kernel of the contact
force F; the generalised-alpha method also in its acceleration.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.contact.implicit.contact_step import ContactStep, contact_residual
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.implicit.penetration import check_penetration
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.cell_sizes import cell_sizes
from dolfinx_nts.fem.jit import assembled, compile_form
from dolfinx_nts.fem.node_numbering import listed
from dolfinx_nts.integrators.implicit_forms import StepForms
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.sleeping import SleepingBodies
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.model.loads import Load
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers import newton
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.krylov import LinearSolver
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["ImplicitStepper"]


class ImplicitStepper(Stepper):
    """A stepper that solves for the displacement at the end of a step.

    Arguments, attributes and errors are those of `EnergyMomentum`.
    Collective, as all its methods.
    """

    _inertia: ClassVar[bool] = True  # whether rates matter
    _stress_share: float = 0.5  # of the end of a step in its stress
    _trial: ClassVar[str] = "ballistic"  # start that decides which nodes may touch

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
        """Compile the forms; the bodies are at rest and undeformed."""
        super().__init__(bodies, pairs, dt=dt, loads=loads, update=update)
        self._forms = StepForms(
            bodies,
            self.u_n,
            self.u,
            self._dt,
            stress=self.first_piola,
            stress_share=self._stress_share,
            acceleration=self._acceleration() if self._inertia else None,
        )
        forms = self._forms.residual(), self.u, bcs, self._load_forms()
        self._bulk, self._tangent = Bulk(*forms), Tangent(*forms, self._forms.nearby_tangent())
        self._sizes = cell_sizes(self.u.function_space)
        self._supports = self._bulk.supports
        self._solver = LinearSolver(self._bulk, self._tangent, self._inertia_share, petsc_options)
        self._sleeping = SleepingBodies(
            self._bulk, self._tangent, self._sizes, self.bodies, self.pairs, self.loads
        )
        self._free: Floats | None = None
        if bcs:
            self._free = np.ones((self._num_owned, 3))
            self._free.ravel()[self._bulk.fixed] = 0
        damping = self._forms.dissipation()
        self._dissipation = None if damping is None else compile_form(damping)
        self._internal_force = 0.0
        eta = ufl.TestFunction(self.u.function_space)
        momentum = bulk_form(bodies, lambda m, parameters, rho: rho * ufl.inner(self.v, eta))
        self._momentum_form = compile_form(momentum)
        # Lumped mass, where only the size of a force counts.
        self._mass: Floats = np.repeat(lumped_mass(bodies), 3)
        self._mean_velocity: Floats = self.v.x.array.copy()

    def serialize(self, archive: Archive) -> None:
        """Serialize the state, also that of the linear solver."""
        super().serialize(archive)
        self._internal_force = archive.same("internal_force", self._internal_force)
        self._serialize_nodal(archive, "mean_velocity", self._mean_velocity)
        self._solver.serialize(archive)

    def nodal_momentum(self) -> Floats:
        """Momentum of the owned nodes, shape ``(n, 3)`` [kg m/s].

        That of the consistent mass. Collective.
        """
        return assembled(self._momentum_form).reshape(-1, 3)

    def _acceleration(self) -> Any:
        """Mean acceleration of a step, UFL (3,); asked for once."""
        dt = self._dt
        return 2 / dt * ((self.u - self.u_n) / dt - self.v)

    def _load_forms(self) -> list[ufl.Form]:
        """Virtual work of each load in a step."""
        return [load.form(self.u_n, self.u) for load in self.loads]

    def _step(self) -> StepReport:
        """Try Newton's method from several states."""
        x_n = self.x
        starts = {name: self._supports.applied(start) for name, start in self._starts().items()}
        x_trial = self._X + starts[self._trial].reshape(-1, 3)
        force_scale = self._force_scale()
        attempts: dict[str, newton.NewtonReport] = {}
        for name, start in starts.items():
            steps, solution = self._solve(start, x_n, x_trial, force_scale)
            if self._sleeping.must_wake(steps):
                steps, solution = self._solve(start, x_n, x_trial, force_scale, all_awake=True)
            attempts[name] = solution.report
            if solution.report.converged:
                reason = self._volume_ratio.inverted() or next(
                    filter(None, map(check_penetration, steps)), ""
                )
                if not reason:
                    return self._accepted(steps, solution, attempts.values())
                attempts[name] = replace(solution.report, reason=reason)
        self.u.x.array[:] = self.u_n.x.array
        raise self._failure(attempts, steps)

    def _force_scale(self) -> float:
        """Forces that can be at work, with which the residual is compared [N]."""
        momentum = self._mass * self.v.x.array[: 3 * self._num_owned]
        scale = self._internal_force + 1e-3 * self._norm(momentum) / self.dt
        if self.loads:
            scale += self._norm(self._bulk.load())
        return scale

    def _failure(
        self, attempts: Mapping[str, newton.NewtonReport], steps: Sequence[ContactStep]
    ) -> newton.ConvergenceError:
        """What all attempts have failed for; ``steps`` of the last. Collective."""
        reasons = "; ".join(f"from the {name} state: {each}" for name, each in attempts.items())
        materials = {body.material for body in self.bodies}
        weak = {type(m).__name__ for m in materials if not m.resists_collapse}
        if "is inverted" in reasons and weak:
            reasons += (
                f"; {' and '.join(sorted(weak))} cannot resist being squashed, NeoHookean can"
            )
        restless = np.concatenate([np.empty(0, dtype=np.int64), *(s.restless for s in steps)])
        nodes = np.unique(np.concatenate(self._comm.allgather(restless)))
        if len(nodes):
            reasons += f"; nodes that keep changing segment or state: {listed(nodes)}"
        return newton.ConvergenceError(
            f"step {self.step + 1} from t = {self.t:g} to {self.t + self.dt:g} failed {reasons}; "
            "the state is that of the last accepted step: a smaller dt may help",
            list(attempts.values()),
        )

    def _accepted(
        self,
        steps: Sequence[ContactStep],
        solution: newton.Solution,
        attempts: Collection[newton.NewtonReport],
    ) -> StepReport:
        """Set velocity and history by the solution; the works of the step."""
        dt, n = self.dt, 3 * self._num_owned
        work = ContactWork()
        for pair, step, state in zip(self.pairs, steps, solution.states, strict=True):
            history = step.accepted(state)
            work = work + step.work(state, history)
            pair.history = history
        moved = self.u.x.array - self.u_n.x.array
        du = moved[:n]
        support_work = self._support_work(steps, solution.states, du)
        lost = 0.0 if self._dissipation is None else fem.assemble_scalar(self._dissipation)
        loaded = self._bulk.load() @ du if self.loads else 0.0
        near = sum(len(step.candidates.size) for step in steps)
        sums = [float(value) for value in (loaded, -lost, solution.R @ du, near)]
        load_work, damping_work, solver_work, in_reach = reductions.total(self._comm, sums)
        v_n = self.v.x.array[:n].copy()
        self._mean_velocity = moved / dt
        self._update_velocity()
        inertia = self._mass * (self.v.x.array[:n] - v_n) / dt
        # Without inertia it may be supports alone against which bodies press.
        internal = solution.R_bulk if self._inertia else self._bulk.forces()
        self._internal_force = self._norm(internal - inertia)
        return StepReport(
            step=self.step + 1,
            t=self.t + dt,
            dt=dt,
            newton_iterations=sum(attempt.iterations for attempt in attempts),
            active_set_changes=solution.report.active_set_changes,
            residual_norms=solution.report.residual_norms,
            num_active=solution.report.num_active,
            num_segments=int(in_reach),
            num_sleeping=len(self._sleeping.bodies),
            contact_work=work,
            load_work=load_work,
            support_work=support_work,
            damping_work=damping_work,
            solver_work=solver_work,
        )

    def _solve(
        self,
        start: Floats,
        x_n: Floats,
        x_trial: Floats,
        force_scale: float,
        all_awake: bool = False,
    ) -> tuple[list[ContactStep], newton.Solution]:
        """Newton's method from one state."""
        self.u.x.array[:] = start
        with self.timings.phase("contact"):
            stiffness = self._tangent.nodal_stiffness()
            steps = [
                ContactStep(pair, self._contact, x_n, x_trial, stiffness, self._free)
                for pair in self.pairs
            ]
        if not all_awake:
            self._sleeping.find(self.v.x.array, self.u_n.x.array, steps)
        solution = newton.solve(
            self._bulk,
            self._solver,
            steps,
            self._X[: self._num_owned],
            sizes=self._sizes,
            force_scale=force_scale,
            inertia=self._inertia,
            timings=self.timings,
        )
        return steps, solution

    def _inertia_share(self) -> Floats:
        """Lumped part of inertia in the tangent, shape ``(3 n,)`` [N/m]."""
        share: Floats = 2 / self.dt**2 * self._mass
        return share if self._inertia else 0 * share

    def describe(self) -> list[str]:
        """Lines on the pairs and on the work of the linear solver. Local."""
        return [*super().describe(), f"linear solver: {self._solver.statistics}"]

    def _norm(self, values: Floats) -> float:
        """Euclidean norm of values on the owned dofs. Collective."""
        return float(np.sqrt(reductions.total(self._comm, values @ values)))

    def _starts(self) -> dict[str, Floats]:
        """Displacements from which Newton's method is tried, in turn."""
        # Contact makes velocities alternate from step to step; their mean
        # over the last step is free of that, and where it fails (the first
        # contact of a fast body) the others may not.
        u_n = self.u_n.x.array
        return {
            "coasting": u_n + self.dt * self._mean_velocity,
            "ballistic": u_n + self.dt * self.v.x.array,
            "last": u_n,
        }

    def _update_velocity(self) -> None:
        """Velocity at the end of the step just solved."""
        v = self.v.x.array
        v[:] = 2 * self._mean_velocity - v

    def _support_work(
        self, steps: Sequence[ContactStep], states: Sequence[ContactContribution], du: Floats
    ) -> float:
        """Work of the reactions in a step with increment du [J]. Collective."""
        fixed = self._bulk.fixed
        if not reductions.anywhere(self._comm, bool(du[fixed].any())):
            return 0.0
        # States keep the forces on given displacements apart.
        everywhere = [state._replace(residual=state.force) for state in states]
        reaction = self._bulk.forces() + contact_residual(steps, everywhere, len(du))
        return float(reductions.total(self._comm, reaction[fixed] @ du[fixed]))

    def _state_was_set(self) -> None:
        self._mean_velocity = self.v.x.array.copy()
