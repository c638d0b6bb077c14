"""Stiffness of the nodes by the diagonal of a matrix, a weight in many tests."""

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.block_csr import BlockCSR
from dolfinx_nts.solvers.cell_sizes import cell_sizes

__all__ = ["NodalStiffness"]

# Stiffness that a node has at least, relative to the mean of all [-]: at strongly
# deformed nodes it can be small or negative, and a weight must be neither.
_LEAST_STIFFNESS = 0.1
# Radius of the ring of a node on the axis, relative to its cells [-].
_INNERMOST = 0.25


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
        # Stiffness to be expected, relative to others: that of rings grows with their radius.
        self._share: Floats = np.ones(len(self._is_free))
        if is_axisymmetric(V.mesh):
            r = V.tabulate_dof_coordinates()[: len(self._share), 0]
            self._share = np.maximum(r, _INNERMOST * cell_sizes(V).nodal)

    def leave_out(self, nodes: Ints) -> None:
        """Take owned nodes as such without unknown displacements. Local."""
        self._is_free[nodes] = False

    def of(self, rows: BlockCSR) -> Floats:
        """Stiffness of the owned nodes in a matrix, shape ``(n,)`` [N/m]. Collective.

        Nodes without unknown displacements have the mean of all others, of rings by their radius.
        """
        num_free = self._is_free.sum(axis=1)
        mean = np.where(self._is_free, rows.diagonal(), 0.0).sum(axis=1) / np.maximum(num_free, 1)
        sums = [np.abs(mean).sum(), self._share[num_free > 0].sum()]
        total, count = reductions.total(rows.index_map.comm, sums)
        typical = self._share * total / count if count else self._share
        known: Floats = np.where(num_free > 0, mean, typical)
        return np.maximum(known, _LEAST_STIFFNESS * typical)
