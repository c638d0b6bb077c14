"""Gradients of objectives of runs, by adjoint or tangent-linear steps."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_nts.common.archive import Snapshot
from dolfinx_nts.common.arguments import finite, whole
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.pair_state import PairState, keep_springs, springs_of
from dolfinx_nts.gradients.controls import InitialControl, ParameterControl, control_of
from dolfinx_nts.gradients.forces import ForceWeights, StepForces
from dolfinx_nts.gradients.objective import Objective, Term
from dolfinx_nts.gradients.start_derivative import start_derivative
from dolfinx_nts.gradients.step_derivative import MotionState, StepDerivative, StepRecord
from dolfinx_nts.gradients.stored_run import StoredRun
from dolfinx_nts.gradients.support import check_supported, has_adjoint
from dolfinx_nts.integrators.implicit.implicit_stepper import ImplicitStepper, equations_of
from dolfinx_nts.integrators.step_control import ROUND_OFF
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["Gradient"]

# Largest number of controls with tangent-linear steps, one sweep for each.
_MOST_DIRECTIONS = 50


class Gradient:
    """Derivatives of an objective of a run with respect to controls.

    The steps of the scheme are differentiated, not the equations in time, so that gradients are
    those of the computed objective. Contact of nodes with segments by springs without friction is
    differentiated exactly. Mortar contact and friction are differentiated by central differences of
    the contact of each step along one direction, with errors of about 1e-8, or up to 1e-5 in a step
    in which nodes begin to touch. A run raises a ValueError if such contact chooses its points
    again within a step. In statics it also does if points do not settle in equilibrium, or if
    nothing resists a rigid motion. Optimisers of SciPy take `value` and `gradient` as they are.
    Each call repeats the run from the state at which the object was made, and leaves the stepper at
    the end of the run. Springs of contact keep the stiffness that the first run has chosen. Which
    nodes touch, and whether they slip, is constant within a step; at controls where this changes,
    derivatives are one-sided. Collective, as are all methods.

    Args:
        stepper: An `EnergyMomentum`, `Midpoint`, `GeneralizedAlpha` or `QuasiStatic` stepper before
            the run.
        controls: Each a ``fem.Constant`` or ``fem.Function`` in an energy, a load or the objective,
            the value [m] of a condition in ``bcs``, or a coefficient of a law of friction, as in
            ``Coulomb(mu)``; a ``fem.Constant`` from which ``update`` computes the values of
            conditions; or ``stepper.u`` or ``stepper.v`` for the initial state. Their values do not
            change in a run.
        objective: UFL functional of ``stepper.u`` and ``stepper.v``, in `GeneralizedAlpha` also of
            ``stepper.a``, at the end of the run; or a function of the time [s] that returns a
            functional of the state at the end of a step ending then, or None. The objective is the
            sum of all of them.
        until: Time at the end of the run [s].
        forces: Conditions in ``bcs``, for the force of these supports, see `Reaction`; surfaces or
            bodies, for the contact force on all of their nodes, by all pairs. The objective is then
            a function of the time and of each force, a vector ``fem.Constant`` (x, y, z), in the
            plane (x, y), axisymmetric (y,) [N], with the value of the step. It may also return a
            scalar of these, without integral.
        stored_steps: Number of steps whose states are stored. None for all. Otherwise the state is
            stored at every so many steps, and the steps between are repeated for a gradient, which
            takes the time of one more run.

    Attributes:
        stepper: The argument.

    Raises:
        TypeError: A control, a force or the objective is of another kind.
        ValueError: The stepper has parts without derivatives, which the message names, a control
            occurs nowhere, or a force is not one of the stepper. The methods also raise ValueError
            if a control changes in the run, or if ``update`` computes anything but values of
            conditions from a control.

    Example:
        >>> stepper = nts.EnergyMomentum(bodies, dt=0.01)
        >>> kinetic = ufl.inner(stepper.v, stepper.v) * ufl.dx
        >>> J = nts.Gradient(stepper, [stepper.v], kinetic, until=0.02)
        >>> J.gradient(np.ones(J.controls.size)).shape == J.controls.shape
        True

        Force of a support that presses a block down, and its stiffness:

        >>> lift = fem.Constant(mesh, np.array([0.0, 0.0, -0.02]))  # m
        >>> upper = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], 1.01))
        >>> lower = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], 0.0))
        >>> moved, held = fem.dirichletbc(lift, upper, V), fem.dirichletbc(np.zeros(3), lower, V)
        >>> pair = nts.ContactPair(bottom, top, nts.Penalty(), method="node-to-segment")
        >>> press = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=[moved, held])
        >>> J = nts.Gradient(press, [lift], lambda t, force: force[2], until=1.0, forces=[moved])
        >>> bool(J.value() < 0 < J.gradient()[2])
        True
    """

    def __init__(
        self,
        stepper: ImplicitStepper,
        controls: Sequence[Any],
        objective: ufl.Form | Callable[..., ufl.Form | Expr | None],
        *,
        until: float,
        forces: Sequence[fem.DirichletBC | Surface | Body] = (),
        stored_steps: int | None = None,
    ) -> None:
        check_supported(stepper)
        self.stepper, self._until = stepper, finite("until", until)
        if not self._until > stepper.t:
            raise ValueError(
                f"expected the end of the run after the time of the stepper, {stepper.t:g} s, "
                f"given until = {until:g}: make all gradients before the first run"
            )
        self._every = None if stored_steps is None else whole("stored_steps", stored_steps)
        self._controls = [
            control_of(value, stepper, f"control {i} of {len(controls)},")
            for i, value in enumerate(controls, start=1)
        ]
        if not self._controls:
            raise ValueError("expected at least one control, given none")
        self._ends = np.cumsum([control.size for control in self._controls])
        self._parameters = [c for c in self._controls if isinstance(c, ParameterControl)]
        self._comm = stepper.u.function_space.mesh.comm
        self._equations = equations = equations_of(stepper)
        self._steps = StepDerivative(equations, self._parameters)
        self._begin = start_derivative(equations, self._parameters)
        values = [control.value for control in self._parameters]
        state = (stepper.u, stepper.v, *self._steps.carried[1:])
        self._forces = StepForces(forces, equations)
        self._objective = Objective(objective, state, values, self._forces.constants)
        self._given = objective
        self._check_occurrence()
        self._start = Snapshot()
        stepper.serialize(self._start)
        # Values of initial states; the stepper has values at the end of the run.
        self._x = np.concatenate([control.get() for control in self._controls])
        # Springs of the first run, by pair.
        self._springs: dict[PairState, tuple[Any, ...]] = {}
        # Controls, objective and states of the last run.
        self._of: Floats | None = None
        self._value, self._stored = 0.0, self._new_store()

    @property
    def controls(self) -> Floats:
        """Values of all controls in their order, the same on all ranks, shape ``(m,)``."""
        parts = [
            part if isinstance(control, InitialControl) else control.get()
            for control, part in zip(self._controls, self._split(self._x), strict=True)
        ]
        values: Floats = np.concatenate(parts)
        return values

    def value(self, controls: Floats | None = None) -> float:
        """Objective of the run.

        Args:
            controls: Values of the controls, shape ``(m,)``; None for the current ones.
        """
        self._run(controls)
        return self._value

    def gradient(self, controls: Floats | None = None) -> Floats:
        """Gradient of the objective, by one transposed linear system a step.

        With mortar contact or friction it takes one tangent-linear run for each control.

        Args:
            controls: Values of the controls, shape ``(m,)``; None for the current ones.

        Returns:
            Derivatives in the order of the controls, the same on all ranks, shape ``(m,)``.

        Raises:
            ValueError: There are more than 50 controls with mortar contact or friction.
        """
        self._run(controls)
        with self._kept():
            if not self._stored.has_differences:
                return self._adjoint()
            m = int(self._ends[-1])
            if m > _MOST_DIRECTIONS:
                raise ValueError(
                    f"expected at most {_MOST_DIRECTIONS} controls for a gradient through "
                    f"{self._without_adjoint()}, given {m}: contact with method "
                    "'node-to-segment' and without friction has an adjoint, whose cost does not "
                    "depend on their number; derivative() is for one direction"
                )
            return np.array([self._tangent(row) for row in np.eye(m)])

    def derivative(self, direction: Floats, controls: Floats | None = None) -> float:
        """Derivative of the objective along a change of the controls, by tangent-linear steps.

        Args:
            direction: The change, shape ``(m,)``.
            controls: Values of the controls, shape ``(m,)``; None for the current ones.
        """
        self._run(controls)
        with self._kept():
            return self._tangent(self._checked(direction, "a direction"))

    def _check_occurrence(self, *, is_solved: bool = False) -> None:
        """Raise if a control occurs nowhere; functions of the time may return any form.

        ``is_solved`` is whether all steps have been differentiated, so that it is known what
        ``update`` computes from controls.
        """
        objective, of_objective = self._given, tuple[Any, ...]()
        if isinstance(objective, ufl.Form):
            of_objective = (*objective.constants(), *objective.coefficients())
        steps = self._steps
        derivatives = zip(steps.of_controls, steps.of_supports, steps.of_friction, strict=True)
        for control, parts in zip(self._parameters, derivatives, strict=True):
            (forms, _), support, is_coefficient = parts
            acts = support.acts if is_solved else support.may_act
            is_known = forms.exists or acts or is_coefficient or control.value in of_objective
            if not (is_known or (callable(objective) and not of_objective)):
                raise ValueError(
                    "expected controls in an energy, a load, a condition of bcs, a law of friction "
                    f"or the objective, given {control.name}, which occurs in none"
                )

    def _check_kept(self) -> None:
        """Raise if a control has not kept its values in a step."""
        both = zip(self._controls, self._split(self._x), strict=True)
        known = [(c, values) for c, values in both if isinstance(c, ParameterControl)]
        own = np.array([not control.holds(values) for control, values in known], dtype=bool)
        for i in reductions.anywhere(self._comm, own).nonzero()[0]:
            raise ValueError(
                f"expected controls that keep their values in a run, given {known[i][0].name}, "
                "which has changed in a step: let update compute the motion in another Constant, "
                "from the control and the time"
            )

    def _split(self, values: Floats) -> list[Floats]:
        return np.split(values, self._ends[:-1])

    def _checked(self, values: Any, name: str) -> Floats:
        array: Floats = np.asarray(values, dtype=float).ravel()
        if array.shape != (self._ends[-1],):
            raise ValueError(
                f"expected {name} of shape ({self._ends[-1]},), as that of controls, given shape "
                f"{np.shape(values)}"
            )
        return array

    def _new_store(self) -> StoredRun:
        known = self._every, self._equations, self._forces
        return StoredRun(self.stepper, self._steps.carried, *known)

    def _without_adjoint(self) -> str:
        """Name of contact without an adjoint."""
        pairs = [pair for pair in self.stepper.pairs if not has_adjoint(pair)]
        return pairs[0].describe() if pairs else "springs that lost their segments"

    def _run(self, controls: Floats | None) -> None:
        """Run with given controls, unless the last run had them."""
        x = self.controls if controls is None else self._checked(controls, "controls")
        if self._of is not None and np.array_equal(x, self._of):
            return
        self._x, self._of = x.copy(), None
        self.stepper.serialize(self._start.rewind())
        for contact, springs in self._springs.items():
            keep_springs(contact, springs)
        for control, part in zip(self._controls, self._split(x), strict=True):
            control.set(part)
        self._value, self._stored = 0.0, self._new_store()
        for step in self._stored.forward(self._until):
            self._check_kept()
            is_end = self._until - step.t <= ROUND_OFF * step.dt
            term = self._term(step, is_end=is_end)
            self._value += 0.0 if term is None else term.value()
        self._springs = self._springs or {
            each: springs_of(each) for each in self._equations.contacts
        }
        self._of = self._x

    @contextmanager
    def _kept(self) -> Iterator[None]:
        """Context that restores the state of the stepper at the end of the run."""
        end = Snapshot()
        self.stepper.serialize(end)
        try:
            with self._steps.without_sleeping_bodies():
                yield
            self._check_occurrence(is_solved=True)
        finally:
            self.stepper.serialize(end.rewind())

    def _term(self, step: StepRecord, *, is_end: bool) -> Term | None:
        """Term of the objective at the end of a step, whose state is set."""
        self._forces.set(step.forces)
        return self._objective.term(step.t, is_end=is_end)

    def _slopes(
        self, step: StepRecord, *, is_end: bool
    ) -> tuple[list[Floats], list[Floats | float], ForceWeights | None]:
        """Slopes of the term at the end of a step for state, parameters and forces."""
        slopes, term = self._objective.zeros(), self._term(step, is_end=is_end)
        if term is None:
            return slopes, [0.0 for _ in self._parameters], None
        self._steps.take_end(step)
        term.add_slopes(slopes)
        found, m = term.gradients(), len(self._parameters)
        return slopes, found[:m], self._forces.weights(found[m:])

    def _adjoint(self) -> Floats:
        """Gradient by a sweep backwards."""
        gradients = [np.zeros(control.size) for control in self._parameters]
        costate = self._steps.zeros()
        for step, is_end in self._stored.steps(backwards=True):
            slopes, of_parameters, weights = self._slopes(step, is_end=is_end)
            for gradient, part in zip(gradients, of_parameters, strict=True):
                gradient += part
            costate = self._steps.adjoint(step, _with(costate, slopes), gradients, weights)
        if self._stored.computes_acceleration and self._begin is not None:
            costate = self._begin.adjoint(step, costate, gradients)
        known = iter(gradients)
        return np.concatenate(
            [
                control.gathered(_of_velocity(costate) if control.is_velocity else costate.u)
                if isinstance(control, InitialControl)
                else next(known)
                for control in self._controls
            ]
        )

    def _tangent(self, direction: Floats) -> float:
        """Derivative by a sweep forwards."""
        parts = self._split(direction)
        both = list(zip(self._controls, parts, strict=True))
        changes = [part for control, part in both if isinstance(control, ParameterControl)]
        change = self._steps.zeros()
        for control, part in both:
            if isinstance(control, InitialControl):
                rates = change.rates
                for values in [rates[0], rates[-1]] if control.is_velocity else [change.u]:
                    values.ravel()[:] = control.owned(part)
        total, begin = 0.0, self._begin if self._stored.computes_acceleration else None
        for step, is_end in self._stored.steps(backwards=False):
            if begin is not None:
                change, begin = begin.tangent(step, change, changes), None
            slopes, of_parameters, weights = self._slopes(step, is_end=is_end)
            change, of_forces = self._steps.tangent(step, change, changes, weights)
            total += of_forces
            total += sum(np.sum(s * c) for s, c in zip(of_parameters, changes, strict=True))
            known = zip(slopes, [change.u, *change.rates], strict=False)
            total += reductions.total(self._comm, sum(float(np.vdot(*both)) for both in known))
        return total


def _of_velocity(costate: MotionState) -> Floats:
    """Costate of an initial velocity, which is the mean velocity before the first step. Local."""
    of_velocity: Floats = costate.rates[0] + costate.rates[-1]
    return of_velocity


def _with(costate: MotionState, slopes: Sequence[Floats]) -> MotionState:
    """Sum of a costate and the slopes of a term with respect to displacement and rates. Local."""
    rates = [old + slope for old, slope in zip(costate.rates, slopes[1:], strict=False)]
    return costate._replace(u=costate.u + slopes[0], rates=rates)
