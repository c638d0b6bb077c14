"""Derivatives of contact along one direction, by central differences of the contact alone.

In mortar contact the points and their weights depend on the start of the step and on the positions
at which points are chosen, through the parts of facets that face each other. All results of a step
of contact are differentiated: first the force, for a fixed end of the step, then the history. In
statics points are chosen in equilibrium, at the end of the step.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from dolfinx import la

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.implicit.accepted_contact import contact_history
from dolfinx_nts.contact.implicit.contact_step import ContactStep, contact_forces, start_from
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.implicit.normal.active_set import ROUNDING
from dolfinx_nts.contact.joint_state import members
from dolfinx_nts.fem.components import dimension, in_space, of_space
from dolfinx_nts.gradients.contact_derivative import (
    ContactMotion,
    Histories,
    of_members,
    store,
)
from dolfinx_nts.integrators.implicit.released_springs import ReleasedSprings
from dolfinx_nts.parallel import reductions

__all__ = ["ContactDifference", "ContactResult"]

# Error of repeated forces relative to the largest one [-] above which their points differ.
_SAME = 1e-6
# The same error [-] for points that statics chooses in equilibrium, at the end of a step.
_SETTLED = 1e-5
# Values of the history of a node on which the next step depends, and their positions in arrays.
_SCALARS = ("offset", "gap", "soft_depth", "part", "slip", "energy")
_VECTORS = ("traction", "normal")


class ContactResult(NamedTuple):
    """Contact of a step: force [N], values of the history, and released springs."""

    force: Floats
    history: Floats
    released: Floats
    energy: float


class ContactDifference:
    """Derivatives of one attempt at a step, see `ContactDerivative`. Collective.

    Args:
        step: The accepted attempt, before its pairs accept their histories.
        last: Its last evaluation.
        x: Positions of the local nodes at the end of the step, shape ``(l, 3)`` [m].
        released: Collects springs that lose energy; it must be empty.

    Attributes:
        size: Diameter of the longest segment [m].
        between: Names of the surfaces.
        settles: Whether contact points are those of the end of the step, as in statics. The trial
            motion then has the changes of the end.

    Raises:
        ValueError: The step has chosen its contact points again on the way.
    """

    def __init__(
        self,
        step: ContactStep,
        last: ContactContribution,
        x: Floats,
        released: ReleasedSprings | None,
    ) -> None:
        self._step, self._last, self._released = step, last, released
        self._members, self._history = members(step.state), step.state.history
        self._scatter = step.candidates.scatter
        self.size: float = max(member.pair.segment_size for member in self._members)
        self.between = step.state.pair.between
        n, d = step.state.nodes.V.dofmap.index_map.size_local, dimension(step.state.nodes.V)
        self._force = contact_forces([step], [last], (n, d))
        (x_n, x_trial, x_points), chosen_at = step.begins_from, step.search.chosen_at
        self.settles = chosen_at is not None
        if chosen_at is not None:
            x_trial = self._spread(step.state.search.frame.in_space(chosen_at)[:n, :d])
            x_points = x_trial
        self._ends = x_n, x_trial, x_points, x
        self._check(x_trial, x_points, _SAME)
        if self.settles:
            self._check(x, x, _SETTLED)

    def end_product(self, x: Floats) -> Floats:
        """Derivative of the force with respect to the end of the step, times a vector."""
        last, pairs = self._last, self._last.pairs
        at, total = self._scatter.forward(in_space(x)), np.zeros((len(x), 3))
        nodes = pairs.blocks.nodes
        product = np.einsum("pij,pj->pi", last.tangent, at[nodes].reshape(last.tangent.shape[:2]))
        self._scatter.add(total, nodes, product.reshape(*nodes.shape, 3))
        at_pairs = at[pairs.dofs].reshape(last.force.shape)
        change = np.einsum("mcd,md->mc", pairs.gradients, at_pairs)
        multipliers = np.einsum("mij,mj->mi", last.slopes, change)
        force = np.einsum("mcd,mc->md", last.columns, multipliers)
        self._scatter.add(total, pairs.dofs, force.reshape(*pairs.dofs.shape, 3))
        return of_space(total, x.shape[1])

    def at(self, motion: ContactMotion, h: float, histories: Histories) -> ContactResult:
        """Contact of a step, with positions and histories perturbed by h times given ones.

        Args:
            motion: Changes of positions and coefficients of friction.
            h: Factor of all changes [-].
            histories: Changes of the histories at the start of the step.
        """
        state, (n, d) = self._step.state, motion.start.shape
        x_n, x_trial, x_points, x = (
            there + h * self._spread(change)
            for there, change in zip(self._ends, motion.positions, strict=True)
        )
        coefficients = [(control, control.get()) for control, _ in motion.coefficients]
        for (control, values), (_, part) in zip(coefficients, motion.coefficients, strict=True):
            control.set(values + h * part)
        change = h * of_members(self._members, histories)
        accepted = [member.accepted for member in self._members]
        state.accept(_changed(self._history, change))
        try:
            step, last = self._repeat(x_n, x_trial, x_points, x)
            force = contact_forces([step], [last], (n, d))
            released: Floats = np.zeros((n, 3))
            energy = 0.0
            if self._released is not None:
                self._released.collect(step, last)
                released, energy = self._released.force_and_energy()
            history = _values(contact_history(step, last))
        finally:
            for member, before in zip(self._members, accepted, strict=True):
                member.accept(before)
            for control, values in coefficients:
                control.set(values)
        return ContactResult(force, history, released, energy)

    def curvature(self, ahead: Floats, behind: Floats) -> float:
        """Largest distance of the force of the step from the mean of two forces, ``(n, d)`` [N].

        The two forces belong to perturbations of opposite signs.
        """
        error = float(np.abs((ahead + behind) / 2 - self._force).max(initial=0.0))
        return reductions.largest(self._scatter.index_map.comm, error)

    def _check(self, x_trial: Floats, x_points: Floats, tolerance: float) -> None:
        """Check that the contact of the step can be repeated.

        Args:
            x_trial: Trial positions, shape ``(l, 3)`` [m].
            x_points: Positions at which the points are chosen, shape ``(l, 3)`` [m].
            tolerance: Admissible error relative to the largest force [-].

        Raises:
            ValueError: The step has chosen its contact points again on the way.
        """
        step, last = self._repeat(self._ends[0], x_trial, x_points, self._ends[3])
        n, d = self._force.shape
        force = contact_forces([step], [last], (n, d))
        # Springs that touch by round-off of positions may push in any direction.
        eps_N = self._step.state.eps_N
        assert eps_N is not None
        parts = force - self._force, self._force, ROUNDING * self.size * eps_N
        own = np.array([float(np.abs(part).max(initial=0.0)) for part in parts])
        error, size, rounding = reductions.largest(self._scatter.index_map.comm, own)
        if error > tolerance * size + rounding:
            raise ValueError(
                "expected steps whose contact points are chosen once for a derivative, given one "
                f"of {self.between} in which points slid off their segments or vertices touched: "
                "shorter steps help"
                if not self.settles
                else "expected contact points that settle in equilibrium for a derivative, given "
                f"{self.between} in a step whose result depends on its iterations: method "
                "'node-to-segment' has no such points; shorter steps or finer facets may help, too"
            )

    def _repeat(
        self, x_n: Floats, x_trial: Floats, x_points: Floats, x: Floats
    ) -> tuple[ContactStep, ContactContribution]:
        """Contact for other positions, ``(l, 3)`` [m], with the same sliding nodes."""
        step = self._step.repeat(x_n=x_n, x_trial=x_trial, x_points=x_points)
        start_from([step], [self._step])
        step.friction.keeps_states = True
        return step, step.evaluate(x[: len(self._force)], None, 1)

    def update(self, change: Floats, histories: Histories) -> None:
        """Replace the perturbations of the histories at the start by those at the end. Local."""
        store(self._members, change, histories)

    def _spread(self, change: Floats) -> Floats:
        """Change of all local nodes, ``(l, 3)``, from the change of the owned nodes, ``(n, d)``."""
        n, d = change.shape
        vector = la.vector(self._step.state.nodes.V.dofmap.index_map, d)
        vector.array[: n * d] = change.ravel()
        vector.scatter_forward()
        return in_space(vector.array.reshape(-1, d))


def _values(history: ContactHistory) -> Floats:
    """Values of a history, ``(n, WIDTH)``, with 0 in place of infinity and NaN. Local."""
    columns = [getattr(history, name)[:, None] for name in _SCALARS]
    columns += [getattr(history, name) for name in _VECTORS]
    return np.nan_to_num(np.hstack(columns), posinf=0.0, neginf=0.0)


def _changed(history: ContactHistory, change: Floats) -> ContactHistory:
    """History with perturbations, shape ``(n, WIDTH)``, and the same loaded springs. Local."""
    parts = {name: change[:, i] for i, name in enumerate(_SCALARS)}
    for i, name in enumerate(_VECTORS):
        first = len(_SCALARS) + 3 * i
        parts[name] = change[:, first : first + 3]
    new = {name: getattr(history, name) + part for name, part in parts.items()}
    # A perturbed gap must not load or unload a spring: loaded springs keep their soft depth.
    loaded, offset = history.gap < history.offset, new["offset"]
    limit = np.where(loaded, np.nextafter(offset, -np.inf), offset)
    new["gap"] = np.where((new["gap"] < offset) == loaded, new["gap"], limit)
    return replace(history, **new)
