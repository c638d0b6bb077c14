"""Statics: equilibria at the ends of steps."""

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.integrators.attempt import Start, StepProblem
from dolfinx_nts.integrators.implicit import ImplicitStepper
from dolfinx_nts.integrators.rates import NoRates
from dolfinx_nts.integrators.relaxation import PseudoStep, Relaxation
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.integrators.unstable_equilibrium import UnstableEquilibrium
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers import newton
from dolfinx_nts.solvers.drag import Drag
from dolfinx_nts.solvers.newton_report import NewtonReport
from dolfinx_nts.solvers.prescribed_motion import PrescribedMotion
from dolfinx_nts.solvers.substepped_motion import SubsteppedMotion

__all__ = ["QuasiStatic"]

_logger = logging.getLogger("dolfinx_nts")

# Way of what is led, relative to the smallest cell [-], that cells at it can take alone.
_SMALL_WAY = 1e-3


def _end_stress(material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
    return F * material.stress(right_cauchy_green(F), **parameters)


class QuasiStatic(ImplicitStepper):
    """Finds the equilibrium at the end of each step, without inertia.

    Time only counts the load. Contact is closed, g = 0: without motion there is no impact, so
    that the kind of impact of a multiplier does not matter. Friction follows the slip from step
    to step. Bodies that only contact holds are found and named in the log. The tangent, not the
    balance, gets a small stiffness for them; motions that contact without friction does not
    resist are not made, and forces in them are left to inertia while they are below 1 %
    (inertia relief: zero where there is an equilibrium, and told otherwise). A step in which
    nothing holds a body is refused with its name. Where Newton's method finds no equilibrium
    near the last one, as at a limit load or where facets let bodies roll, they go to another
    one against a viscous resistance, which vanishes: the equilibrium is as exact as any other,
    and the log tells it. The velocity stays zero, a step with another one is refused, and
    damping has no effect. Arguments, attributes and errors are those of `EnergyMomentum`.
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

    def _static_way(self) -> float:
        return self._way

    def _check_state(self) -> None:
        super()._check_state()
        speed = _kernels.largest_size(self.v.x.array)
        if (speed := reductions.largest(self._comm, float(speed))) > 0:
            raise ValueError(
                f"expected no velocity in QuasiStatic, given one of up to {speed:g}: it finds "
                "equilibria without inertia, in which nothing flies; EnergyMomentum moves bodies"
            )

    @cached_property
    def _unstable(self) -> UnstableEquilibrium:
        """Tells of equilibria that are not stable."""
        return UnstableEquilibrium(self._comm, self.bodies)

    def _look_at(self, steps: Sequence[ContactStep], solution: newton.Solution) -> None:
        """Tell if an equilibrium is not stable."""
        if solution.report.iterations:
            motion = self._solver.negative_curvature_direction(
                steps, solution.end.states, self.step
            )
            self._unstable.look(motion, self._X[: len(self.node_ids)], self.t + self.dt)

    def _attempts(
        self, starts: Iterable[Start], failed: Mapping[str, NewtonReport]
    ) -> Iterator[Start]:
        """Starts to try in turn; if the first is not decided, all nodes stick at first next.

        Where others slide before Newton's method is near to an equilibrium, bodies that friction
        alone holds, as what rolls, go far by that, and what slid then may go on to do so without
        any contradiction but that of others.
        """
        first, *others = starts
        last = others[-1] if others else first
        yield first
        has_friction = any(pair.friction for pair in self.pairs)
        if has_friction and any(report.is_undecided for report in failed.values()):
            yield replace(last, name="sticking", begins_sticking=True)
        yield from others

    def _elsewhere(
        self, start: Start, problem: StepProblem
    ) -> tuple[list[ContactStep], newton.Solution]:
        self.u.x.array[:] = start.guess
        drag, n = Drag(self._bulk, self._tangent), self._bulk.num_owned
        x_n, last = problem.x_n, self._X + self._in_space(start.guess)
        steps: list[ContactStep] = []
        after: list[ContactStep] = []
        solution: newton.Solution

        def attempt(part: float) -> PseudoStep:
            """Solve from the last state."""
            nonlocal steps, solution
            acting = drag if part else None
            with drag.acting(part, start.guess[:n]):
                steps, solution = self._solve(
                    start, problem, all_awake=True, drag=acting, after=after
                )
            report = solution.report
            way, self._way = (
                reductions.largest(self._comm, _kernels.farthest(self.x, there))
                for there in (last, x_n)
            )
            if report.converged:
                wrong = self._volume_ratio.inverted() if part else self._wrong(steps, x_n)
                report = replace(report, reason=wrong)
            return PseudoStep(report, way, self._way)

        def accept() -> None:
            """Make it the last state."""
            nonlocal start, problem, last, after
            u = self.u.x.array.copy()
            start, last, after = replace(start, u=u, guess=u), self.x, steps
            problem = replace(problem, x_trial=last)

        size = self._sizes.smallest
        relaxation = Relaxation(attempt, accept, farthest=self._extent(), size=size)
        report = relaxation.find()
        if report.converged:
            self.watch.vertices.accept()
            if self._comm.rank == 0:
                _logger.warning(
                    "step %d to t = %g: Newton's method found no equilibrium near the last one; "
                    "bodies went to another one, which is as exact, by up to %.3g m, in %d "
                    "pseudo-steps against a viscous resistance: they snap or roll there. With "
                    "inertia they may go elsewhere, which EnergyMomentum follows",
                    *(self.step + 1, self.t + self.dt, self._way, relaxation.num_steps),
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
        """All of the way from the last state, where all of the bodies goes along. Collective.

        Cells at what is led, and nodes that stick to it, could not take it alone.
        """
        guess, u, size = start.guess, self.u.x, self._sizes.smallest
        if reductions.anywhere(self._comm, not np.array_equal(guess, self.u_n.x.array)):
            return super()._motion_from(start, steps)
        ways = [_kernels.largest_size(u.array - guess)]
        ways += [contact.search.way(self.x, 0.0) for contact in self.contacts]
        way = reductions.largest(self._comm, float(max(ways)))
        if way <= _SMALL_WAY * size:
            return super()._motion_from(start, steps)
        u.array[:] = guess
        stiffness = self._solver.nodal_resistance()
        return SubsteppedMotion(self._bulk, steps, stiffness, self._sizes.nodal, way)

    def _time_helps(self) -> str:
        """Advice where only the length of the step is left to change. Collective."""
        moves = any(contact.search.may_move for contact in self.contacts)
        if not self._script.updates and not moves:
            load = self._forces.loads()
            self._load_at(0.0)
            change = self._forces.norm(self._forces.loads() - load)
            self._load_at(self.scheme.load_point)
            if change == 0.0:
                return "loads that grow with time from step to step may help"
        return super()._time_helps()
