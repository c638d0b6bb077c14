"""Nodal stiffness, and stiffness added to the diagonal of the bulk tangent."""

from collections.abc import Sequence

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.cell_sizes import cell_sizes
from dolfinx_nts.solvers.linear.block_csr import BlockCSR

__all__ = ["NEARBY_SHIFT", "AddedStiffness", "NodalStiffness"]

# Least stiffness of a node, relative to the mean of its body [-]. At strongly deformed nodes the
# diagonal can be tiny or negative; a weight must be positive.
_LEAST_STIFFNESS = 0.1
# Effective radius of a node on the axis of an axisymmetric mesh, relative to its cells [-].
_INNERMOST = 0.25

# Stiffness added to definite approximations of the tangent, relative to that of the tangent [-].
# The contact correction can compensate too much stiffness, but not too little.
NEARBY_SHIFT = 1e6


class AddedStiffness:
    """Stiffness added for free bodies and for a viscous resistance. Local.

    Attributes:
        shift: Small stiffness of the owned nodes of free bodies, shape ``(n, 1)``, or of all nodes
            [N/m].
        num_free: Number of rigid motions that only this stiffness resists.
        drag: Stiffness of a viscous resistance, of the same shape, see `Drag`.
        in_addition: Added stiffness in the last matrix, shape ``(n, 1)`` or of all nodes [N/m].
    """

    def __init__(self) -> None:
        self.shift: Floats | float = 0.0
        self.num_free = 0
        self.drag: Floats | float = 0.0
        self.in_addition: Floats | float = 0.0

    def added(self, clamping: Floats | float, *, is_exact: bool) -> Floats | float:
        """Stiffness to add to the diagonal, ``(n, 1)`` or of all nodes [N/m].

        Args:
            clamping: Stiffness by which the matrix clamps nodes, of the same shape [N/m].
            is_exact: Whether the matrix is the derivative itself, not a nearby definite matrix.
        """
        shift = self.shift + clamping
        return (shift if is_exact else NEARBY_SHIFT * shift) + self.drag


class NodalStiffness:
    """Mean diagonal entry of the unknown displacements of each node.

    Rows of prescribed displacements have ones on the diagonal, which are ignored.

    Args:
        V: Space of the displacement.
        fixed: Owned dofs with prescribed displacement.
        bodies: Nodes of each body, owned and ghost. Nodes without unknowns get the mean of their
            body, since bodies may differ widely. All other nodes are treated as one additional
            body.

    Attributes:
        values: Stiffness of the owned nodes, ``(n,)`` [N/m]; None before the first matrix.
        clamping: Stiffness by which matrices clamp nodes, ``(n, 1)`` [N/m].
    """

    def __init__(self, V: fem.FunctionSpace, fixed: Ints, bodies: Sequence[Ints] = ()) -> None:
        self.values: Floats | None = None
        self.clamping: Floats | float = 0.0
        self._is_free = np.ones((V.dofmap.index_map.size_local, dimension(V)), dtype=bool)
        self._is_free.ravel()[fixed] = False
        # Expected relative stiffness: in axisymmetric meshes it grows with the radius.
        self._share: Floats = np.ones(len(self._is_free))
        if is_axisymmetric(V.mesh):
            r = reference_positions(V)[: len(self._share), 0]
            self._share = np.maximum(r, _INNERMOST * cell_sizes(V).nodal)
        every = np.arange(len(self._share), dtype=np.int32)
        self._bodies = [every, *(nodes[nodes < len(every)] for nodes in bodies)]

    def leave_out(self, nodes: Ints) -> None:
        """Treat owned nodes as nodes without unknown displacements. Local."""
        self._is_free[nodes] = False

    def of(self, rows: BlockCSR) -> Floats:
        """Stiffness of the owned nodes in a matrix, shape ``(n,)`` [N/m]. Collective.

        Nodes without unknown displacements have the mean of their body, in axisymmetric meshes
        scaled with the radius. If the body has no stiffness, they have the mean of all nodes.
        """
        num_free = self._is_free.sum(axis=1)
        mean = np.where(self._is_free, rows.diagonal(), 0.0).sum(axis=1) / np.maximum(num_free, 1)
        typical = self._share * self._means(rows, np.abs(mean), num_free > 0)
        known: Floats = np.where(num_free > 0, mean, typical)
        return np.maximum(known, _LEAST_STIFFNESS * typical)

    def _means(self, rows: BlockCSR, stiffness: Floats, counts: Flags) -> Floats:
        """Mean stiffness of the stiffest body at each node, for nodes of relative stiffness 1."""
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
