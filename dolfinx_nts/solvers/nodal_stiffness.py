"""Stiffness of the nodes by the diagonal of a matrix, a weight in many tests."""

from collections.abc import Sequence

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.block_csr import BlockCSR
from dolfinx_nts.solvers.cell_sizes import cell_sizes

__all__ = ["NodalStiffness"]

# Stiffness that a node has at least, relative to the mean of its body [-]: at strongly
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
        bodies: Nodes of each body, owned and ghost; what is expected of a node is the mean of its
            body, as one may be far stiffer than another. All others are one more.

    Attributes:
        values: What is known of the owned nodes, ``(n,)`` [N/m]; None before.
        held: Stiffness that matrices have to hold nodes where they are, ``(n, 1)`` [N/m].
    """

    def __init__(self, V: fem.FunctionSpace, fixed: Ints, bodies: Sequence[Ints] = ()) -> None:
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
        every = np.arange(len(self._share), dtype=np.int32)
        self._bodies = [every, *(nodes[nodes < len(every)] for nodes in bodies)]

    def leave_out(self, nodes: Ints) -> None:
        """Take owned nodes as such without unknown displacements. Local."""
        self._is_free[nodes] = False

    def of(self, rows: BlockCSR) -> Floats:
        """Stiffness of the owned nodes in a matrix, shape ``(n,)`` [N/m]. Collective.

        Nodes without unknown displacements have the mean of their body, of rings by their radius,
        or that of all nodes in a body without stiffness.
        """
        num_free = self._is_free.sum(axis=1)
        mean = np.where(self._is_free, rows.diagonal(), 0.0).sum(axis=1) / np.maximum(num_free, 1)
        typical = self._share * self._means(rows, np.abs(mean), num_free > 0)
        known: Floats = np.where(num_free > 0, mean, typical)
        return np.maximum(known, _LEAST_STIFFNESS * typical)

    def _means(self, rows: BlockCSR, stiffness: Floats, counts: Flags) -> Floats:
        """Mean stiffness of the body of each node for a share of 1, the greatest of several."""
        sums = [
            [stiffness[nodes].sum(), self._share[nodes][counts[nodes]].sum()]
            for nodes in self._bodies
        ]
        (of_all, *of_bodies) = (
            total / share if share else np.nan
            for total, share in reductions.total(rows.index_map.comm, np.array(sums))
        )
        means = np.zeros(len(stiffness))
        for nodes, of_body in zip(self._bodies[1:], of_bodies, strict=True):
            means[nodes] = np.fmax(means[nodes], of_body)
        return np.where(means > 0, means, 1.0 if np.isnan(of_all) else of_all)
