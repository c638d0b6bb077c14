"""The given way in statics: bodies go with what is led, part by part.

Supports, guides of rigid bodies and obstacles are led. Where they are at the ends of their ways at
once, with all other nodes as before, cells at supports are crushed or torn, and nodes that stick to
a tool are far behind it: near incompressibility Newton's method does not find its way back, and
forces from which nodes would be told to slide or to part mean nothing. Here the part that is yet
to come belongs to the linear systems, as a known part of the increment, so that it carries the
bodies along: by the tangent of the cells and, at what touches, by that of contact, of which gaps
that are closed stay so and what sticks goes along. Where this would strain cells by too much, all
that is led goes a part of its way, and waits until the bodies are near equilibrium.
So it does where nodes that touch nothing as yet would come deep into what they meet, of which the
linear systems do not know.
"""

from collections.abc import Sequence

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.changes_ahead import changes_ahead
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution, changed
from dolfinx_nts.contact.implicit.meeting import until_met
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.prescribed_motion import PrescribedMotion

__all__ = ["SubsteppedMotion", "boundary_increment", "largest_strain"]

# Largest change of displacements within a cell in an increment with a given way, relative to
# the size of the cell [-].
_LARGEST_STRAIN = 0.05
# Residual, relative to what the way that is left would add to it [-], at which it goes on.
_FOLLOWED = 1e-4
# Parts of the way [-]: a rest for which nothing waits, as the forces that it would add are lost in
# the round-off of the residual; and one that is none.
_REST, _ROUND_OFF = 1e-6, 1e-12
# Part of what is left of the way that an increment takes on for it to count [-]: most of the way
# may lead to where bodies meet.
_ADVANCE = 1e-2


