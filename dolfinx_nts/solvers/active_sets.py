"""What is the same for equal active sets: their number, and whether pairs are coupled."""

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Array, Floats
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.elimination import ActivePairs, Elimination

__all__ = ["ActiveSets", "Coupling"]


class ActiveSets:
    """Numbers active sets as they follow each other: an equal one has the same number.

    Args:
        comm: Communicator.

    Attributes:
        version: Number of the last set that was not empty, from 1.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        """Start without a set."""
        self._comm = comm
        self._last: Sequence[Array] | None = None
        self.version = 0

    def number(self, pairs: Sequence[ActivePairs]) -> int:
        """Number of a set, 0 of the empty one, which is not counted. Collective.

        Args:
            pairs: Active pairs; their nodes and constraints tell sets apart.
        """
        if not pairs:
            return 0
        arrays: list[Array] = []
        for p in pairs:
            blocks = p.global_blocks()
            arrays += blocks.start, blocks.nodes, blocks.rank, blocks.tangent_nodes, p.fixed
        last = self._last or []
        is_same = len(last) == len(arrays) and all(map(np.array_equal, last, arrays))
        if not reductions.everywhere(self._comm, is_same):
            self._last = arrays
            self.version += 1
        return self.version

    def serialize(self, archive: Archive) -> None:
        """Serialize the last set. Collective.

        Args:
            archive: Takes it or gives it, then with a new number.
        """
        last = archive.local("active_set", self._last)
        if archive.giving:
            self._last = last
            self.version += 1


class Coupling:
    """Whether the projections exist, looked at only where pairs have changed.

    They do not where a constrained node takes part in another active pair,
    or is fixed.

    Args:
        comm: Communicator.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        """Start without pairs."""
        self._comm = comm
        self._version = 0
        self._is_coupled = False

    def of(self, elimination: Elimination) -> bool:
        """Whether the pairs of a Newton iteration are coupled. Collective."""
        if elimination.empty:
            return False
        if elimination.active_version != self._version:
            self._version = elimination.active_version
            self._is_coupled = reductions.anywhere(self._comm, _coupled(elimination.pairs))
        return self._is_coupled


def _coupled(pairs: Sequence[ActivePairs]) -> bool:
    """Whether some are on this rank. Collective."""
    taken: Any = 0
    others: Any = 0
    blocked = False
    for p in pairs:
        constrained, first = p.blocks.rank > 0, p.blocks.start[:-1]
        marks: Floats = np.zeros((p.ghosts.num_local, 3))
        marks[p.blocks.constrained, 0] = 1  # each node is in one pair of a contact pair
        marks[np.delete(p.blocks.nodes, first[constrained]), 1] = 1
        marks = p.ghosts.reverse(marks)
        taken, others = taken + marks[:, 0], others + marks[:, 1]
        blocked = blocked or bool(p.fixed[constrained].any())
    return blocked or bool(((taken > 1) | ((taken > 0) & (others > 0))).any())
