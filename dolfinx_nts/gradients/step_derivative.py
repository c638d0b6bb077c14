"""Derivative of one solved step: tangent-linear and adjoint."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.friction.limits import coefficients_of
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.gradients.bulk_derivatives import BulkDerivatives
from dolfinx_nts.gradients.contact_derivative import (
    WIDTH,
    ContactDerivative,
    ContactMotion,
    Histories,
)
from dolfinx_nts.gradients.contact_difference import ContactDifference, ContactResult
from dolfinx_nts.gradients.controls import FormDerivative, ParameterControl
from dolfinx_nts.gradients.forces import ForceWeights
from dolfinx_nts.gradients.prescribed_derivative import PrescribedDerivative
from dolfinx_nts.gradients.rate_updates import RateUpdate, rate_update
from dolfinx_nts.integrators.implicit.implicit_stepper import StepEquations
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.linear.tangent_solver import TangentSolver

__all__ = ["MotionState", "StepDerivative", "StepRecord"]

# Largest displacements in differences, relative to the longest segment [-]. They are tried until
# forces are straight. Larger: curvature of gaps, and of the tractions of nodes that hardly slide;
# smaller: round-off of positions.
_STEPS = (1e-6, 1e-7, 1e-8, 1e-9)
# Deviation of forces in a difference from a straight line, relative to their change [-], that is
# admissible. Larger: errors where nodes touch; smaller: more differences.
_STRAIGHT = 1e-5
# Contact points chosen in equilibrium follow the change of the displacement. Largest number of
# solutions for both; admissible difference of the last two, relative to the displacement [-]; and
# its limit if the difference does not halve, as with round-off of small differences.
_MOST_SOLUTIONS, _SETTLED, _ROUNDED = 20, 1e-9, 1e-6


class MotionState(NamedTuple):
    """Displacement and rates in a state, or their perturbations or costates.

    Attributes:
        u: Displacement.
        rates: Rates that are part of the state, see `RateUpdate`.
        histories: Contact histories, for perturbations and costates only.
    """

    u: Floats
    rates: list[Floats]
    histories: Histories


class StepRecord(NamedTuple):
    """A solved step.

    Attributes:
        t_n: Time at its start [s].
        dt: Its length [s].
        t: Time at its end [s].
        start, end: States at its ends, values of the local dofs, each ``(d l,)``.
        contacts: Derivatives of its contact.
        differences: Contact whose derivatives are known along one direction only.
        forces: Forces in the objective, see `StepForces`.
    """

    t_n: float
    dt: float
    t: float
    start: MotionState
    end: MotionState
    contacts: Sequence[ContactDerivative]
    differences: Sequence[ContactDifference]
    forces: Sequence[Floats]


class StepDerivative:
    """Tangent-linear and adjoint of solved steps. Collective, as are its methods.

    Args:
        equations: Equations of the steps.
        controls: Parameters of the forms.

    Attributes:
        carried: Functions of the carried rates.
        released: Springs that return energy to the bodies; None without inertia.
        of_controls: Derivatives of the residual with respect to the parameters.
        of_supports: Derivatives of the prescribed displacements with respect to the parameters.
        of_friction: Whether each parameter is a coefficient of friction.
    """

    def __init__(self, equations: StepEquations, controls: Sequence[ParameterControl]) -> None:
        self._equations, self._bulk = equations, equations.bulk
        self._rates = rates = equations.rates
        self.released = equations.released
        self.carried: Sequence[fem.Function] = rate_update(rates).carried
        self._derivatives = derivatives = BulkDerivatives(equations.bulk, rates, self.carried)
        self._solver = TangentSolver(equations.tangent, equations.bulk.comm)
        self.of_controls: list[tuple[FormDerivative, FormDerivative]] = []
        self._controls = controls
        laws = [coefficients_of(s.pair.friction, s.pair.nodes) for s in equations.contacts]
        coefficients = [*chain(*laws)]
        self.of_friction = [any(c.value is each for each in coefficients) for c in controls]
        self.of_supports = [PrescribedDerivative(equations, control) for control in controls]
        mesh = rates.u.function_space.mesh
        for control in controls:
            value = control.value
            names = equations.in_forms(value)
            self.of_controls.append(
                (
                    FormDerivative(mesh, derivatives.forms, value, names),
                    FormDerivative(mesh, derivatives.adjoint_forms, value, names),
                )
            )
        V = rates.u.function_space
        self._shape = V.dofmap.index_map.size_local, dimension(V)

    @contextmanager
    def without_sleeping_bodies(self) -> Iterator[None]:
        """Context without sleeping bodies, and without the stabilisation of free bodies. Local."""
        bulk, none = self._bulk, np.empty(0, dtype=np.int32)
        left_out, stabilisation = bulk.leave_out(none, none), bulk.stabilisation
        bulk.stabilisation = None
        try:
            yield
        finally:
            bulk.stabilisation = stabilisation
            bulk.leave_out(*left_out)

    def take(self, step: StepRecord) -> RateUpdate:
        """Set all functions and data to a solved step; return its update of rates."""
        rates = self._rates
        for support in self.of_supports:
            support.take(step.t_n, step.dt)
        rates.u_n.x.array[:], rates.u.x.array[:] = step.start.u, step.end.u
        for function, values in zip(self.carried, step.start.rates, strict=True):
            function.x.array[:] = values
        # The displacement is set first, since loads may depend on it.
        self._equations.set_data(step.t_n, step.dt)
        return rate_update(rates)

    def take_end(self, step: StepRecord) -> None:
        """Set displacement and rates to the end of a step."""
        self._rates.u.x.array[:] = step.end.u
        for function, values in zip(self.carried, step.end.rates, strict=True):
            function.x.array[:] = values

    def zeros(self) -> MotionState:
        """State of zeros, nodal arrays ``(n, d)``. Local."""
        rates = [np.zeros(self._shape) for _ in self.carried]
        histories: Histories = {}
        for each in self._equations.contacts:
            histories[each] = np.zeros((len(each.nodes.nodes), WIDTH))
        return MotionState(np.zeros(self._shape), rates, histories)

    def tangent(
        self,
        step: StepRecord,
        start: MotionState,
        changes: Sequence[Floats],
        weights: ForceWeights | None = None,
    ) -> tuple[MotionState, float]:
        """Perturbation of the state at the end of a step, to first order (tangent-linear step).

        Args:
            step: The step.
            start: Perturbation of the state at its start, nodal arrays ``(n, d)``.
            changes: Perturbations of the parameters, see `ParameterControl`.
            weights: Derivatives of the objective with respect to forces of the step; None if 0.

        Returns:
            The perturbation of the state at its end, and that of the objective through the forces,
            the same on all ranks.
        """
        update = self.take(step)
        force = self._derivatives.along_start([start.u, *start.rates])
        for (forms, _), change in zip(self.of_controls, changes, strict=True):
            force += np.reshape(forms.along(change), force.shape) if forms.exists else 0.0
        given, acts = self._given(changes)
        if acts:
            force += self._bulk.action(given, with_prescribed=True)
        histories = dict(start.histories)
        known = zip(self._controls, changes, self.of_friction, strict=True)
        coefficients = [(control, change) for control, change, is_one in known if is_one]
        trial, points = (self._trial(start, rate) + given for rate in (0, -1))
        motion = ContactMotion(start.u, trial, points, given, coefficients)
        of_forces = 0.0 if weights is None else np.vdot(weights.bulk, force)
        for contact in step.contacts:
            by_start = contact.force_by(motion, histories)
            of_forces += 0.0 if weights is None else np.vdot(weights.contact, by_start)
            force += by_start
            force += contact.end_product(given) if acts else 0.0
        scale = self._largest([self._derivatives.free(force)]) if step.differences else 0.0
        u, motion = self._solution(step, force, motion, histories, scale)
        if weights is not None:
            of_forces += np.vdot(self._force_slope(step, weights), u)
        for contact in step.contacts:
            contact.update(motion._replace(end=u), histories)
        rows = zip(update.of_end, update.of_start, [*update.of_rates], strict=True)
        rates = [
            end * u + begin * start.u + _combined(row, start.rates) for end, begin, row in rows
        ]
        if step.differences:
            motion = motion._replace(end=u)
            h, ahead, behind = self._differences(step, motion, histories, scale)
            if weights is not None:
                of_forces += np.vdot(weights.contact, _slope(ahead, behind, h))
            for each, a, b in zip(step.differences, ahead, behind, strict=True):
                of_history: Floats = np.subtract(a.history, b.history) / (2 * h)
                each.update(of_history, histories)
            if rates:
                rates[0] = rates[0] + self._impulses(step, u, rates[0], h, (ahead, behind))
        if weights is not None:
            of_forces = reductions.total(self._bulk.comm, float(of_forces))
        return MotionState(u, rates, histories), float(of_forces)

    def _force_slope(self, step: StepRecord, weights: ForceWeights) -> Floats:
        """Derivative of weighted forces with respect to the end of a step, ``(n, d)``.

        Contact without an adjoint is left out.
        """
        slope = self._derivatives.transposed(weights.bulk)
        for contact in step.contacts:
            slope = slope + contact.end_product(weights.contact, transposed=True)
        return slope

    def _solution(
        self,
        step: StepRecord,
        force: Floats,
        motion: ContactMotion,
        histories: Histories,
        scale: float,
    ) -> tuple[Floats, ContactMotion]:
        """Perturbation of the displacement at the end of a step, and the motion of its contact.

        Contact points chosen in equilibrium follow the end of the step, whose perturbation is
        iterated.

        Args:
            step: The step.
            force: Perturbation of the forces without differences of contact, ``(n, d)`` [N].
            motion: Perturbation of positions.
            histories: Perturbations of the histories at the start.
            scale: See `_differences`.

        Raises:
            ValueError: The points do not settle.
        """
        act, settling = partial(self._product, step), [c for c in step.differences if c.settles]
        change = np.inf
        for _ in range(_MOST_SOLUTIONS if settling else 1):
            of_points: Floats | float = 0.0
            if step.differences:
                h, ahead, behind = self._differences(step, motion, histories, scale)
                of_points = _slope(ahead, behind, h)
            u = self._solver.solve(act, -self._derivatives.free(force + of_points)) + motion.end
            if not settling:
                return u, motion
            last, size = change, self._largest([u])
            change = self._largest([u - motion.points])
            motion = motion._replace(trial=u, points=u)
            if change <= (_ROUNDED if change > last / 2 else _SETTLED) * size:
                return u, motion
        raise ValueError(
            "expected contact points that settle in equilibrium for a derivative, given "
            f"{settling[0].between} with a relative change of {change / size:.1e} after "
            f"{_MOST_SOLUTIONS} solutions: method 'node-to-segment' has an adjoint"
        )

    def _differences(
        self, step: StepRecord, motion: ContactMotion, histories: Histories, scale: float
    ) -> tuple[float, list[ContactResult], list[ContactResult]]:
        """Step h of central differences, and contact for perturbations times h and -h.

        ``scale`` is the largest derivative of the other forces [N].
        """
        size = min(contact.size for contact in step.differences)
        # Relative changes of coefficients count like displacements relative to segments.
        relative = [
            size * change / (np.abs(control.get()).max() or 1.0)
            for control, change in motion.coefficients
        ]
        lengths = (values[:, :3] for values in histories.values())
        largest = self._largest([*motion.positions, *lengths, *relative])
        for part in _STEPS:
            h = part * size / largest if largest > 0 else 1.0
            ahead, behind = (
                [contact.at(motion, s * h, histories) for contact in step.differences]
                for s in (1, -1)
            )
            changes = scale, self._largest([_slope(ahead, behind, h)])
            curvature = sum(
                contact.curvature(a.force, b.force)
                for contact, a, b in zip(step.differences, ahead, behind, strict=True)
            )
            if curvature <= _STRAIGHT * h * max(changes):
                break
        return h, ahead, behind

    def _largest(self, parts: Sequence[Floats]) -> float:
        """Largest absolute value of nodal arrays. Collective."""
        own = max(float(np.abs(part).max(initial=0.0)) for part in parts)
        return reductions.largest(self._bulk.comm, own)

    def _impulses(
        self,
        step: StepRecord,
        u: Floats,
        v: Floats,
        h: float,
        ends: Sequence[Sequence[ContactResult]],
    ) -> Floats:
        """Perturbation of the impulses of released springs, by perturbations of u and v."""
        released = self.released
        if released is None or not any(each.energy for end in ends for each in end):
            return np.zeros(self._shape)
        n, d = self._shape
        given, impulses = _impulse_speed(step, rate_update(self._rates), n * d), []
        for sign, end in zip((1, -1), ends, strict=True):
            there = step.end.u[: n * d].reshape(n, d) + sign * h * u
            force = np.sum([each.released for each in end], axis=0)
            energy = sum(each.energy for each in end)
            speed = given + sign * h * v.ravel()
            change = released.impulse(there, speed, force, energy) if energy else None
            impulses.append(np.zeros(n * d) if change is None else change)
        difference: Floats = np.subtract(*impulses) / (2 * h)
        return difference.reshape(n, d)

    def adjoint(
        self,
        step: StepRecord,
        end: MotionState,
        gradients: Sequence[Floats],
        weights: ForceWeights | None = None,
    ) -> MotionState:
        """Costate at the start of a step.

        Args:
            step: The step.
            end: Costate at its end: derivatives of the objective, nodal arrays ``(n, d)``.
            gradients: Gradients with respect to the parameters, changed in place.
            weights: Derivatives of the objective with respect to forces of the step; None if 0.

        Returns:
            The costate at its start.
        """
        update, derivatives = self.take(step), self._derivatives
        slope = end.u + _combined(update.of_end, end.rates)
        histories = dict(end.histories)
        for contact in step.contacts:
            slope = slope + contact.slope(self._shape, histories)
        if weights is not None:
            slope = slope + self._force_slope(step, weights)
        act = partial(self._product, step, transposed=True)
        costate = self._solver.solve(act, derivatives.free(slope))
        # Forces are parts of the residual: their weights are subtracted from its costate.
        of_bulk, of_contact = (
            costate - part for part in ((0.0, 0.0) if weights is None else weights)
        )
        of_start, *of_rates = derivatives.transposed_start(of_bulk)
        for (_, forms), gradient in zip(self.of_controls, gradients, strict=True):
            if forms.exists:
                gradient -= forms.gradient()
        acting = [pair for pair in zip(self.of_supports, gradients, strict=True) if pair[0].acts]
        of_given = slope - derivatives.transposed(costate) if acting else slope
        u = _combined(update.of_start, end.rates) - of_start
        columns: list[Floats] = [*update.of_rates.T]
        rates = [
            _combined(column, end.rates) - own
            for column, own in zip(columns, of_rates, strict=True)
        ]
        dt = float(self._rates.dt.value)
        for contact in step.contacts:
            motion = contact.adjoint(of_contact, histories)
            if acting:
                product = contact.end_product(costate, transposed=True)
                of_given = of_given + motion.trial - product
            trial = derivatives.free(motion.trial)
            u = u + motion.start + trial
            if rates:
                rates[0] = rates[0] + dt * trial
        of_given = of_given - derivatives.free(of_given)
        for support, gradient in acting:
            gradient += support.gradient(of_given.ravel())
        return MotionState(u, rates, histories)

    def _given(self, changes: Sequence[Floats]) -> tuple[Floats, bool]:
        """Change of prescribed displacements by changes of the parameters, ``(n, d)`` [m].

        Also returns whether any of them may differ from 0.
        """
        given, acts = np.zeros(self._shape), False
        for support, change in zip(self.of_supports, changes, strict=True):
            if support.acts:
                given += support.along(change).reshape(given.shape)
                acts = True
        return given, acts

    def _trial(self, start: MotionState, rate: int) -> Floats:
        """Change of the motion without contact, with one of the rates as velocity."""
        dt = float(self._rates.dt.value)
        moved: Floats = start.u + dt * start.rates[rate] if start.rates else start.u
        return self._derivatives.free(moved)

    def _product(self, step: StepRecord, x: Floats, *, transposed: bool = False) -> Floats:
        """Tangent times a vector, with unit rows and columns at prescribed displacements."""
        free = self._derivatives.free(x)
        product = self._derivatives.transposed(free) if transposed else self._bulk.action(free)
        for contact in step.contacts:
            product += contact.end_product(free, transposed=transposed)
        for each in step.differences:
            product += each.end_product(free)
        given = self._bulk.is_prescribed.reshape(product.shape)
        product[given] = x[given]
        return product


def _combined(weights: Sequence[Any] | Floats, values: Sequence[Floats]) -> Floats | float:
    """Linear combination of nodal arrays. Local."""
    return sum((w * v for w, v in zip(weights, values, strict=True)), 0.0)


def _slope(ahead: Sequence[ContactResult], behind: Sequence[ContactResult], h: float) -> Floats:
    """Central difference of the forces of all contact, ``(n, d)`` [N]. Local."""
    changes = (a.force - b.force for a, b in zip(ahead, behind, strict=True))
    slope: Floats = np.sum([*changes], axis=0) / (2 * h)
    return slope


def _impulse_speed(step: StepRecord, update: RateUpdate, size: int) -> Floats:
    """Velocity at the end of a step before impulses of springs, at the owned dofs. Local."""
    parts = zip(update.of_rates[0], step.start.rates, strict=True)
    speed = update.of_end[0] * step.end.u + update.of_start[0] * step.start.u
    velocity: Floats = speed + sum(w * rate for w, rate in parts)
    return velocity[:size]
