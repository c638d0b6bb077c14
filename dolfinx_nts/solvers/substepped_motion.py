"""Prescribed motion in statics, applied in substeps together with the motion of the bodies.

If supports, guides and obstacles moved in one increment, with all other nodes fixed, cells at
supports would be inverted. Sticking nodes would be far from a moving tool. Newton's method then
fails for nearly incompressible materials, and contact forces do not predict the active set. Here
the remaining prescribed increment is a known part of the linear systems: the tangents of bodies and
contacts transmit it to the other nodes, with closed gaps and sticking nodes kept. If it would
strain cells too much, only a fraction of it is applied; the next fraction follows near equilibrium.
The same holds if open nodes would penetrate deeply, since the linear systems do not contain their
contact.
"""

from collections.abc import Sequence

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution, changed
from dolfinx_nts.contact.implicit.first_contact import fraction_until_contact
from dolfinx_nts.contact.implicit.prescribed_changes import prescribed_changes
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.prescribed_motion import PrescribedMotion

__all__ = ["SubsteppedMotion", "boundary_increment", "largest_strain"]

# Largest change of displacements within a cell in a prescribed increment, relative to the size of
# the cell [-].
_LARGEST_STRAIN = 0.05
# Residual, relative to the forces of the remaining increment [-], below which the next substep
# begins.
_FOLLOWED = 1e-3
# Remaining fraction of the motion that is applied in one increment, as its forces are round-off;
# and fraction that counts as zero [-].
_REST, _ROUND_OFF = 1e-6, 1e-12
# Fraction of the remaining motion [-] above which an increment counts in `duration`. Smaller
# increments, due to contact, may be numerous.
_ADVANCE = 1e-2


class SubsteppedMotion(PrescribedMotion):
    """Prescribed motion in substeps, from the last state of the bodies.

    Args:
        bulk: Residual of the bodies, with ``u`` of the last state.
        steps: Contact attempts, whose obstacles move.
        stiffness: Stiffness of the owned nodes, shape ``(n,)`` [N/m].
        size: Size of the cells at the owned nodes, shape ``(n,)`` [m].
        length: Largest prescribed displacement [m].
    """

    def __init__(
        self,
        bulk: Bulk,
        steps: Sequence[ContactStep],
        stiffness: Floats,
        size: Floats,
        length: float,
    ) -> None:
        super().__init__(bulk, steps)
        self._stiffness, self._size, self._length = stiffness, size, length
        self._fraction = self._next_fraction = 0.0
        self._has_begun, self._increments = False, 0
        self._changes: list[Floats] = []
        self._place_obstacles(0.0)

    @property
    def is_complete(self) -> bool:
        return self._fraction == 1.0

    @property
    def advances(self) -> bool:
        return self._next_fraction > self._fraction

    @property
    def length(self) -> float:
        return (self._next_fraction - self._fraction) * self._length

    def finish(self) -> None:
        super().finish()
        self._fraction = 1.0

    def add_forces(
        self, R: Floats, states: Sequence[ContactContribution], target: float | None = None
    ) -> Floats:
        if self.is_complete:
            return R
        bulk = self._bulk
        increment = self._remaining()
        forces = bulk.action(increment, with_prescribed=True)
        self._changes, resisted = [], 0.0
        for step, state in zip(self._steps, states, strict=True):
            changes, change = prescribed_changes(step, state.pairs, increment)
            self._changes.append(changes)
            forces += change[:, : increment.shape[1]]
            resisted += self._squared_resistance(step, state, changes)
        forces.ravel()[bulk.is_prescribed] = 0
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
        """Sum of squared constraint forces due to changes of gap and slip [N^2]. Local."""
        stiffness = self._stiffness[step.state.nodes.nodes[state.pairs.node]]
        held = changes * (np.arange(3) < state.rank[:, None])
        return float(((stiffness[:, None] * held) ** 2).sum())

    def predict(self, states: Sequence[ContactContribution]) -> tuple[ContactContribution, ...]:
        if not self.advances:
            return super().predict(states)
        return tuple(
            state._replace(pairs=changed(state.pairs, changes))
            for state, changes in zip(states, self._changes, strict=True)
        )

    def limit(self, du: Floats) -> Floats:
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
        """Fraction of an increment until new contacts penetrate too deep. Collective."""
        bulk = self._bulk
        nodes = bulk.u.x.array[: bulk.num_owned].reshape(-1, bulk.rigid.dim)
        increment = du.reshape(nodes.shape) + bulk.rigid.remaining(nodes, self._fraction)
        parts = [fraction_until_contact(step, increment, self._size) for step in self._steps]
        return reductions.least(bulk.comm, min(parts, default=1.0))

    def advance(self, nodes: Floats, du: Floats, part: float) -> Floats:
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
        """Remaining prescribed displacements to first order, at the owned nodes, ``(n, d)`` [m]."""
        bulk = self._bulk
        nodes = bulk.u.x.array[: bulk.num_owned].reshape(-1, bulk.rigid.dim)
        increment = bulk.rigid.remaining(nodes, self._fraction)
        left = boundary_increment(bulk)
        return increment if left is None else increment + left


def boundary_increment(bulk: Bulk) -> Floats | None:
    """Difference between the Dirichlet values and u. Collective.

    Returns:
        Values at the owned nodes, shape ``(n, d)`` [m]; None if there is no difference.
    """
    if not bulk.supports.exist:
        return None
    u = bulk.u.x.array
    increment = (bulk.supports.applied(u) - u)[: bulk.num_owned]
    is_there = reductions.anywhere(bulk.comm, bool(increment.any()))
    return increment.reshape(-1, bulk.rigid.dim) if is_there else None


def largest_strain(bulk: Bulk, du: Floats) -> float:
    """Largest change of an increment, ``(d n,)`` [m], in a cell per cell size [-]. Collective."""
    V = bulk.u.function_space
    field = fem.Function(V)
    field.x.array[: bulk.num_owned] = bulk.rigid.without(du.reshape(-1, bulk.rigid.dim)).ravel()
    field.x.scatter_forward()
    values = field.x.array.reshape(-1, dimension(V))[V.dofmap.list]
    X = reference_positions(V)[V.dofmap.list]
    change, size = (np.ptp(of_cells, axis=1).max(axis=1) for of_cells in (values, X))
    return reductions.largest(bulk.comm, float((change / size).max(initial=0.0)))
