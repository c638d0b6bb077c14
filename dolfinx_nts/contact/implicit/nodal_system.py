"""Systems between the multipliers of neighbouring nodes, which mortar contact couples."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.scatter import NodalScatter
from dolfinx_nts.search.whole_facets import Hats

__all__ = ["NodalSystem"]


class NodalSystem:
    """Products of rows of constrained nodes with the directions that these nodes give up.

    With rows G, one for each constraint, and the directions E it is G^T E, or its transpose. On
    facets of degree 2 the nodes between vertices go with these, see `Hats`. The matrix is near to
    a diagonal one, and so small that each rank solves all of it. Collective, as is `solve`.

    Args:
        scatter: Brings values of nodes to this rank.
        hats: How nodes between vertices go with these; None at degree 1.
        dofs: Nodes of the rows in its map, the constrained one first, shape ``(m, d)``.
        rank: Number of constraints, 0, 1 or all components b, shape ``(m,)``; those with 0 are
            left out.
        rows: Their rows, with b = 2 or 3 components a node, the first of ``(m, 1 or b, b d)``.
        normal: Unit normals, which nodes with one constraint give up, shape ``(m, b)``. Those
            with b give up all, in the directions of their own parts of the rows, which
            puts the largest entries on the diagonal.
        transposed: Whether the system is E^T G.

    Attributes:
        directions: Directions that the nodes give up, shape ``(m, c, b)``, where c is the
            largest rank.
    """

    def __init__(
        self,
        scatter: NodalScatter,
        hats: Hats | None,
        dofs: Ints,
        rank: Ints,
        rows: Floats,
        normal: Floats,
        *,
        transposed: bool = False,
    ) -> None:
        """Multiply, and gather the matrix."""
        self._comm: MPI.Comm = scatter.index_map.comm
        self._is_local = scatter.is_local
        b = normal.shape[1]
        c = int(reductions.largest(self._comm, float(rank.max(initial=1))))
        directions = np.where((rank == 1)[:, None, None], normal[:, None], rows[:, :c, :b])
        self._held = np.arange(c) < rank[:, None]
        self.directions: Floats = directions * self._held[:, :, None]
        E = np.empty((c, scatter.num_local, b))
        for a in range(c):
            own = np.zeros((scatter.index_map.size_local, 3))
            own[dofs[:, 0], :b] = self.directions[:, a]
            E[a] = scatter.forward(own)[:, :b]
        parents = np.arange(scatter.num_local, dtype=np.int32)[:, None]
        weights = np.ones(parents.shape)
        if hats is not None:
            parents, weights = hats.parents, hats.weights
        row, column, value = _kernels.constraint_products(dofs, rank, rows, parents, weights, E)
        mine = (c * dofs[:, :1].astype(np.int64) + np.arange(c))[self._held]
        if transposed:
            row, column = column, row
        if not self._is_local:
            mine, row, column = (
                c * scatter.global_nodes((number // c).astype(np.int32)).astype(np.int64)
                + number % c
                for number in (mine, row, column)
            )
            parts = zip(*self._comm.allgather((mine, row, column, value)), strict=True)
            every, row, column, value = map(np.concatenate, parts)
        else:
            every = mine
        self._order = np.argsort(every)
        number = every[self._order]
        self._mine = np.searchsorted(number, mine)
        self._matrix = _kernels.sparse_rows(number, row, column, value)

    def solve(self, b: Floats) -> Floats:
        """Solve for a right-hand side and with a result of shape ``(m, c)``.

        There are zeros where there is no constraint, and NaN everywhere where it fails.
        """
        right = b[self._held]
        if not self._is_local:
            right = np.concatenate(self._comm.allgather(right))
        solution = _kernels.solve_small(*self._matrix, right[self._order])
        x: Floats = np.zeros(self._held.shape)
        x[self._held] = solution[self._mine]
        return x