class SubsteppedMotion(PrescribedMotion):
    """What is led goes part by part, see `PrescribedMotion`, from where the bodies are.

    Args:
        bulk: Residual of the bodies, whose ``u`` is that of the last state.
        steps: Contact attempts, whose obstacles go along.
        stiffness: That of the owned nodes, shape ``(n,)`` [N/m].
        size: Those of the cells at the owned nodes, shape ``(n,)`` [m].
        length: Largest way of what is led [m].
    """

    def __init__(
        self,
        bulk: Bulk,
        steps: Sequence[ContactStep],
        stiffness: Floats,
        size: Floats,
        length: float,
    ) -> None:
        """Lead obstacles to the beginning."""
        super().__init__(bulk, steps)
        self._stiffness, self._size, self._length = stiffness, size, length
        self._fraction = self._next_fraction = 0.0
        self._has_begun, self._increments = False, 0
        self._changes: list[Floats] = []
        self._place_obstacles(0.0)

    @property
    def is_complete(self) -> bool:
        """Whether all has gone its way."""
        return self._fraction == 1.0

    @property
    def advances(self) -> bool:
        """Whether bodies have followed what is led, so that it goes on."""
        return self._next_fraction > self._fraction

    @property
    def length(self) -> float:
        """Part of the largest way that follows in this iteration [m]."""
        return (self._next_fraction - self._fraction) * self._length

    def finish(self) -> None:
        """Let all be at the ends of their ways."""
        super().finish()
        self._fraction = 1.0

    def add_forces(
        self, R: Floats, states: Sequence[ContactContribution], target: float | None = None
    ) -> Floats:
        """Add the forces of the prescribed increment, see `PrescribedMotion`."""
        if self.is_complete:
            return R
        bulk = self._bulk
        way = self._remaining()
        forces = bulk.action(way, includes_given=True)
        self._changes, resisted = [], 0.0
        for step, state in zip(self._steps, states, strict=True):
            changes, change = changes_ahead(step, state.pairs, way)
            self._changes.append(changes)
            forces += change[:, : way.shape[1]]
            resisted += self._squared_resistance(step, state, changes)
        forces.ravel()[bulk.given] = 0
        forces = bulk.rigid.project(None, forces).ravel()
        if target is not None:
            squares = np.array([R @ R, forces @ forces + resisted])
            squares = reductions.total(bulk.comm, squares)
            has_followed = squares[0] <= max(_FOLLOWED**2 * squares[1], target**2)
            is_rest = 1 - self._fraction <= _REST
            moves = not self._has_begun or has_followed or is_rest
            self._next_fraction, self._has_begun = 1.0 if moves else self._fraction, True
        return R + forces if self.advances else R

    def _squared_resistance(
        self, step: ContactStep, state: ContactContribution, changes: Floats
    ) -> float:
        """Square of the forces by which nodes resist changes of their constraints [N^2]. Local."""
        stiffness = self._stiffness[step.state.nodes.nodes[state.pairs.node]]
        held = changes * (np.arange(3) < state.rank[:, None])
        return float(((stiffness[:, None] * held) ** 2).sum())

    def predict(self, states: Sequence[ContactContribution]) -> tuple[ContactContribution, ...]:
        """Let constraints see the changes of the last `add_forces`, see `PrescribedMotion`."""
        if not self.advances:
            return super().predict(states)
        return tuple(
            state._replace(pairs=changed(state.pairs, changes))
            for state, changes in zip(states, self._changes, strict=True)
        )

    def limit(self, du: Floats) -> Floats:
        """Let supports go along, as far as cells can follow, see `PrescribedMotion`."""
        if not self.advances:
            return super().limit(du)
        if (left := boundary_increment(self._bulk)) is not None:
            du = du + left.ravel()
        strain = largest_strain(self._bulk, du)
        part = min(_LARGEST_STRAIN / max(strain, _LARGEST_STRAIN), self._fraction_until_contact(du))
        if part == 1.0:
            return du
        self._next_fraction = self._fraction + part * (1 - self._fraction)
        return part * du

    def _fraction_until_contact(self, du: Floats) -> float:
        """Part of an increment of all nodes after which others are met deep enough."""
        bulk = self._bulk
        nodes = bulk.u.x.array[: bulk.num_owned].reshape(-1, bulk.rigid.dim)
        way = du.reshape(nodes.shape) + bulk.rigid.remaining(nodes, self._fraction)
        parts = [until_met(step, way, self._size) for step in self._steps]
        return reductions.least(bulk.comm, min(parts, default=1.0))

    def advance(self, nodes: Floats, du: Floats, part: float) -> Floats:
        """Go the same part of the way with all that is led, see `PrescribedMotion`."""
        bulk, last = self._bulk, self._fraction
        self._increments += 1
        if not self.advances:
            return super().advance(nodes, du, part)
        self._fraction += (
            part * (self._next_fraction - last) if part < 1 else self._next_fraction - last
        )
        if 1 - self._fraction <= _ROUND_OFF:
            self._fraction = 1.0
        self._next_fraction = self._fraction
        if self._fraction - last > _ADVANCE * (1 - last):
            self.duration = self._increments
        self._place_obstacles(self._fraction)
        moved = bulk.rigid.moved(nodes, du, bulk.rigid.guides.motion_between(last, self._fraction))
        if self.is_complete:
            u = bulk.u.x.array.copy()
            u[: bulk.num_owned] = moved.ravel()
            moved = bulk.supports.applied(u)[: bulk.num_owned].reshape(moved.shape)
        return moved

    def _remaining(self) -> Floats:
        """Ways that are left to first order, at the owned nodes, shape ``(n, d)`` [m]."""
        bulk = self._bulk
        nodes = bulk.u.x.array[: bulk.num_owned].reshape(-1, bulk.rigid.dim)
        way = bulk.rigid.remaining(nodes, self._fraction)
        left = boundary_increment(bulk)
        return way if left is None else way + left


def boundary_increment(bulk: Bulk) -> Floats | None:
    """Displacements by which u is behind its conditions. Collective.

    Returns:
        Values at the owned nodes, shape ``(n, d)`` [m]; None where u is as given.
    """
    if not bulk.supports.exist:
        return None
    u = bulk.u.x.array
    way = (bulk.supports.applied(u) - u)[: bulk.num_owned]
    is_there = reductions.anywhere(bulk.comm, bool(way.any()))
    return way.reshape(-1, bulk.rigid.dim) if is_there else None


def largest_strain(bulk: Bulk, du: Floats) -> float:
    """Largest change of an increment ``(d n,)`` [m] within a cell, by its size. Collective."""
    V = bulk.u.function_space
    field = fem.Function(V)
    field.x.array[: bulk.num_owned] = bulk.rigid.without(du.reshape(-1, bulk.rigid.dim)).ravel()
    field.x.scatter_forward()
    values = field.x.array.reshape(-1, dimension(V))[V.dofmap.list]
    X = V.tabulate_dof_coordinates()[V.dofmap.list]
    change, size = (np.ptp(of_cells, axis=1).max(axis=1) for of_cells in (values, X))
    return reductions.largest(bulk.comm, float((change / size).max(initial=0.0)))
