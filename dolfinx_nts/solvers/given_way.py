"""The given way in a solution without inertia: bodies go with what is led, part by part.

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

__all__ = ["GivenWay", "behind", "largest_strain"]

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


class GivenWay:
    """What is led has still to go in a solution. Collective, as all its methods.

    Args:
        bulk: Residual of the bodies; at the start of the way its ``u`` is that of the last state.
        steps: Contact attempts, whose obstacles go along.
        stiffness: That of the owned nodes, shape ``(n,)`` [N/m]; None: nothing is left of the way.
        size: Those of the cells at the owned nodes, shape ``(n,)`` [m]; needed with ``stiffness``.
        length: Largest way of what is led [m].

    Attributes:
        duration: Number of increments until the last one that took on what is led by a part of
            its way that counts.
    """

    def __init__(
        self,
        bulk: Bulk,
        steps: Sequence[ContactStep],
        stiffness: Floats | None = None,
        size: Floats | None = None,
        length: float = 0.0,
    ) -> None:
        """Lead obstacles to the beginning."""
        self._bulk, self._steps, self._stiffness, self._size = bulk, steps, stiffness, size
        self._length = length
        part = 1.0 if stiffness is None else 0.0
        self._part, self._next = part, part
        self._has_begun = False
        self.duration = self._increments = 0
        self._changes: list[Floats] = []
        self._place_obstacles()

    @property
    def is_over(self) -> bool:
        """Whether all is where it is led to. Local."""
        return self._part == 1.0

    @property
    def moves(self) -> bool:
        """Whether what is led goes a part of its way in this iteration. Local."""
        return self._next > self._part

    @property
    def length(self) -> float:
        """Largest way of what is led in this iteration [m]. Local."""
        return (self._next - self._part) * self._length

    def leave(self) -> None:
        """Let obstacles be at the ends of their ways. Local."""
        self._part = 1.0
        self._place_obstacles()

    def pull(
        self, R: Floats, states: Sequence[ContactContribution], target: float | None = None
    ) -> Floats:
        """Add the forces of the way that is gone in this iteration to a residual.

        Args:
            R: Residual on the owned dofs, of rigid bodies their balance, shape ``(d n,)`` [N].
            states: Pairs of the attempts.
            target: Norm of the residual of a solution [N], for which the way need not wait: where
                all of a body is led, it adds no forces. None: what was decided last stays.
        """
        if self.is_over:
            return R
        bulk = self._bulk
        way = self._ahead()
        forces = bulk.action(way, moves_given=True)
        self._changes, resisted = [], 0.0
        for step, state in zip(self._steps, states, strict=True):
            changes, change = changes_ahead(step, state.pairs, way)
            self._changes.append(changes)
            forces += change[:, : way.shape[1]]
            resisted += self._resisted(step, state, changes)
        forces.ravel()[bulk.given] = 0
        forces = bulk.rigid.project(None, forces).ravel()
        if target is not None:
            squares = np.array([R @ R, forces @ forces + resisted])
            squares = reductions.total(bulk.comm, squares)
            has_followed = squares[0] <= max(_FOLLOWED**2 * squares[1], target**2)
            is_rest = 1 - self._part <= _REST
            moves = not self._has_begun or has_followed or is_rest
            self._next, self._has_begun = 1.0 if moves else self._part, True
        return R + forces if self.moves else R

    def _resisted(self, step: ContactStep, state: ContactContribution, changes: Floats) -> float:
        """Square of the forces by which nodes resist changes of their constraints [N^2]. Local."""
        assert self._stiffness is not None
        stiffness = self._stiffness[step.state.nodes.nodes[state.pairs.node]]
        held = changes * (np.arange(3) < state.rank[:, None])
        return float(((stiffness[:, None] * held) ** 2).sum())

    def change(self, states: Sequence[ContactContribution]) -> tuple[ContactContribution, ...]:
        """Let constraints see gaps and slips at the end of the way of this iteration. Local.

        ``states`` are those of the last `pull`.
        """
        if not self.moves:
            return tuple(states)
        return tuple(
            state._replace(pairs=changed(state.pairs, changes))
            for state, changes in zip(states, self._changes, strict=True)
        )

    def follow(self, du: Floats) -> Floats:
        """Increment of all nodes, shape ``(d n,)`` [m], with that of supports in its place.

        It is so short that cells can follow, also where nodes meet others.
        """
        if not self.moves:
            return du
        if (left := behind(self._bulk)) is not None:
            du = du + left.ravel()
        strain = largest_strain(self._bulk, du)
        part = min(_LARGEST_STRAIN / max(strain, _LARGEST_STRAIN), self._until_met(du))
        if part == 1.0:
            return du
        self._next = self._part + part * (1 - self._part)
        return part * du

    def _until_met(self, du: Floats) -> float:
        """Part of an increment of all nodes after which others are met deep enough."""
        bulk = self._bulk
        assert self._size is not None
        nodes = bulk.u.x.array[: bulk.num_owned].reshape(-1, bulk.rigid.dim)
        way = du.reshape(nodes.shape) + bulk.rigid.ahead(nodes, self._part)
        parts = [until_met(step, way, self._size) for step in self._steps]
        return reductions.least(bulk.comm, min(parts, default=1.0))

    def go(self, nodes: Floats, du: Floats, part: float) -> Floats:
        """Displacements after a part of the increment that `follow` has returned.

        Args:
            nodes: Displacements of the owned nodes, shape ``(n, d)`` [m].
            du: That part of the increment, of the same shape [m].
            part: The part, from 0 to 1.
        """
        bulk, last = self._bulk, self._part
        self._increments += 1
        if not self.moves:
            return bulk.rigid.moved(nodes, du)
        self._part += part * (self._next - last) if part < 1 else self._next - last
        if 1 - self._part <= _ROUND_OFF:
            self._part = 1.0
        self._next = self._part
        if self._part - last > _ADVANCE * (1 - last):
            self.duration = self._increments
        self._place_obstacles()
        moved = bulk.rigid.moved(nodes, du, bulk.rigid.guides.led_between(last, self._part))
        if self.is_over:
            u = bulk.u.x.array.copy()
            u[: bulk.num_owned] = moved.ravel()
            moved = bulk.supports.applied(u)[: bulk.num_owned].reshape(moved.shape)
        return moved

    def _ahead(self) -> Floats:
        """Ways that are left to first order, at the owned nodes, shape ``(n, d)`` [m]."""
        bulk = self._bulk
        nodes = bulk.u.x.array[: bulk.num_owned].reshape(-1, bulk.rigid.dim)
        way = bulk.rigid.ahead(nodes, self._part)
        left = behind(bulk)
        return way if left is None else way + left

    def _place_obstacles(self) -> None:
        for step in self._steps:
            step.state.search.frame.go(self._part)


def behind(bulk: Bulk) -> Floats | None:
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
