"""Which nodes are in contact: the active set of multipliers, and block pivoting.

Contact or none, and stick or slip, are decided node by node, but each decision changes what all
other nodes see.
"""

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Array, Flags, Floats, GlobalInts, Ints
from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.parallel import reductions

__all__ = ["ROUNDING", "ActiveSet", "BlockPivoting"]

# Force, or gap times the stiffness k of its node, that counts as none, relative to k h, where
# h is the size of a segment [-]: it is the round-off of the residual.
ROUNDING = 16 * np.finfo(np.float64).eps
# Number of iterations without fewer violators, after which only one node changes at a time.
_PATIENCE = 3
# Number of iterations from one such change to the next, so that Newton's method comes near to
# equilibrium in between.
_PERIOD = 3
# Number of iterations without fewer violators, while one node at a time changes, after which the
# fewest are counted anew.
_RENEWAL = 4


class BlockPivoting:
    """Block pivoting within Newton's method, after Judice and Pires (1994).

    All violators change while they become fewer. Murty's rule, by which only the lowest
    changes, ends cycles. It is made for linear problems: between its changes an iteration
    without any brings the iterate near to equilibrium, where decisions can be trusted. How few
    there have been is forgotten from time to time, and not counted in the guess from which a
    step begins: few violate while nodes hardly move, which says nothing of later, and one
    change at a time would use up the iterations of a step where contact or slip spreads along
    a surface, as on a belt.

    Several contact pairs are decided on at once, but each by itself: nodes of one that change
    again and again must not hold up those of another.

    Args:
        comm: Communicator.
        ids: Numbers of the nodes on any partition, pair by pair, shape ``(n,)``.
        ends: Where the nodes of each of ``c`` pairs begin, and the end, shape ``(c + 1,)``.
        waits: Most violators of a pair of which a node that has changed in the last iteration
            keeps its state where they have not become fewer. It was judged with the old states
            of those that changed with it, and would change to and fro with them, as do stick and
            slip; or, alone, before Newton's method came near to the equilibrium of its state.
        is_patient: Whether nodes change only in iterations before which Newton's method came near
            to equilibrium, also those that change together.

    Attributes:
        num_violators: Those of all ranks when they were last counted.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        ids: GlobalInts,
        ends: Array,
        waits: float = 0,
        is_patient: bool = False,
    ) -> None:
        self._comm, self._ids, self._ends, self._waits = comm, ids, ends, waits
        self._is_patient = is_patient
        num_pairs = len(ends) - 1
        self._fewest, self._last = np.full((2, num_pairs), np.inf)
        self._patience = np.full(num_pairs, _PATIENCE)
        self._changed: Flags = np.zeros(len(ids), dtype=bool)
        self._is_quiet = False  # none violated at last, fewer cannot be
        self.num_violators = 0

    def select(self, violates: Flags, node: Ints, iteration: int) -> tuple[Flags, int]:
        """Choose the nodes that change their state, shape ``(m,)``. Collective.

        ``violates`` tells whose state contradicts its condition, ``node`` are positions among
        all nodes, ascending, both of shape ``(m,)``. Returns flags, and the violators on this
        rank.
        """
        if self._is_patient and iteration % _PERIOD:
            return np.zeros(len(node), dtype=bool), int(np.count_nonzero(violates))
        own = _kernels.counts_of_parts(violates, node, self._ends)
        count = reductions.total(self._comm, own)
        self.num_violators = int(count.sum())
        if self._is_quiet and not self.num_violators:
            return violates, 0
        fewer = count < self._fewest
        self._patience[fewer] = _PATIENCE
        if iteration:
            self._fewest = np.minimum(self._fewest, count)
        changes = violates
        if self.num_violators:
            stays = count >= self._last
            is_stuck = stays & ~fewer & (count > 0)
            self._patience[is_stuck] -= 1
            anew = is_stuck & (self._patience < 0) & (-self._patience % _RENEWAL == 1)
            self._fewest[anew] = count[anew]
            single = (count > 0) & (self._patience < 0)
            waiting = stays & ~single & (count <= self._waits)
            if (single | waiting).any():
                pair = np.searchsorted(self._ends, node, side="right") - 1
                changes = violates & ~(waiting[pair] & self._changed[node])
                is_next = self._lowest(violates, node, pair) & (iteration % _PERIOD == 0)
                changes &= is_next | ~single[pair]
        self._changed[:] = False
        self._changed[node[changes]] = True
        self._last = count
        self._is_quiet = not (self.num_violators or self._fewest.any())
        return changes, int(own.sum())

    def changes_singly(self, node: Ints) -> Flags | None:
        """Whether nodes are of pairs in which one changes at a time, shape ``(m,)``. Local.

        As the last call of `select` left it, with violators. None if there is no such pair.
        """
        if self._is_quiet:
            return None
        single = (self._patience < 0) & (self._last > 0)
        if not single.any():
            return None
        flags: Flags = np.repeat(single, np.diff(self._ends))[node]
        return flags

    def _lowest(self, violates: Flags, node: Ints, pair: Array) -> Flags:
        """Whether nodes have the lowest number of the violators of their pair, ``(m,)``."""
        ids = self._ids[node]
        lowest = np.full(len(self._last), np.iinfo(np.int64).max)
        np.minimum.at(lowest, pair[violates], ids[violates])
        flags: Flags = ids == reductions.least(self._comm, lowest)[pair]
        return flags


class ActiveSet:
    """Decides node by node between contact and none.

    Args:
        state: State of the contact pair, or of several.
        law: Their enforcement.
        stiffness: Stiffness of the nodes, shape ``(n,)`` [N/m].
        is_static: Whether there is no inertia. What a node moves then may be far softer than the
            node, as a belt is across its length, so that gaps that are left where surfaces curve
            say nothing of held nodes: their forces alone decide.
    """

    def __init__(
        self,
        state: PairState | JointState,
        law: LagrangeMultiplier,
        stiffness: Floats,
        is_static: bool = False,
    ) -> None:
        self._law, self._stiffness, self._is_static = law, stiffness, is_static
        nodes = state.nodes
        self._size = state.segment_sizes
        self._pivoting = BlockPivoting(nodes.V.mesh.comm, nodes.node_ids, state.ends, waits=1)

    @property
    def num_violators(self) -> int:
        """Nodes of all ranks that contradicted their state in the last update. Local."""
        return self._pivoting.num_violators

    def update(
        self, node: Ints, excess: Floats, before: Flags, lambda_N: Floats, iteration: int
    ) -> tuple[Flags, int]:
        """Decide which nodes are active. Collective.

        Args:
            node: Positions among the nodes, ascending, shape ``(m,)``.
            excess: Gaps less those that multipliers hold, shape ``(m,)`` [m].
            before: Whether the nodes were active, shape ``(m,)``.
            lambda_N: Their multipliers, shape ``(m,)`` [N].
            iteration: Number of the Newton iteration of the step, from 0.

        Returns:
            Whether they are active now, and how many of this rank contradict their state.
        """
        if iteration == 0:
            wrong = (excess < 0) & ~before
        else:
            stiffness = self._stiffness[node]
            gap = np.where(before, 0.0, excess) if self._is_static else excess
            wrong = self._law.active(lambda_N, gap, stiffness) != before
            if wrong.any():
                # Vertices of triangles of degree 2 carry nothing under a uniform pressure:
                # round-off must not decide on them again and again.
                force = np.maximum(np.abs(lambda_N), stiffness * np.abs(excess))
                wrong &= ~(force <= ROUNDING * stiffness * self._size[node])
        changes, violators = self._pivoting.select(wrong, node, iteration)
        return before ^ changes if violators else before, violators
