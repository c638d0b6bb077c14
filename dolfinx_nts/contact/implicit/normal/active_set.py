"""Active set of the normal contact constraints, and block pivoting."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Array, Flags, Floats, GlobalInts, Ints
from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.parallel import reductions

__all__ = ["ROUNDING", "ActiveSet", "BlockPivoting"]

# Round-off of a gap relative to the size h of a segment [-], and of a force relative to k h, with
# the stiffness k of the node.
ROUNDING = 16 * np.finfo(np.float64).eps
# Number of iterations [-] without a decrease of the violated conditions after which only one node
# changes at a time.
_PATIENCE = 3
# Number of iterations [-] between two such changes, so that Newton's method approaches equilibrium.
_PERIOD = 3
# Number of iterations [-] without a decrease, while one node changes at a time, after which the
# smallest count is reset.
_RENEWAL = 4


class BlockPivoting:
    """Block pivoting within Newton's method, after Judice and Pires (1994).

    All violated conditions change as long as their number decreases. Murty's rule changes only the
    violated condition with the lowest number, which ends cycles. Its proof is for linear problems,
    so iterations without changes lie between single changes. The smallest count is reset
    periodically, and starting guesses are not counted: few conditions are violated while nodes
    hardly move. Otherwise single changes would exhaust the iterations where contact or slip spreads
    along a surface.

    Several contact pairs are treated together but independently.

    Args:
        comm: Communicator.
        ids: Partition-independent numbers of the nodes, pair by pair, shape ``(n,)``.
        ends: Offsets of the nodes of each of ``c`` pairs, shape ``(c + 1,)``.
        waits: If a pair violates at most this number of conditions, and the number has not
            decreased, nodes that changed in the last iteration keep their state. This prevents
            cycles in which nodes change together between stick and slip.
        is_patient: Whether simultaneous changes, too, wait until Newton's method has approached
            equilibrium.

    Attributes:
        num_violators: Number of violated conditions of all ranks at the last count.
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
        self._is_quiet = False  # no condition was violated at the last count
        self.num_violators = 0

    def select(self, violates: Flags, node: Ints, iteration: int) -> tuple[Flags, int]:
        """Choose the nodes that change their state. Collective.

        Args:
            violates: Flags of violated conditions, shape ``(m,)``.
            node: Indices among all nodes, ascending, shape ``(m,)``.
            iteration: Number of the Newton iteration.

        Returns:
            Flags, shape ``(m,)``, and number of violated conditions on this rank.
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
            renewed = is_stuck & (self._patience < 0) & (-self._patience % _RENEWAL == 1)
            self._fewest[renewed] = count[renewed]
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
        """Flags of nodes of pairs in single-change mode, shape ``(m,)``, or None. Local."""
        if self._is_quiet:
            return None
        single = (self._patience < 0) & (self._last > 0)
        if not single.any():
            return None
        flags: Flags = np.repeat(single, np.diff(self._ends))[node]
        return flags

    def _lowest(self, violates: Flags, node: Ints, pair: Array) -> Flags:
        """Flags of the violated condition with the lowest number of each pair, ``(m,)``."""
        ids = self._ids[node]
        lowest = np.full(len(self._last), np.iinfo(np.int64).max)
        np.minimum.at(lowest, pair[violates], ids[violates])
        flags: Flags = ids == reductions.least(self._comm, lowest)[pair]
        return flags


class ActiveSet:
    """Active set of the normal contact constraints.

    Args:
        state: State of the contact pair, or of several.
        law: Their enforcement.
        stiffness: Stiffness of the nodes, shape ``(n,)`` [N/m].
        is_static: Whether there is no inertia. Then only multipliers decide on active nodes: a
            structure such as a belt may be far softer than its nodes, so that remaining gaps on
            curved surfaces have no meaning.
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
        """Number of violated conditions of all ranks in the last update. Local."""
        return self._pivoting.num_violators

    def update(
        self, node: Ints, excess: Floats, before: Flags, lambda_N: Floats, iteration: int
    ) -> tuple[Flags, int]:
        """Decide which nodes are active. Collective.

        Args:
            node: Indices among the nodes, ascending, shape ``(m,)``.
            excess: Gaps minus reference gaps, shape ``(m,)`` [m].
            before: Whether the nodes were active, shape ``(m,)``.
            lambda_N: Their multipliers, shape ``(m,)`` [N].
            iteration: Number of the Newton iteration of the step, from 0.

        Returns:
            Flags of active nodes, and number of violated conditions on this rank.
        """
        if iteration == 0:
            wrong = (excess < 0) & ~before
        else:
            stiffness = self._stiffness[node]
            gap = np.where(before, 0.0, excess) if self._is_static else excess
            wrong = self._law.active(lambda_N, gap, stiffness) != before
            if wrong.any():
                # Vertices of triangles of degree 2 carry no force under a uniform pressure, and
                # round-off must not toggle them.
                force = np.maximum(np.abs(lambda_N), stiffness * np.abs(excess))
                wrong &= ~(force <= ROUNDING * stiffness * self._size[node])
        changes, violators = self._pivoting.select(wrong, node, iteration)
        return before ^ changes if violators else before, violators
