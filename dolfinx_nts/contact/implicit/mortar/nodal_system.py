"""Linear systems of the coupled multipliers of neighbouring nodes in mortar contact."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.mortar.whole_facets import HatFunctions
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["NodalSystem"]


class NodalSystem:
    """Matrix of constraints restricted to the eliminated displacements of the same nodes.

    It is G^T E, or its transpose, with rows G, one for each constraint, and eliminated directions
    E. On facets of degree 2 mid-nodes move with vertices, see `HatFunctions`. The matrix is nearly
    diagonal, and so small that each rank solves all of it. Collective, as is `solve`.

    Args:
        scatter: Scatter of nodal values.
        hat_functions: Motion of mid-nodes with vertices; None at degree 1.
        dofs: Nodes of the rows in the map of the scatter, the constrained one first, ``(m, d)``.
        rank: Number of constraints, 0, 1 or all components b, shape ``(m,)``.
        rows: Rows with b = 2 or 3 components per node, shape ``(m, 1 or b, b d)``.
        normal: Unit normals, the eliminated directions of nodes with one constraint, shape
            ``(m, b)``. Nodes with b constraints eliminate all directions, ordered by their own
            part of the rows for a dominant diagonal.
        transposed: Whether the system is E^T G.

    Attributes:
        directions: Eliminated directions, shape ``(m, c, b)``, where c is the largest rank.
    """

    def __init__(
        self,
        scatter: NodalScatter,
        hat_functions: HatFunctions | None,
        dofs: Ints,
        rank: Ints,
        rows: Floats,
        normal: Floats,
        *,
        transposed: bool = False,
    ) -> None:
        self._comm: MPI.Comm = scatter.index_map.comm
        self._is_local = scatter.is_local
        b = normal.shape[1]
        c = int(reductions.largest(self._comm, float(rank.max(initial=1))))
        self.directions: Floats = _kernels.eliminated_directions(rank, rows, normal, c)
        self._is_constrained = np.arange(c) < rank[:, None]
        E = np.zeros((c, scatter.num_local, b))
        for a in range(c):
            E[a, dofs[:, 0]] = self.directions[:, a]
            if not self._is_local:
                E[a] = scatter.forward(in_space(E[a]))[:, :b]
        none = np.empty((scatter.num_local, 0))
        parents = (
            (none.astype(np.int32), none)
            if hat_functions is None
            else (hat_functions.parents, hat_functions.weights)
        )
        row, column, value = _kernels.constraint_products(dofs, rank, rows, *parents, E)
        number = (c * dofs[:, :1].astype(np.int64) + np.arange(c))[self._is_constrained]
        if transposed:
            row, column = column, row
        self._own = slice(None)
        if not self._is_local:
            number, row, column = (
                c * scatter.global_nodes((some // c).astype(np.int32)).astype(np.int64) + some % c
                for some in (number, row, column)
            )
            parts = self._comm.allgather((number, row, column, value))
            before = sum(len(part[0]) for part in parts[: self._comm.rank])
            self._own = slice(before, before + len(number))
            number, row, column, value = map(np.concatenate, zip(*parts, strict=True))
        self._system = _kernels.SmallSystem(number, row, column, value)

    def solve(self, b: Floats) -> Floats:
        """Solve for a right-hand side; both have the shape ``(m, c)``.

        The result is 0 for rows without a constraint, and NaN everywhere if the matrix is singular.
        """
        right = b[self._is_constrained]
        if not self._is_local:
            right = np.concatenate(self._comm.allgather(right))
        x: Floats = np.zeros(self._is_constrained.shape)
        x[self._is_constrained] = self._system.solve(right)[self._own]
        return x
