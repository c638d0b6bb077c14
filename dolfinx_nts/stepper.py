r"""Stepper: owns the accepted state and advances it.

The unknown of a step is u_{n+1}; the velocity follows from it,
:math:`v_{n+1} = 2 (u_{n+1} - u_n)/\Delta t - v_n`. The balance of momentum
of a step, divided by its length, is

.. math:: M \frac{2}{\Delta t} \left( \frac{u_{n+1} - u_n}{\Delta t} - v_n
   \right) + f_{int} + f_{damp} + \sum \lambda_N F = f_{ext}.

The schemes differ in the stress of f_int and in the kernel of the contact
force F, in nothing else.
"""

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from tqdm import tqdm

from dolfinx_nts import newton
from dolfinx_nts.assembly import JIT_OPTIONS, Bulk, contact_residual
from dolfinx_nts.bodies import Body, VolumeRatio, bulk_form, check_bodies
from dolfinx_nts.contact import ContactPair, ContactWork
from dolfinx_nts.contact_rows import ContactState
from dolfinx_nts.contact_step import ContactStep
from dolfinx_nts.linear import LinearSolver
from dolfinx_nts.loads import Load
from dolfinx_nts.materials import Hyperelastic, right_cauchy_green
from dolfinx_nts.timing import Timings

__all__ = ["StepReport", "Stepper"]

Floats = npt.NDArray[np.float64]

_logger = logging.getLogger("dolfinx_nts")


@dataclass(frozen=True)
class StepReport:
    """What happened in an accepted step.

    The works are energy given to the bodies; with that of the bulk,
    `Diagnostics.bulk_defect`, they add up to the change of kinetic and
    strain energy.

    Attributes:
        step: Number of the step, from 1.
        t: Time at its end [s].
        dt: Its length [s].
        newton_iterations: Linear systems solved, all attempts.
        active_set_changes: Pairs that changed during the iteration.
        residual_norms: Norms before each linear solve, and the last [N].
        num_active: Active pairs on all ranks.
        contact_work: Work of contact, by cause.
        load_work: Work of the loads [J].
        support_work: Work of the reactions at moving supports [J].
        damping_work: Work of damping, never positive [J].
        solver_work: Work of the residual that Newton left [J].
    """

    step: int
    t: float
    dt: float
    newton_iterations: int
    active_set_changes: int
    residual_norms: tuple[float, ...]
    num_active: int
    contact_work: ContactWork
    load_work: float
    support_work: float
    damping_work: float
    solver_work: float


