"""Systems between the multipliers of neighbouring nodes, which mortar contact couples."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, GlobalInts, Ints
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
        m, b = normal.shape
        c = int(reductions.largest(self._comm, float(rank.max(initial=1))))
        directions = np.where((rank == 1)[:, None, None], normal[:, None], rows[:, :c, :b])
        self._held = np.arange(c) < rank[:, None]
        self.directions: Floats = directions * self._held[:, :, None]
        E = np.zeros((scatter.num_local, c, b))
        for a in range(c):
            own = np.zeros((scatter.index_map.size_local, 3))
            own[dofs[:, 0], :b] = self.directions[:, a]
            E[:, a] = scatter.forward(own)[:, :b]
        rows, vertices = rows[:, :c].reshape(m, c, dofs.shape[1], b), dofs
        if hats is not None:
            weights, vertices = hats.weights[dofs], hats.parents[dofs]
            vertices = vertices.reshape(m, weights[0].size if m else 0)
            rows = rows[:, :, :, None] * weights[:, None, :, :, None]
            rows = rows.reshape(m, c, vertices.shape[1], b)
        products = np.einsum("mkdi,mdai->mkda", rows, E[vertices])
        products *= self._held[:, :, None, None]
        number = c * scatter.global_nodes(vertices)[:, :, None].astype(np.int64) + np.arange(c)
        own = c * scatter.global_nodes(dofs[:, :1]).astype(np.int64) + np.arange(c)
        entry = np.nonzero(products)
        row, column = own[entry[0], entry[1]], number[entry[0], entry[2], entry[3]]
        mine = own[self._held]
        if transposed:
            row, column = column, row
        self._make(mine, row, column, products[entry])

    def _make(self, mine: GlobalInts, row: GlobalInts, column: GlobalInts, value: Floats) -> None:
        """Sort the entries of all ranks into rows; ``mine`` are the numbers of this rank."""
        if not self._is_local:
            parts = zip(*self._comm.allgather((mine, row, column, value)), strict=True)
            every, row, column, value = map(np.concatenate, parts)
        else:
            every = mine
        self._order = np.argsort(every)
        number = every[self._order]
        self._mine = np.searchsorted(number, mine)
        place = np.searchsorted(number, row)
        order = np.argsort(place, kind="stable")
        counts = np.bincount(place, minlength=len(number))
        self._start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self._column = np.searchsorted(number, column[order]).astype(np.int32)
        self._value = value[order]

    def solve(self, b: Floats) -> Floats:
        """Solve for a right-hand side and with a result of shape ``(m, c)``.

        There are zeros where there is no constraint, and NaN everywhere where it fails.
        """
        right = b[self._held]
        if not self._is_local:
            right = np.concatenate(self._comm.allgather(right))
        solution = _kernels.solve_small(self._start, self._column, self._value, right[self._order])
        x: Floats = np.zeros(self._held.shape)
        x[self._held] = solution[self._mine]
        return x
