"""Solution of an implicit step from one starting guess."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.timing import Timings
from dolfinx_nts.contact.implicit.contact_step import ContactStep, contact_residual, start_from
from dolfinx_nts.contact.implicit.local_search import may_face
from dolfinx_nts.contact.implicit.solution_checks import missed_contact
from dolfinx_nts.contact.joint_state import JointState, joint_states
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.integrators.implicit.attempt import Start, StepProblem
from dolfinx_nts.integrators.implicit.sleeping import SleepingBodies
from dolfinx_nts.integrators.rates import Rates
from dolfinx_nts.integrators.rigid import contact_stiffness
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.loads.load import Load
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers import newton
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.cell_sizes import cell_sizes
from dolfinx_nts.solvers.linear.krylov import LinearSolver
from dolfinx_nts.solvers.nonlinear_elimination import NonlinearElimination
from dolfinx_nts.solvers.precond.tangent import Tangent
from dolfinx_nts.solvers.prescribed_motion import PrescribedMotion
from dolfinx_nts.solvers.statics.drag import Drag
from dolfinx_nts.solvers.statics.free_bodies import FreeBody, find_free_bodies
from dolfinx_nts.solvers.statics.inertia_relief import InertiaRelief

__all__ = ["StepSolver"]


class StepSolver:
    """Newton solution of attempts at a step. Collective, as are its methods.

    Args:
        bulk: Residual of the bodies, with rigid motions.
        tangent: Its tangent matrix.
        rates: Relation between velocities and displacements.
        scheme: The scheme.
        bodies: All bodies.
        contacts: States of the contact pairs.
        loads: Loads on the bodies.
        mass: Lumped mass of the owned dofs, shape ``(d n,)`` [kg].
        petsc_options: See `EnergyMomentum`.
        flows: Whether materials are plastic, with discontinuous tangents.

    Attributes:
        linear: Solver of the linear systems.
        sizes: Sizes of the cells.
        mass: Lumped mass of the owned nodes, shape ``(n,)`` [kg].
        free: 1 at unknown displacements of the owned nodes, 0 at prescribed ones, shape
            ``(n, d)``; None if all are unknown.
        relief: Inertia relief of bodies supported only by contact.
        sleeping: Bodies that the step skips.
    """

    def __init__(
        self,
        bulk: Bulk,
        tangent: Tangent,
        rates: Rates,
        scheme: Scheme,
        bodies: Sequence[Body],
        contacts: Sequence[PairState],
        loads: Sequence[Load],
        mass: Floats,
        petsc_options: Mapping[str, Any] | None,
        *,
        flows: bool,
    ) -> None:
        self._bulk, self._tangent, self._rates, self._scheme = bulk, tangent, rates, scheme
        self._bodies = bodies
        V, dim = bulk.u.function_space, bulk.rigid.dim
        n = V.dofmap.index_map.size_local
        X: Floats = reference_positions(V)[:n]
        self.sizes = cell_sizes(V)
        self.mass: Floats = mass[::dim]
        free: Sequence[FreeBody] = ()
        if self._is_static:
            free = find_free_bodies(bodies, bulk, tangent, X)
        self.relief = InertiaRelief(free, tangent, self.mass, bulk.is_prescribed.reshape(n, dim))
        if free:
            bulk.stabilisation = self.relief.resistance
            tangent.shift = self.relief.shift
            tangent.num_free = self.relief.num_motions
            tangent.forget()
        self.linear = LinearSolver(bulk, tangent, partial(rates.inertia_share, mass), petsc_options)
        elimination: NonlinearElimination | None = None
        if not (self._is_static or bulk.rigid.exists or flows):
            elimination = NonlinearElimination(bulk, self.linear, self.sizes)
        self._system = newton.NewtonSystem(
            *(bulk, self.linear, X, self.relief, self.sizes),
            inertia=not self._is_static,
            jumps=flows,
            elimination=elimination,
        )
        states = joint_states(contacts)
        self.sleeping = SleepingBodies(bulk, tangent, self.sizes, bodies, states, loads)
        self.free: Floats | None = None
        if bulk.supports.exist:
            self.free = np.ones((n, dim))
            self.free.ravel()[bulk.supports.fixed] = 0

    @property
    def _is_static(self) -> bool:
        return self._rates.acceleration is None

    def solve(
        self,
        start: Start,
        problem: StepProblem,
        motion_from: Callable[[Start, Sequence[ContactStep]], PrescribedMotion],
        timings: Timings,
        *,
        all_awake: bool = False,
        drag: Drag | None = None,
        after: Sequence[ContactStep] = (),
    ) -> tuple[list[ContactStep], newton.Solution]:
        """Solve the step.

        Args:
            start: Starting guess of Newton's method.
            problem: Data of the step.
            motion_from: Creates the prescribed motion from the starting guess.
            timings: Receives the wall time of the phases.
            all_awake: Whether all bodies are active.
            drag: Viscous resistance of pseudo-transient continuation, if any.
            after: Contact of a previous attempt from which to start, if any.
        """
        rates = self._rates
        self._bulk.u.x.array[:] = start.u
        with timings.phase("contact"):
            steps = self._contact_steps(problem, start.begins_sticking)
            if after:
                start_from(steps, after)
        # Bodies supported only by contact may move far until they touch others.
        if not (all_awake or self.relief.bodies):
            self.sleeping.find(rates.v.x.array, rates.u_n.x.array, steps)
        motion = motion_from(start, steps)
        attempt = newton.Attempt(
            *(steps, motion, problem.force_scale, timings),
            is_unchanged=rates.is_unchanged and drag is None,
            drag=drag,
            begins_sticking=start.begins_sticking,
            most_long=None if drag is not None else start.most_long,
        )
        solution = newton.solve(self._system, attempt)
        motion.finish()
        return steps, solution

    def missed_contact(self, steps: Sequence[ContactStep], problem: StepProblem, x: Floats) -> str:
        """Message if the solution reached contact outside the searched range, or "".

        Args:
            steps: Contact of the solved step.
            problem: Data of the step.
            x: Positions of the local nodes at its end, shape ``(l, 3)`` [m].
        """
        made = problem.with_trial(x)
        farthest = reductions.largest(self._bulk.comm, _kernels.farthest(problem.x_n, x))
        ends, repeat = (problem.x_n, x), partial(self._contact_step, made, False)
        return missed_contact(steps, self.sleeping.states, ends, farthest, repeat)

    def spring_forces(self, x: Floats) -> Floats:
        """Forces of contact springs at the current positions, with the friction of the last step.

        Multipliers have no force that follows from the state.

        Args:
            x: Accepted positions of the local nodes, shape ``(l, 3)`` [m].

        Returns:
            Part of the residual at the owned dofs, shape ``(n d,)`` [N].
        """
        shape = len(self.mass), self._bulk.rigid.dim
        steps = [
            step
            for step in self._contact_steps(StepProblem(x, x, x, {}, 0.0, 0.0), False)
            if step.state.eps_N is not None
        ]
        states = [step.evaluate(x[: shape[0]], None, 0) for step in steps]
        return contact_residual(steps, states, shape)

    def _contact_steps(self, problem: StepProblem, begins_sticking: bool) -> list[ContactStep]:
        """Create the `ContactStep` of each pair that may touch in the step."""
        x_n = problem.x_n
        states: Sequence[PairState | JointState] = self.sleeping.states
        if not self._is_static:
            trials = problem.x_trial, problem.x_spring_points
            own = max(_kernels.farthest(x_n, x_trial) for x_trial in trials)
            farthest = reductions.largest(self._bulk.comm, own)
            states = [state for state in states if may_face(state, x_n, farthest)]
        steps: list[ContactStep] = []
        for state in states:
            steps.append(self._contact_step(problem, begins_sticking, state, tuple(steps)))
        for step in steps:
            if step.state in problem.admitted:
                step.normal.admit(problem.admitted[step.state])
        return steps

    def _contact_step(
        self,
        problem: StepProblem,
        begins_sticking: bool,
        state: PairState | JointState,
        others: Sequence[ContactStep] = (),
    ) -> ContactStep:
        stiffness = contact_stiffness(
            self._tangent.nodal_stiffness(), self._bodies, self.mass, self._rates
        )
        x_n, x_trial, scheme = problem.x_n, problem.x_trial, self._scheme
        return ContactStep(
            *(state, scheme.contact, x_n, x_trial, stiffness, self.free, self._is_static),
            self._bulk.rigid.nodes,
            problem.intermediate,
            scheme.stress_share,
            begins_sticking,
            float(self._rates.dt.value),
            others,
            problem.x_points(state),
        )
