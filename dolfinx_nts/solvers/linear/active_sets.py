"""Version numbers of active sets, and whether their multipliers can be eliminated."""

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Array, Floats, same_numbers
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.linear.elimination import ActivePairs

__all__ = ["ActiveSets"]


class ActiveSets:
    """Version numbers of the active sets of successive iterations; equal sets share a number.

    Args:
        comm: Communicator.

    Attributes:
        version: Number of the last nonempty set, starting from 1.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        self._comm = comm
        self._last: Sequence[Array] | None = None
        self._is_coupled: bool | None = None  # not determined yet
        self.version = 0

    def number(self, pairs: Sequence[ActivePairs]) -> int:
        """Version number of a set, 0 for the empty set. Collective.

        Args:
            pairs: Active pairs; sets are equal if nodes and numbers of constraints are equal.
        """
        if not pairs:
            return 0
        arrays: list[Array] = []
        for p in pairs:
            blocks = p.global_blocks()
            arrays += blocks.start, blocks.nodes, blocks.rank, blocks.tangent_nodes, p.fixed
        last = self._last or []
        is_same = len(last) == len(arrays) and all(map(same_numbers, last, arrays))
        if not reductions.everywhere(self._comm, is_same):
            self._last, self._is_coupled = arrays, None
            self.version += 1
        return self.version

    def are_coupled(self, pairs: Sequence[ActivePairs]) -> bool:
        """Whether the projections of `Elimination` do not exist. Collective.

        This is the case if a constrained node belongs to another active pair, or is fixed.

        Args:
            pairs: Active pairs that were numbered last.
        """
        if self._is_coupled is None:
            self._is_coupled = reductions.anywhere(self._comm, _coupled(pairs))
        return self._is_coupled

    def serialize(self, archive: Archive) -> None:
        """Serialize the last set. Collective.

        Args:
            archive: Archive that stores the set, or returns it; a returned set gets a new number.
        """
        last = archive.local("active_set", self._last)
        if archive.restores:
            self._last, self._is_coupled = last, None
            self.version += 1


def _coupled(pairs: Sequence[ActivePairs]) -> bool:
    """Whether a node of this rank is constrained twice, or constrained and fixed. Collective."""
    taken: Any = 0
    others: Any = 0
    allowed: Any = 0
    blocked = False
    for p in pairs:
        marks: Floats = np.zeros((p.ghosts.num_local, 3))
        marks[:, 0] = np.bincount(p.blocks.constrained, minlength=len(marks))
        marks[:, 1] = np.bincount(p.blocks.nodes, minlength=len(marks)) > marks[:, 0]
        marks = p.ghosts.reverse(marks)
        taken, others = taken + marks[:, 0], others + marks[:, 1]
        if p.may_overlap:
            allowed = allowed + marks[:, 1] * (marks[:, 0] > 0)
        blocked = not p.is_regular or blocked or bool(p.fixed[p.blocks.rank > 0].any())
    return blocked or bool(((taken > 1) | ((taken > 0) & (others > allowed))).any())
