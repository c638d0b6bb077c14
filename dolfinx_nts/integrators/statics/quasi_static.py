"""Statics: equilibria at the ends of steps."""

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import chain
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.integrators.implicit.attempt import Start, StepProblem
from dolfinx_nts.integrators.implicit.implicit_stepper import ImplicitStepper
from dolfinx_nts.integrators.rates import NoRates
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.integrators.statics.relaxation import PseudoStep, Relaxation
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers import newton
from dolfinx_nts.solvers.newton_report import NewtonReport
from dolfinx_nts.solvers.prescribed_motion import PrescribedMotion
from dolfinx_nts.solvers.statics.drag import Drag
from dolfinx_nts.solvers.substepped_motion import SubsteppedMotion

__all__ = ["QuasiStatic", "UnstableEquilibrium"]

_logger = logging.getLogger("dolfinx_nts")

# Prescribed increment relative to the smallest cell [-] above which it is applied in substeps.
# Larger: adjacent cells may be inverted.
_SMALL_INCREMENT = 1e-3


class UnstableEquilibrium:
    """Warning when an equilibrium is unstable and the last one was stable. Collective.

    Args:
        comm: Communicator.
        bodies: All bodies.
        has_friction: Whether a pair has friction. Its forces are constant in the check, so that a
            motion which it opposes may be reported.
    """

    def __init__(self, comm: MPI.Comm, bodies: Sequence[Body], *, has_friction: bool) -> None:
        self._comm, self._bodies, self._is_reported = comm, bodies, False
        self._has_friction = has_friction

    def check(self, motion: Floats | None, X: Floats, t: float) -> None:
        """Warn if an equilibrium is unstable and the last one was not.

        Args:
            motion: Direction of negative curvature of the potential energy at the owned nodes,
                shape ``(n, d)``; None if there is none.
            X: Their reference positions, shape ``(n, 3)`` [m].
            t: Time [s].
        """
        is_new, self._is_reported = motion is not None and not self._is_reported, motion is not None
        if motion is None or not is_new:
            return
        size = np.linalg.norm(motion, axis=1)
        found = [
            (size[node], self._comm.rank, self._names(node), X[node], in_space(motion)[node])
            for node in np.argsort(size)[-1:]
        ]
        every = chain(*self._comm.allgather(found))
        largest, _, name, place, direction = max(every, key=lambda each: each[:2])
        if self._comm.rank == 0:
            end = "so that any disturbance ends it"
            if self._has_friction:
                end = "at constant friction: only more friction against this motion can prevent it"
            _logger.warning(
                "at t = %g the equilibrium is unstable, as in buckling: the energy of bodies and "
                "loads decreases along a motion, largest in %s near (%s) along (%s), %s; to follow "
                "the motion, add a small force or imperfection in that direction, and use smaller "
                "steps",
                *(t, name, _listed(place), _listed(direction / largest), end),
            )

    def _names(self, node: int) -> str:
        """Names of the bodies with an owned node. Local."""
        return " and ".join(body.name for body in self._bodies if node in body.nodes)


def _listed(values: Floats) -> str:
    """Components in words, rounded to two digits of the largest one. Local."""
    digits = 1 - int(np.floor(np.log10(np.abs(values).max() or 1.0)))
    return ", ".join(f"{value:g}" for value in np.round(values, digits) + 0.0)


