"""Sleeping (inactive) bodies: bodies in equilibrium without loads or contact, which a step skips.

A body sleeps in a step if it does not move, is in equilibrium, carries no load, its supports do
not move, and no contact can reach it. Bodies that share nodes sleep only together.
"""

from collections.abc import Sequence
from itertools import chain

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.common.parts import counts_of_parts
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.joint_state import JointState, members
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.connected_bodies import connected
from dolfinx_nts.model.loads.load import Load
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.cell_sizes import CellSizes
from dolfinx_nts.solvers.precond.tangent import Tangent

__all__ = ["SleepingBodies"]

# Largest distance of a sleeping body from its equilibrium relative to the smallest cell [-]: some
# fifty times the machine epsilon.
_ROUNDING = 1e-14

# Groups of bodies that share nodes.
_Group = tuple[Body, ...]


class SleepingBodies:
    """Detection of the sleeping bodies of each step, which the forms leave out.

    Collective, as are all its methods.

    Args:
        bulk: Residual of the bodies.
        tangent: Tangent matrix.
        sizes: Sizes of the cells.
        bodies: The bodies.
        states: States of the contact pairs.
        loads: The loads.

    Attributes:
        states: The argument.
        bodies: Bodies that currently sleep.
    """

    def __init__(
        self,
        bulk: Bulk,
        tangent: Tangent,
        sizes: CellSizes,
        bodies: Sequence[Body],
        states: Sequence[PairState | JointState],
        loads: Sequence[Load],
    ) -> None:
        # Guides may move rigid bodies, and bodies with relaxing stresses are not in equilibrium.
        self._bulk = bulk
        self._groups = [
            tuple(group)
            for group in connected(bodies)
            if not any(body.is_rigid or body.material.remembers for body in group)
        ]
        self._tangent, self._sizes, self.states = tangent, sizes, tuple(states)
        num_owned = bulk.num_owned // bulk.rigid.dim
        self._nodes: dict[_Group, Ints] = {}
        for group in self._groups:
            nodes = np.unique(np.concatenate([body.nodes for body in group]))
            self._nodes[group] = nodes[nodes < num_owned]

        # Lists, because `acts_on` of some loads is collective.
        self._loaded = {
            group
            for group in self._groups
            if any([load.acts_on(body) for load in loads for body in group])
        }
        self._pairs = self._pairs_of_groups()
        # Groups that sleep by the last call of `find`, and the accepted displacement there.
        self._asleep: frozenset[_Group] = frozenset()
        self.bodies: frozenset[Body] = frozenset()
        self._u_n: Floats = np.zeros_like(bulk.u.x.array)

    def _pairs_of_groups(self) -> dict[_Group, list[PairState]]:
        """Pairs that can act on the bodies of each group."""
        comm = self._bulk.comm
        group_of = np.full(self._bulk.num_owned // self._bulk.rigid.dim, -1)
        for number, nodes in enumerate(self._nodes.values()):
            group_of[nodes] = number
        found = []
        all_pairs = list(chain(*map(members, self.states)))
        for i, pair in enumerate(all_pairs):
            sides = [side for side in (pair.nodes, pair.segments) if isinstance(side, Surface)]
            numbers = np.unique(np.concatenate([group_of[side.nodes] for side in sides]))
            found += [(int(number), i) for number in numbers if number >= 0]
        rows = np.array(found, dtype=np.int64).reshape(-1, 2)
        pairs: dict[_Group, list[PairState]] = {group: [] for group in self._groups}
        for number, pair_number in np.unique(joined(comm, rows), axis=0):
            pairs[self._groups[number]].append(all_pairs[pair_number])
        return pairs

    def find(self, v: Floats, u_n: Floats, steps: Sequence[ContactStep]) -> None:
        """Find the bodies that sleep in a step, and exclude them from the forms.

        Args:
            v: Velocity of the local dofs, shape ``(d l,)`` [m/s].
            u_n: Accepted displacement, shape ``(d l,)`` [m]. The displacement of ``bulk`` is the
                starting guess of Newton's method, with the supports at the end of the step.
            steps: Contact in the step, without pairs that cannot touch.
        """
        comm, flags = self._bulk.comm, []
        v, start, accepted, before = (
            a.reshape(-1, self._bulk.rigid.dim) for a in (v, self._bulk.u.x.array, u_n, self._u_n)
        )
        may_touch = {pair for step in steps for pair in _may_touch(step)}
        for group in self._groups:
            nodes = self._nodes[group]
            # The nodes are checked last, since this takes longest.
            still = group not in self._loaded and may_touch.isdisjoint(self._pairs[group])
            still = still and not np.any(v[nodes])
            still = still and np.array_equal(start[nodes], accepted[nodes])
            # The displacement may have been set since the equilibrium was checked.
            known = still and group in self._asleep
            known = known and np.array_equal(accepted[nodes], before[nodes])
            flags.append((still, known))
        counts = reductions.total(comm, np.array(flags, dtype=np.int64)) == comm.size
        states = zip(self._groups, counts.tolist(), strict=True)
        candidates = {group: known for group, (still, known) in states if still}
        if new := [group for group, known in candidates.items() if not known]:
            self.wake()
            balanced = self._balanced(new, u_n)
            candidates = {g: known for g, known in candidates.items() if known or g in balanced}
        self._u_n[:] = u_n
        self._leave_out(frozenset(candidates))

    def must_wake(self, steps: Sequence[ContactStep]) -> bool:
        """Wake all bodies if contact has reached a sleeping one; return whether it has."""
        touched = {
            pair
            for step in steps
            for pair, flag in zip(members(step.state), step.touched, strict=True)
            if flag
        }
        reached = any(not touched.isdisjoint(self._pairs[group]) for group in self._asleep)
        if reached:
            self.wake()
        return reached

    def _balanced(self, groups: Sequence[_Group], u_n: Floats) -> set[_Group]:
        """Groups of bodies that are in equilibrium at u_n."""
        bulk = self._bulk
        u = bulk.u.x.array
        before = u.copy()
        u[:] = u_n
        # Reactions at prescribed displacements are included, so that bodies with reactions stay
        # active.
        R = np.abs(bulk.forces().reshape(-1, bulk.rigid.dim))
        u[:] = before
        limit = _ROUNDING * self._sizes.smallest * self._tangent.nodal_stiffness()[:, None]
        bad = [np.count_nonzero(~(R <= limit)[self._nodes[group]]) for group in groups]
        counts = reductions.total(bulk.comm, bad)
        return {group for group, n in zip(groups, counts, strict=True) if not n}

    def wake(self) -> None:
        """Include all bodies in the forms, until the next call of `find`. Local."""
        self._leave_out(frozenset())

    def _leave_out(self, groups: frozenset[_Group]) -> None:
        if groups == self._asleep:
            return
        self._asleep, self.bodies = groups, frozenset(chain(*groups))
        none = np.empty(0, dtype=np.int32)
        cells = np.concatenate([none, *(body.cells for body in self.bodies)])
        nodes = np.concatenate([none, *(self._nodes[group] for group in groups)])
        self._bulk.leave_out(cells, nodes)


def _may_touch(step: ContactStep) -> list[PairState]:
    """Pairs with nodes of this rank that may touch. Local."""
    if not step.may_touch:
        return []
    counts = counts_of_parts(step.normal.may_touch, step.state.ends)
    return [pair for pair, count in zip(members(step.state), counts, strict=True) if count]
