"""Decisions on active sets that are made pair by pair, also where pairs are evaluated together.

Nodes that change again and again in one pair must not hold up those of another.
"""

from collections.abc import Iterator
from itertools import pairwise

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.implicit.active_set import ActiveSet, BlockPivoting
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.joint_state import JointState, bounds, members
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.parallel import reductions

__all__ = ["PairwiseActiveSets", "PairwisePivoting"]


class _Parts:
    """Which nodes belong to which pair. Its methods are local.

    Args:
        state: State of the pairs.
        search: Segments of the nodes.

    Attributes:
        near: Pairs of which a node may touch in the step, on any rank.
        ends: Where the nodes of each pair begin, and the end.
    """

    def __init__(self, state: PairState | JointState, search: LocalSearch) -> None:
        """Find the pairs whose nodes face any segment. Collective."""
        self.near: list[int] = [0]
        self.ends = ends = bounds(state)
        if len(ends) > 2:
            found = np.cumsum([0, *(search.approach.segment >= 0)])
            comm: MPI.Comm = state.nodes.V.mesh.comm
            counts = reductions.total(comm, np.diff(found[ends]))
            self.near = list(map(int, np.flatnonzero(counts)))

    def of(self, node: Ints) -> Iterator[slice]:
        """Parts of ascending nodes, shape ``(m,)``, that belong to each of the near pairs."""
        ends = list(map(int, np.searchsorted(node, self.ends)))
        return (slice(ends[i], ends[i + 1]) for i in self.near)


class PairwisePivoting:
    """Block pivoting of each pair, see `BlockPivoting`. Collective.

    Args:
        state: State of the pairs.
        search: Segments of the nodes.
        waits: Whether nodes wait before they change back.
    """

    def __init__(self, state: PairState | JointState, search: LocalSearch, waits: bool) -> None:
        """Begin with any number of violators."""
        comm: MPI.Comm = state.nodes.V.mesh.comm
        self._parts, self._ids = _Parts(state, search), state.nodes.node_ids
        self._each = [BlockPivoting(comm, waits) for _ in self._parts.near]

    def select(self, violates: Flags, node: Ints, iteration: int) -> tuple[Flags, int]:
        """Choose the nodes that change their state, see `BlockPivoting.select`.

        ``node`` are positions among the nodes of all pairs, ascending, shape ``(m,)``.
        """
        flips, violators = np.zeros_like(violates), 0
        for pivoting, part in zip(self._each, self._parts.of(node), strict=True):
            ids = self._ids[node[part]]
            flips[part], count = pivoting.select(violates[part], ids, iteration)
            violators += count
        return flips, violators


class PairwiseActiveSets:
    """Active set of each pair, see `ActiveSet`. Collective.

    Args:
        state: State of the pairs.
        law: Enforcement of all of them.
        search: Segments of the nodes.
        stiffness: Stiffness of the nodes, shape ``(n,)`` [N/m].
    """

    def __init__(
        self,
        state: PairState | JointState,
        law: LagrangeMultiplier,
        search: LocalSearch,
        stiffness: Floats,
    ) -> None:
        """Begin without any decision."""
        self._parts, comm = _Parts(state, search), state.nodes.V.mesh.comm
        pairs = [each.pair for each in members(state)]
        parts = [stiffness[start:end] for start, end in pairwise(self._parts.ends)]
        self._each = [ActiveSet(pairs[i], law, parts[i], comm) for i in self._parts.near]

    def update(
        self, node: Ints, excess: Floats, before: Flags, lambda_N: Floats, iteration: int
    ) -> tuple[Flags, int]:
        """Decide which nodes are active, see `ActiveSet.update`.

        ``node`` are positions among the nodes of all pairs, ascending, shape ``(m,)``.
        """
        active, violators = before.copy(), 0
        parts = zip(self._parts.near, self._each, self._parts.of(node), strict=True)
        for i, each, part in parts:
            own = node[part] - self._parts.ends[i]
            values = excess[part], before[part], lambda_N[part]
            active[part], count = each.update(own, *values, iteration)
            violators += count
        return active, violators