class Stepper(ABC):
    """Owns the accepted state (t, u, v, contact) and advances it.

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
            Krylov method, such as ``pc_type`` for the preconditioner of
            the bulk. Tolerances are set by Newton's method.

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

    _contact: ClassVar[str]  # contact kernel
    _inertia: ClassVar[bool] = True  # whether rates matter
    _trial: ClassVar[str] = "ballistic"  # start that decides which nodes may touch
    _load_point: ClassVar[float] = 0.5  # where in a step the loads are taken

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
        V = check_bodies(bodies)
        for pair in pairs:
            if not isinstance(pair, ContactPair):
                raise TypeError(f"expected a ContactPair, given {type(pair).__name__}")
            if pair.nodes.V != V:
                raise ValueError("expected bodies and pairs in one function space, given two")
            if pair.is_convective and self._contact != "midpoint":
                raise ValueError(
                    f"expected Midpoint with convective friction, given {type(self).__name__}"
                )
        for load in loads:
            if not isinstance(load, Load):
                raise TypeError(f"expected a load, given {type(load).__name__}")
            if load.V != V:
                raise ValueError("expected bodies and loads in one function space, given two")
        self.bodies, self.pairs, self.loads = tuple(bodies), tuple(pairs), tuple(loads)
        self.t, self.step = 0.0, 0
        self.timings = Timings()
        self._update = update
        self._dt = fem.Constant(V.mesh, 0.0)
        self.dt = dt
        self.u, self.v, self.u_n = (fem.Function(V) for _ in range(3))
        self.u.name, self.v.name = "displacement", "velocity"
        self._X: Floats = V.tabulate_dof_coordinates()
        self._num_owned = V.dofmap.index_map.size_local
        self._bulk = Bulk(self._residual(), self.u, bcs, self._load_forms())
        self._solver = LinearSolver(self._bulk, petsc_options)
        self._free: Floats | None = None
        if bcs:
            self._free = np.ones((self._num_owned, 3))
            self._free.ravel()[self._bulk.fixed] = 0
        self._dissipation = self._dissipation_form()
        self._volume_ratio = VolumeRatio(self.u)
        self._internal_force = 0.0
        eta = ufl.TestFunction(V)
        momentum = bulk_form(bodies, lambda m, parameters, rho: rho * ufl.inner(self.v, eta))
        self._momentum_form = fem.form(momentum, jit_options=JIT_OPTIONS)
        self._mean_velocity: Floats = self.v.x.array.copy()

    @abstractmethod
    def first_piola(self, material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
        """First Piola-Kirchhoff stress of a step from F_n to F, UFL (3, 3)."""

    def _residual(self) -> ufl.Form:
        u, u_n, v, dt = self.u, self.u_n, self.v, self._dt
        eta = ufl.TestFunction(u.function_space)
        F_n, F = ufl.Identity(3) + ufl.grad(u_n), ufl.Identity(3) + ufl.grad(u)

        def integrand(material: Hyperelastic, parameters: dict[str, Any], rho: Any) -> Any:
            P = self.first_piola(material, parameters, F_n, F)
            work = ufl.inner(P, ufl.grad(eta))
            if self._inertia:
                momentum_rate = rho * 2 / dt * ((u - u_n) / dt - v)
                work += ufl.inner(momentum_rate, eta)
                work += self._damping(material, parameters, rho, eta)
            return work

        return bulk_form(self.bodies, integrand)

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
        return fem.form(form, jit_options=JIT_OPTIONS)

    def _load_forms(self) -> list[ufl.Form]:
        """Virtual work of each load in a step."""
        return [load.form(self.u_n, self.u) for load in self.loads]

    @property
    def dt(self) -> float:
        """Length of the next step [s]."""
        return float(self._dt.value)

    @dt.setter
    def dt(self, dt: float) -> None:
        if not (math.isfinite(dt) and dt > 0):
            raise ValueError(f"expected a step dt > 0, given {dt}")
        self._dt.value = dt

    @property
    def x(self) -> Floats:
        """Positions of the local nodes, owned then ghost, ``(l, 3)`` [m]."""
        x: Floats = self._X + self.u.x.array.reshape(-1, 3)
        return x

    def set_displacement(self, body: Body, value: Any) -> None:
        """Set the displacement of a body, before or between steps.

        Args:
            body: One of the bodies.
            value: Three numbers [m]; or a function of the reference
                positions, shape ``(3, n)``, that returns ``(3, n)``; or
                a Function.
        """
        self._set(self.u, body, value)

    def set_velocity(self, body: Body, value: Any) -> None:
        """Set the velocity of a body, before or between steps.

        Args:
            body: One of the bodies.
            value: Three numbers [m/s]; or a function of the reference
                positions, shape ``(3, n)``, that returns ``(3, n)``; or
                a Function.
        """
        self._set(self.v, body, value)

    def _set(self, function: fem.Function, body: Body, value: Any) -> None:
        if body not in self.bodies:
            raise ValueError("expected a body of this stepper, given another")
        X = self._X[body.nodes].T
        if isinstance(value, fem.Function):
            if value.function_space != self.u.function_space:
                raise ValueError("expected a Function of the bodies' space, given one of another")
            value = value.x.array.reshape(-1, 3)[body.nodes].T
        values = np.asarray(value(X) if callable(value) else value, dtype=np.float64)
        if values.shape not in ((3,), X.shape):
            raise ValueError(f"expected shape (3,) or {X.shape}, given {values.shape}")
        function.x.array.reshape(-1, 3)[body.nodes] = values.T
        self._mean_velocity = self.v.x.array.copy()

    def advance(self) -> StepReport:
        """Advance by one step of length ``dt``.

        Returns:
            Report of the step.

        Raises:
            ConvergenceError: The step could not be solved. The state is
                as before the call.
            ValueError: The state, a load or a condition is not finite,
                conditions conflict, or the first step starts inside a
                rigid obstacle. The state is as before the call.
        """
        self._check_state()
        if self.step == 0:
            for pair in self.pairs:
                pair.check_start(self.x)
        dt, x_n = self.dt, self.x
        if self._update is not None:
            self._update(self.t + dt)
        for load in self.loads:
            load.update(self.t + self._load_point * dt)
        self._bulk.supports.check()
        u, u_n = self.u.x.array, self.u_n.x.array
        u_n[:] = u
        starts = {
            name: self._bulk.supports.applied(start) for name, start in self._starts().items()
        }
        x_trial = self._X + starts[self._trial].reshape(-1, 3)
        stiffness = self._bulk.nodal_stiffness()
        momentum = self._momentum()
        # What the residual is compared with: forces that can be at work.
        force_scale = self._internal_force + 1e-3 * self._norm(momentum) / dt
        if self.loads:
            force_scale += self._norm(self._bulk.load())

        attempts: list[newton.NewtonReport] = []
        for start in starts.values():
            u[:] = start
            with self.timings.phase("contact"):
                steps = [
                    ContactStep(pair, self._contact, x_n, x_trial, stiffness, self._free)
                    for pair in self.pairs
                ]
            solution = newton.solve(
                self._bulk,
                self._solver,
                steps,
                self._X[: self._num_owned],
                force_scale=force_scale,
                timings=self.timings,
            )
            attempts.append(solution.report)
            if solution.report.converged:
                inverted = self._volume_ratio.inverted()
                if not inverted:
                    break
                attempts[-1] = replace(solution.report, reason=inverted)
        else:
            u[:] = u_n
            reasons = "; ".join(
                f"from the {start} state: {attempt}"
                for start, attempt in zip(starts, attempts, strict=True)
            )
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
        works = np.array([self._bulk.load() @ du if self.loads else 0.0, -lost, solution.R @ du])
        load_work, damping_work, solver_work = (float(value) for value in comm.allreduce(works))
        self._mean_velocity = (u - u_n) / dt
        self._update_velocity()
        rate = (self._momentum() - momentum) / dt if self._inertia else 0.0
        self._internal_force = self._norm(solution.R_bulk - rate)
        self.t += dt
        self.step += 1
        report = StepReport(
            step=self.step,
            t=self.t,
            dt=dt,
            newton_iterations=sum(attempt.iterations for attempt in attempts),
            active_set_changes=solution.report.active_set_changes,
            residual_norms=solution.report.residual_norms,
            num_active=solution.report.num_active,
            contact_work=work,
            load_work=load_work,
            support_work=support_work,
            damping_work=damping_work,
            solver_work=solver_work,
        )
        if comm.rank == 0:
            _logger.info(
                "step %d, t = %g: %d iterations, %d active",
                report.step,
                report.t,
                report.newton_iterations,
                report.num_active,
            )
        return report

    def _norm(self, values: Floats) -> float:
        """Euclidean norm of values on the owned dofs. Collective."""
        return float(np.sqrt(self.u.function_space.mesh.comm.allreduce(values @ values)))

    def _momentum(self) -> Floats:
        """Momentum of the owned nodes, shape ``(3 n,)`` [kg m/s]."""
        vector = fem.assemble_vector(self._momentum_form)
        vector.scatter_reverse(la.InsertMode.add)
        momentum: Floats = vector.array[: 3 * self._num_owned]
        return momentum

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

    def run(self, until: float) -> Iterator[StepReport]:
        """Advance step by step; the last step ends exactly at ``until``.

        Args:
            until: Time at the end [s].

        Yields:
            The report of each step, after it has been accepted.
        """
        if not math.isfinite(until):
            raise ValueError(f"expected a finite time until, given {until}")
        start, dt = self.t, self.dt
        num_steps = math.ceil((until - start) / dt - 1e-6)
        try:
            for i in self._progress(num_steps):
                end = until if i == num_steps - 1 else start + (i + 1) * dt
                self.dt = end - self.t if i == num_steps - 1 else dt
                report = self.advance()
                self.t = end
                yield replace(report, t=end)
        finally:
            self.dt = dt

    def _progress(self, num_steps: int) -> Iterator[int]:
        """Count steps, with a bar on the terminal of rank 0 if it takes long."""
        silent = None if self.u.function_space.mesh.comm.rank == 0 else True
        yield from tqdm(range(num_steps), unit="step", delay=1, leave=False, disable=silent)

    def _check_state(self) -> None:
        bad = [
            sum(~np.isfinite(function.x.array[: 3 * self._num_owned]))
            for function in (self.u, self.v)
        ]
        bad = self.u.function_space.mesh.comm.allreduce(np.array(bad))
        for name, count in zip(("displacement", "velocity"), bad, strict=True):
            if count:
                raise ValueError(f"expected a finite {name}, given {count} dofs that are not")