def _end_stress(material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
    return F * material.stress(right_cauchy_green(F), **parameters)


class QuasiStatic(ImplicitStepper):
    """Finds the equilibrium at the end of each step, without inertia.

    Time is a load parameter. Pairs without ``enforcement`` get multipliers. Gaps in contact are
    closed, g = 0, for any ``impact`` of the multipliers. Friction depends on the slip increment of
    each step. Damping has no effect. A step with a velocity other than zero is refused.

    Bodies that are supported only by contact are named in the log. For them the tangent contains a
    small stiffness, but not the balance of forces. Rigid motions that nothing resists are
    suppressed. Unbalanced forces below 1 % in these motions are balanced by inertia forces (inertia
    relief) and reported. A step in which a body has no support at all fails, and the error names
    the body.

    At a limit load, or where faceted bodies roll, Newton's method may find no equilibrium near the
    last one. Pseudo-transient continuation with a vanishing viscous resistance then finds another
    one with the same tolerance, and the log reports it. `run` halves a step that fails before it
    tries this, `advance` does not. Arguments, attributes and errors as for `EnergyMomentum`.
    Collective, as are all its methods.

    Example:
        >>> ends = fem.locate_dofs_geometrical(V, lambda x: (x[2] < 0.01) | (x[2] > 1.0))
        >>> clamp = fem.dirichletbc(np.zeros(3), ends, V)
        >>> gravity = nts.Gravity(bodies, (0.0, 0.0, -9.81))
        >>> stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=[clamp], loads=[gravity])
        >>> float(stepper.advance().load_work) > 0.0
        True
    """

    scheme = Scheme(
        contact="static",
        stress=_end_stress,
        rates=NoRates,
        stress_share=1.0,
        load_point=1.0,
        loads_at="end",
    )

    def _check_scheme(self) -> None:
        super()._check_scheme()
        if self.scheme.rates is not NoRates:
            raise TypeError(
                f"expected no attribute scheme of {type(self).__name__}, as QuasiStatic has no "
                "inertia: derive from ImplicitStepper for a scheme of your own"
            )

    def _static_increment(self) -> float:
        return self._increment

    def _check_state(self) -> None:
        super()._check_state()
        speed = _kernels.largest_size(self.v.x.array)
        if (speed := reductions.largest(self._comm, float(speed))) > 0:
            raise ValueError(
                f"expected no velocity in QuasiStatic, given one of up to {speed:g}: it finds "
                "equilibria without inertia; use EnergyMomentum for motion"
            )

    @cached_property
    def _unstable(self) -> UnstableEquilibrium:
        has_friction = any(pair.friction is not None for pair in self.pairs)
        return UnstableEquilibrium(self._comm, self.bodies, has_friction=has_friction)

    def _warn_if_unstable(self, steps: Sequence[ContactStep], solution: newton.Solution) -> None:
        if solution.report.iterations:
            motion = self._solver.negative_curvature_direction(
                steps, solution.end.states, self.step
            )
            self._unstable.check(motion, self._X[: len(self.node_ids)], self.t + self.dt)

    def _attempts(
        self, starts: Iterable[Start], failed: Mapping[str, NewtonReport]
    ) -> Iterator[Start]:
        """Starting guesses; if the first one fails by state changes, all nodes then stick at first.

        If nodes slide in early iterations, bodies that only friction supports, such as rolling
        bodies, move far. A wrong slip state may then be consistent for these nodes.
        """
        first, *others = starts
        last = others[-1] if others else first
        yield first
        has_friction = any(pair.friction for pair in self.pairs)
        if has_friction and any(report.is_undecided for report in failed.values()):
            yield replace(last, name="sticking", begins_sticking=True)
        yield from others

    def _most_long(self, start: str) -> int | None:
        """Number of long increments after which an attempt fails: 1 from the extrapolated guess.

        In nearly incompressible materials extrapolated displacements change volumes. The resulting
        pressures move nodes by many cells in the first increment. The last state with substeps is
        then a better guess.
        """
        return 1 if start == "extrapolated" else None

    def _relaxed(
        self, start: Start, problem: StepProblem
    ) -> tuple[list[ContactStep], newton.Solution]:
        self.u.x.array[:] = start.guess
        drag, n = Drag(self._bulk, self._tangent), self._bulk.num_owned
        x_n, last = problem.x_n, self._X + self._in_space(start.guess)
        steps: list[ContactStep] = []
        after: list[ContactStep] = []
        solution: newton.Solution

        def attempt(ratio: float) -> PseudoStep:
            nonlocal steps, solution
            acting = drag if ratio else None
            with drag.acting(ratio, start.guess[:n]):
                steps, solution = self._solve(
                    start, problem, all_awake=True, drag=acting, after=after
                )
            report = solution.report
            increment, self._increment = (
                reductions.largest(self._comm, _kernels.farthest(self.x, there))
                for there in (last, x_n)
            )
            if report.converged:
                wrong = (
                    self._volume_ratio.inverted()
                    if ratio
                    else self._rejection(steps, solution, x_n)
                )
                report = replace(report, reason=wrong)
            return PseudoStep(report, increment, self._increment)

        def accept() -> None:
            nonlocal start, problem, last, after
            u = self.u.x.array.copy()
            start, last, after = replace(start, u=u, guess=u), self.x, steps
            problem = problem.with_trial(last)

        size = self._sizes.smallest
        relaxation = Relaxation(attempt, accept, farthest=self._extent(), size=size)
        report = relaxation.find()
        if report.converged:
            self.watch.vertices.accept()
            if self._comm.rank == 0:
                _logger.warning(
                    "step %d to t = %g: Newton's method found no equilibrium near the last one; "
                    "bodies moved to another one of the same accuracy, by up to %.3g m, in %d "
                    "pseudo-steps against a viscous resistance: they snap or roll there. With "
                    "inertia they may move elsewhere: use EnergyMomentum to follow that",
                    *(self.step + 1, self.t + self.dt, self._increment, relaxation.num_steps),
                )
        return steps, replace(solution, report=report)

    def _extent(self) -> float:
        """Size of all bodies together [m]."""
        X = self._X[: len(self.node_ids)]
        top, low = X.max(axis=0, initial=-np.inf), X.min(axis=0, initial=np.inf)
        return float(
            np.linalg.norm(reductions.largest(self._comm, top) - reductions.least(self._comm, low))
        )

    def _motion_from(self, start: Start, steps: Sequence[ContactStep]) -> PrescribedMotion:
        """Prescribed motion from the last state, in substeps if it is large. Collective.

        In one increment, cells next to prescribed nodes would be inverted, and sticking nodes would
        lose contact with a moving tool.
        """
        guess, u, size = start.guess, self.u.x, self._sizes.smallest
        if reductions.anywhere(self._comm, not np.array_equal(guess, self.u_n.x.array)):
            return super()._motion_from(start, steps)
        sizes = [_kernels.largest_size(u.array - guess)]
        sizes += [contact.search.displacement_bound(self.x, 0.0) for contact in self.contacts]
        largest = reductions.largest(self._comm, float(max(sizes)))
        if largest <= _SMALL_INCREMENT * size:
            return super()._motion_from(start, steps)
        u.array[:] = guess
        stiffness = self._solver.nodal_resistance()
        return SubsteppedMotion(self._bulk, steps, stiffness, self._sizes.nodal, largest)

    def _step_length_advice(self) -> str:
        moves = any(contact.search.may_move for contact in self.contacts)
        if not self._script.updates and not moves:
            load = self._forces.loads()
            self._load_at(0.0)
            change = self._forces.norm(self._forces.loads() - load)
            self._load_at(self.scheme.load_point)
            if change == 0.0:
                return "loads that grow with time from step to step may help"
        return super()._step_length_advice()
