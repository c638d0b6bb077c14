r"""Implicit steps: Newton's method on the balance of momentum of a step.

The unknown of a step is u_{n+1}; the velocity follows from it,
:math:`v_{n+1} = 2 (u_{n+1} - u_n)/\Delta t - v_n`. The balance of momentum
of a step, divided by its length, is

.. math:: M \frac{2}{\Delta t} \left( \frac{u_{n+1} - u_n}{\Delta t} - v_n
   \right) + f_{int} + f_{damp} + \sum \lambda_N F = f_{ext}.

The schemes differ in the stress of f_int and in the kernel of the contact
force F; the generalised-alpha method also in its acceleration.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la

from dolfinx_nts import newton
from dolfinx_nts.archive import Archive
from dolfinx_nts.assembly import Bulk, contact_residual
from dolfinx_nts.bodies import Body, bulk_form
from dolfinx_nts.contact import ContactPair
from dolfinx_nts.contact_history import ContactWork
from dolfinx_nts.contact_rows import ContactState
from dolfinx_nts.contact_step import ContactStep
from dolfinx_nts.forms import compile_form
from dolfinx_nts.linear import LinearSolver
from dolfinx_nts.loads import Load
from dolfinx_nts.lost import lost_nodes
from dolfinx_nts.lumping import lumped_mass
from dolfinx_nts.materials import Hyperelastic, right_cauchy_green
from dolfinx_nts.numbering import listed
from dolfinx_nts.report import StepReport
from dolfinx_nts.rest import Rest
from dolfinx_nts.stepper import Stepper

__all__ = ["ImplicitStepper"]

Floats = npt.NDArray[np.float64]


class ImplicitStepper(Stepper):
    """A stepper that solves for the displacement at the end of a step.

    Collective, as all its methods.

    Args:
        bodies: Bodies of one space, which fill the mesh.
        pairs: Contact pairs of these bodies.
        dt: Length of a step [s].
        bcs: Dirichlet conditions on the displacement at the end of a
            step. Nodes of a moving support should start with its
            velocity: as of any node, it follows from the displacements.
        loads: Loads on the bodies.
        update: Called before each step with the time at its end [s], to
            set the functions and constants in ``bcs`` and ``loads``.
        petsc_options: Options of the linear solver: ``ksp_...`` for the
            Krylov method; all others, such as ``pc_type``, for the
            preconditioner of the bulk, which PETSc makes if there are
            any. Tolerances are set by Newton's method.

    Attributes:
        bodies: The bodies.
        pairs: The contact pairs with their accepted contact.
        loads: The loads.
        t: Time [s].
        dt: Length of the next step [s].
        step: Number of accepted steps.
        timings: Wall time by phase.
        u: Displacement at t.
        v: Velocity at t.

    Raises:
        TypeError: An argument has the wrong type.
        ValueError: Bodies overlap or do not fill the mesh; something
            belongs to another space; ``dt`` is not positive; conditions
            conflict.
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
        self._bulk = Bulk(self._residual(), self.u, bcs, self._load_forms(), self._nearby_form())
        self._supports = self._bulk.supports
        self._solver = LinearSolver(self._bulk, self._inertia_share, petsc_options)
        self._rest = Rest(self._bulk, self.bodies, self.pairs, self.loads)
        self._free: Floats | None = None
        if bcs:
            self._free = np.ones((self._num_owned, 3))
            self._free.ravel()[self._bulk.fixed] = 0
        self._dissipation = self._dissipation_form()
        self._internal_force = 0.0
        eta = ufl.TestFunction(self.u.function_space)
        momentum = bulk_form(bodies, lambda m, parameters, rho: rho * ufl.inner(self.v, eta))
        self._momentum_form = compile_form(momentum)
        # Lumped mass, where only the size of a force counts.
        self._mass: Floats = np.repeat(lumped_mass(bodies), 3)
        self._mean_velocity: Floats = self.v.x.array.copy()

    def exchange(self, archive: Archive) -> None:
        """Exchange the state, also that of the linear solver."""
        super().exchange(archive)
        self._internal_force = archive.same("internal_force", self._internal_force)
        self._exchange_nodal(archive, "mean_velocity", self._mean_velocity)
        self._solver.exchange(archive)

    def nodal_momentum(self) -> Floats:
        """Momentum of the owned nodes, shape ``(n, 3)`` [kg m/s].

        That of the consistent mass. Collective.
        """
        return self._nodal_values(self._momentum_form).reshape(-1, 3)

    def _nodal_values(self, form: fem.Form) -> Floats:
        """Linear form on the owned dofs. Collective."""
        vector = fem.assemble_vector(form)
        vector.scatter_reverse(la.InsertMode.add)
        values: Floats = vector.array[: 3 * self._num_owned]
        return values

    def _residual(self) -> ufl.Form:
        u, u_n = self.u, self.u_n
        eta = ufl.TestFunction(u.function_space)
        F_n, F = ufl.Identity(3) + ufl.grad(u_n), ufl.Identity(3) + ufl.grad(u)

        def integrand(material: Hyperelastic, parameters: dict[str, Any], rho: Any) -> Any:
            P = self.first_piola(material, parameters, F_n, F)
            work = ufl.inner(P, ufl.grad(eta))
            if self._inertia:
                work += rho * ufl.inner(self._acceleration(), eta)
                work += self._damping(material, parameters, rho, eta)
            return work

        return bulk_form(self.bodies, integrand)

    def _nearby_form(self) -> ufl.Form:
        """Tangent at u_n without initial stress, with the moduli at C = 1.

        Definite, where cells far from balance, or pressed, make the
        tangent indefinite, which spoils incomplete factorisations.
        """
        V, dt = self.u.function_space, self._dt
        eta, du = ufl.TestFunction(V), ufl.TrialFunction(V)
        F_n, G = ufl.Identity(3) + ufl.grad(self.u_n), ufl.grad(du)

        def integrand(material: Hyperelastic, parameters: dict[str, Any], rho: Any) -> Any:
            share = self._stress_share
            if self._inertia:
                share += material.stiffness_damping / dt
            P = share * F_n * material.linear_stress(ufl.sym(F_n.T * G), **parameters)
            work = ufl.inner(P, ufl.grad(eta))
            if self._inertia:
                rate = ufl.derivative(self._acceleration(), self.u, du)
                rate += material.mass_damping / dt * du
                work += rho * ufl.inner(rate, eta)
            return work

        return bulk_form(self.bodies, integrand)

    def _acceleration(self) -> Any:
        """Mean acceleration of a step, UFL (3,)."""
        dt = self._dt
        return 2 / dt * ((self.u - self.u_n) / dt - self.v)

    def _damping(self, material: Hyperelastic, parameters: Any, rho: Any, eta: Any) -> Any:
        """Virtual work of damping per reference volume, >= 0 for u - u_n."""
        u, u_n, dt = self.u, self.u_n, self._dt
        mesh, work = u.function_space.mesh, 0
        if material.mass_damping > 0:
            alpha = fem.Constant(mesh, material.mass_damping)
            work += alpha * rho / dt * ufl.inner(u - u_n, eta)
        if material.stiffness_damping > 0:
            beta = fem.Constant(mesh, material.stiffness_damping)
            F_n, F = ufl.Identity(3) + ufl.grad(u_n), ufl.Identity(3) + ufl.grad(u)
            strain = (right_cauchy_green(F) - right_cauchy_green(F_n)) / 2
            P = (F_n + F) / 2 * material.linear_stress(strain, **parameters)
            work += beta / dt * ufl.inner(P, ufl.grad(eta))
        return work

    def _dissipation_form(self) -> fem.Form | None:
        """Energy that damping takes in a step; None without damping."""
        damped = [body for body in self.bodies if body.material.is_damped]
        if not (damped and self._inertia):
            return None
        form = bulk_form(damped, partial(self._damping, eta=self.u - self.u_n))
        return compile_form(form)

    def _load_forms(self) -> list[ufl.Form]:
        """Virtual work of each load in a step."""
        return [load.form(self.u_n, self.u) for load in self.loads]

    def _step(self) -> StepReport:
        """Try Newton's method from several states."""
        dt, x_n = self.dt, self.x
        u, u_n = self.u.x.array, self.u_n.x.array
        starts = {name: self._supports.applied(start) for name, start in self._starts().items()}
        x_trial = self._X + starts[self._trial].reshape(-1, 3)
        v_n = self.v.x.array[: 3 * self._num_owned].copy()
        # What the residual is compared with: forces that can be at work.
        force_scale = self._internal_force + 1e-3 * self._norm(self._mass * v_n) / dt
        if self.loads:
            force_scale += self._norm(self._bulk.load())

        attempts: list[newton.NewtonReport] = []
        for start in starts.values():
            steps, solution = self._solve(start, x_n, x_trial, force_scale)
            if self._rest.disturbed(steps):
                steps, solution = self._solve(start, x_n, x_trial, force_scale, all_awake=True)
            attempts.append(solution.report)
            if solution.report.converged:
                reason = self._volume_ratio.inverted() or next(
                    filter(None, map(lost_nodes, steps)), ""
                )
                if not reason:
                    break
                attempts[-1] = replace(solution.report, reason=reason)
        else:
            u[:] = u_n
            reasons = "; ".join(
                f"from the {start} state: {attempt}"
                for start, attempt in zip(starts, attempts, strict=True)
            )
            materials = {body.material for body in self.bodies}
            weak = {type(m).__name__ for m in materials if not m.resists_collapse}
            if "is inverted" in reasons and weak:
                reasons += (
                    f"; {' and '.join(sorted(weak))} cannot resist being squashed, NeoHookean can"
                )
            restless = np.concatenate([np.empty(0, dtype=np.int64), *(s.restless for s in steps)])
            nodes = np.unique(np.concatenate(self._bulk.comm.allgather(restless)))
            if len(nodes):
                reasons += f"; nodes that keep changing segment or state: {listed(nodes)}"
            raise newton.ConvergenceError(
                f"step {self.step + 1} from t = {self.t:g} to {self.t + dt:g} failed {reasons}; "
                "the state is that of the last accepted step: a smaller dt may help",
                attempts,
            )

        comm = self.u.function_space.mesh.comm
        n = 3 * self._num_owned
        work = ContactWork()
        for pair, step, state in zip(self.pairs, steps, solution.states, strict=True):
            history = step.accepted(state)
            work = work + step.work(state, history)
            pair.history = history
        du = (u - u_n)[:n]
        support_work = self._support_work(steps, solution.states, du)
        lost = 0.0 if self._dissipation is None else fem.assemble_scalar(self._dissipation)
        loaded = self._bulk.load() @ du if self.loads else 0.0
        in_reach = sum(len(step.neighbourhood.size) for step in steps)
        sums = comm.allreduce(np.array([loaded, -lost, solution.R @ du, in_reach]))
        load_work, damping_work, solver_work = (float(value) for value in sums[:3])
        self._mean_velocity = (u - u_n) / dt
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
            num_segments=int(sums[3]),
            num_resting=len(self._rest.bodies),
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
            stiffness = self._bulk.nodal_stiffness()
            steps = [
                ContactStep(pair, self._contact, x_n, x_trial, stiffness, self._free)
                for pair in self.pairs
            ]
        if not all_awake:
            self._rest.find(self.v.x.array, self.u_n.x.array, steps)
        solution = newton.solve(
            self._bulk,
            self._solver,
            steps,
            self._X[: self._num_owned],
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
        return [*super().describe(), f"linear solver: {self._solver}"]

    def _norm(self, values: Floats) -> float:
        """Euclidean norm of values on the owned dofs. Collective."""
        return float(np.sqrt(self.u.function_space.mesh.comm.allreduce(values @ values)))

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
        self, steps: Sequence[ContactStep], states: Sequence[ContactState], du: Floats
    ) -> float:
        """Work of the reactions in a step with increment du [J]. Collective."""
        comm, fixed = self.u.function_space.mesh.comm, self._bulk.fixed
        if not comm.allreduce(bool(du[fixed].any()), op=MPI.LOR):
            return 0.0
        # States keep the forces on given displacements apart.
        everywhere = [replace(state, residual=state.force) for state in states]
        reaction = self._bulk.forces() + contact_residual(steps, everywhere, len(du))
        return float(comm.allreduce(reaction[fixed] @ du[fixed]))

    def _state_was_set(self) -> None:
        self._mean_velocity = self.v.x.array.copy()
