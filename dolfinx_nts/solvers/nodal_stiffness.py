"""Stiffness of the nodes by the diagonal of a matrix, a weight in many tests."""

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.block_csr import BlockCSR

__all__ = ["NodalStiffness"]

# Stiffness that a node has at least, relative to the mean of all [-]: at strongly
# deformed nodes it can be small or negative, and a weight must be neither.
_LEAST_STIFFNESS = 0.1


class NodalStiffness:
    """Mean diagonal entry of the unknown displacements of each node.

    Where displacements are given, matrices have ones on their diagonals, which are no stiffness.

    Args:
        V: Space of the displacement.
        fixed: Owned dofs whose displacement is given.

    Attributes:
        values: What is known of the owned nodes, ``(n,)`` [N/m]; None before.
        held: Stiffness that matrices have to hold nodes where they are, ``(n, 1)`` [N/m].
    """

    def __init__(self, V: fem.FunctionSpace, fixed: Ints) -> None:
        """Find the unknown displacements."""
        self.values: Floats | None = None
        self.held: Floats | float = 0.0
        self._is_free = np.ones((V.dofmap.index_map.size_local, dimension(V)), dtype=bool)
        self._is_free.ravel()[fixed] = False

    def leave_out(self, nodes: Ints) -> None:
        """Take owned nodes as such without unknown displacements. Local."""
        self._is_free[nodes] = False

    def of(self, rows: BlockCSR) -> Floats:
        """Stiffness of the owned nodes in a matrix, shape ``(n,)`` [N/m]. Collective.

        Nodes without unknown displacements have the mean of all others.
        """
        num_free = self._is_free.sum(axis=1)
        mean = np.where(self._is_free, rows.diagonal(), 0.0).sum(axis=1) / np.maximum(num_free, 1)
        sums = [np.abs(mean).sum(), np.count_nonzero(num_free)]
        total, count = reductions.total(rows.index_map.comm, sums)
        typical = total / count if count else 1.0
        known: Floats = np.where(num_free > 0, mean, typical)
        return np.maximum(known, _LEAST_STIFFNESS * typical)
