"""Which nodes are in contact: the active set of multipliers, and block pivoting.

Contact or none, and stick or slip, are decided node by node, but each decision changes what all
other nodes see.
"""

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.pair import ContactPair
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


class BlockPivoting:
    """Block pivoting within Newton's method, after Judice and Pires (1994).

    All violators change while they become fewer. Murty's rule, by which only the lowest
    changes, ends cycles. It is made for linear problems: between its changes an iteration
    without any brings the iterate near to equilibrium, where decisions can be trusted.

    Args:
        comm: Communicator.
        waits: Whether a node that has changed in the last iteration keeps its state where the
            violators have not become fewer. It was judged with the old states of those that
            changed with it, and would change to and fro with them, as do stick and slip. Where
            one node at a time changes, violators are then counted anew: there were few while
            nodes hardly moved, and slip that spreads along a surface, as on a belt, would need
            some iterations for each node.
    """

    def __init__(self, comm: MPI.Comm, waits: bool = False) -> None:
        """Begin with any number of violators."""
        self._comm, self._waits = comm, waits
        self._fewest: float = np.inf
        self._last: float = np.inf
        self._patience = _PATIENCE
        self._changed: GlobalInts = np.zeros(0, dtype=np.int64)

    def select(self, violates: Flags, ids: GlobalInts, iteration: int) -> tuple[Flags, int]:
        """Choose the nodes that change their state, shape ``(m,)``. Collective.

        ``violates`` tells whose state contradicts its condition, ``ids`` are numbers of the
        nodes on any partition, both of shape ``(m,)``. Returns flags, and the violators on this
        rank.
        """
        num_violators = int(np.count_nonzero(violates))
        count = reductions.total(self._comm, num_violators)
        if count < self._fewest:
            self._fewest, self._patience = count, _PATIENCE
        elif count and count >= self._last:
            self._patience -= 1
            if self._patience == -1 and self._waits:
                self._fewest = count
        changes = violates
        if count and self._patience < 0:
            last = np.iinfo(np.int64).max
            lowest = reductions.least(self._comm, ids[violates].min(initial=last))
            changes = violates & (ids == lowest) & (iteration % _PERIOD == 0)
        elif count >= self._last and self._waits:
            changes = violates & ~np.isin(ids, self._changed)
        self._last, self._changed = count, ids[changes]
        return changes, num_violators


class ActiveSet:
    """Decides node by node between contact and none.

    Args:
        pair: The contact pair.
        law: Enforcement of the pair.
        stiffness: Stiffness of the nodes, shape ``(n,)`` [N/m].
        comm: Communicator of the mesh.
    """

    def __init__(
        self, pair: ContactPair, law: LagrangeMultiplier, stiffness: Floats, comm: MPI.Comm
    ) -> None:
        """Begin without any decision."""
        self._law, self._stiffness = law, stiffness
        self._ids, self._size = pair.nodes.node_ids, pair.segment_size
        self._pivoting = BlockPivoting(comm)

    def update(
        self, node: Ints, excess: Floats, before: Flags, lambda_N: Floats, iteration: int
    ) -> tuple[Flags, int]:
        """Decide which nodes are active. Collective.

        Args:
            node: Positions among the nodes of the pair, shape ``(m,)``.
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
            wrong = self._law.active(lambda_N, excess, stiffness) != before
            if wrong.any():
                # Vertices of triangles of degree 2 carry nothing under a uniform pressure:
                # round-off must not decide on them again and again.
                force = np.maximum(np.abs(lambda_N), stiffness * np.abs(excess))
                wrong &= ~(force <= ROUNDING * stiffness * self._size)
        changes, violators = self._pivoting.select(wrong, self._ids[node], iteration)
        return before ^ changes if violators else before, violators
