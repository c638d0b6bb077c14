"""The bulk tangent in single precision, for preconditioners: factors and products.

Single precision is enough there and takes half the time, as the processor
waits for memory.
"""

from typing import Any

import numpy as np
from dolfinx import la

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.block_csr import BlockCSR
from dolfinx_nts.solvers.shells import shell_matrix

__all__ = ["BlockILU", "SinglePrecisionOperator"]


class BlockILU:
    """Incomplete factors of a matrix, see `cpp/nts/solvers/incomplete_factors.h`.

    On one rank they are those of all rows. On several, each rank solves for
    the nodes that it owns and those that their rows reach, and takes what it
    finds at its own (restricted additive Schwarz method with an overlap of 1).

    Args:
        rows: Owned rows of the matrix; their values may change.
        fill: Whether they have more entries than the matrix: those between
            nodes with a neighbour that is eliminated before, ILU(1).

    ``str`` tells the kind of factors.
    """

    def __init__(self, rows: BlockCSR, *, fill: bool = False) -> None:
        """Create the factors, without values before `build`. Collective."""
        self._rows, self._fill = rows, fill
        self._alone = bool(rows.index_map.comm.size == 1)
        self._order: Ints | None = None
        # It is used again, as new memory takes 20 times as long to fill.
        self._values: Floats = np.empty(0)
        self._factors = _kernels.IncompleteFactors()
        self._places: Ints | None = None  # of the rows that are solved for; None: of all
        # Its ghosts are the nodes of other ranks that the owned rows reach.
        self._vector = la.vector(rows.matrix.index_map(1), rows.dim)
        self._ends = np.array(rows.index_map.comm.allgather(rows.index_map.local_range[1]))

    def __str__(self) -> str:
        """Kind of the factors, and how several ranks work together."""
        kind = "ILU(1)" if self._fill else "ILU"
        return f"{'' if self._alone else 'ASM of '}{kind} in single precision"

    def build(self) -> bool:
        """Factorise the present values. Collective.

        Returns:
            Whether the factors exist on all ranks.
        """
        rows = self._rows
        start, column, value = rows.start, rows.column, rows.value
        if not self._alone:
            start, column, value = self._overlapping()
        if self._order is None:
            self._order = _order(start, column, self._rows.index_map.size_local)
        exist: bool = self._factors.factorise(start, column, value, self._order, self._fill)
        return bool(reductions.everywhere(rows.index_map.comm, exist))

    def restrict(self, nodes: Flags | None) -> None:
        """Solve for some nodes from now on, with zero at all others. Collective.

        Args:
            nodes: Which owned nodes, shape ``(n,)``; None: all.
        """
        if nodes is None:
            self._places = None
            return
        values = self._vector.array.reshape(-1, self._rows.dim)
        values[: len(nodes)] = nodes[:, None]
        self._vector.scatter_forward()
        assert self._order is not None
        self._places = np.flatnonzero(values[:, 0][self._order] > 0).astype(np.int32)

    def solve(self, b: Floats) -> Floats:
        """Solution for b, nodal vectors of shape ``(n, d)``. Collective."""
        x = np.empty_like(b)
        self._solve(b, x)
        return x

    def apply(self, _pc: Any, r: Any, z: Any) -> None:
        """Set z to the solution for r; called by PETSc. Collective."""
        dim = self._rows.dim
        self._solve(r.array_r.reshape(-1, dim), z.array.reshape(-1, dim))

    def solve_all(self, b: Floats) -> Floats:
        """Solve for the columns of an array, shape ``(d n, k)``, by columns. Collective."""
        x = np.empty_like(b)
        for known, unknown in zip(b.T, x.T, strict=True):
            self._solve(*(values.reshape(-1, self._rows.dim) for values in (known, unknown)))
        return x

    def _solve(self, known: Floats, unknown: Floats) -> None:
        if not self._alone:
            values = self._vector.array.reshape(-1, self._rows.dim)
            values[: len(known)] = known
            self._vector.scatter_forward()
            known = values
        if self._places is None:
            self._factors.apply(known, unknown)
        else:
            unknown.fill(0)
            self._factors.apply_at(self._places, known, unknown)

    def _overlapping(self) -> tuple[GlobalInts, Ints, Floats]:
        """Rows of all nodes that this rank solves for, with local columns. Collective."""
        own, nodes = self._rows, self._vector.index_map
        start, far, value = own.gather(nodes.ghosts, self._ends)
        column = nodes.global_to_local(far)
        column[column < 0] = nodes.size_local + nodes.num_ghosts  # beyond these nodes
        if len(self._values) != len(own.value) + len(value):
            self._values = np.empty(len(own.value) + len(value))
        return (
            np.concatenate([own.start, own.start[-1] + start[1:]]),
            np.concatenate([own.column, column]),
            np.concatenate([own.value, value], out=self._values),
        )


def _order(start: GlobalInts, column: Ints, num_owned: int) -> Ints:
    """Order of elimination: that of DOLFINx backwards, ghosts next to their neighbours.

    With ghosts at the end, where DOLFINx has them, 8 decades take up to 18
    iterations instead of 11; reverse Cuthill-McKee takes 2 % more than this order.
    """
    n = len(start) - 1
    row = np.repeat(np.arange(n - num_owned), np.diff(start[num_owned:]))
    column = column[start[num_owned] :]
    is_owned = column < num_owned
    row, column = row[is_owned], column[is_owned]
    count, total = (np.bincount(row, w, minlength=n - num_owned) for w in (None, column))
    place = np.concatenate([np.arange(num_owned), total / np.maximum(count, 1)])
    order: Ints = np.argsort(-place, kind="stable").astype(np.int32)
    return order


class SinglePrecisionOperator:
    """Context of a shell matrix, with the present values of some rows. Collective.

    Args:
        rows: Owned rows of the matrix.
    """

    def __init__(self, rows: BlockCSR) -> None:
        """Create a copy of the values."""
        self._map, self._dim = rows.index_map, rows.dim
        self._matrix = _kernels.SingleMatrix(rows.start, rows.column, rows.value)
        self._vector = la.vector(rows.matrix.index_map(1), rows.dim)

    def matrix(self) -> Any:
        """Create the shell matrix, which works as long as this object is kept. Collective."""
        size = self._dim * self._map.size_local, self._dim * self._map.size_global
        return shell_matrix(self._map.comm, size, self)

    def mult(self, _matrix: Any, x: Any, y: Any) -> None:
        """Set y to A x; called by PETSc."""
        owned = x.array_r
        self._vector.array[: len(owned)] = owned
        self._vector.scatter_forward()
        known, unknown = (a.reshape(-1, self._dim) for a in (self._vector.array, y.array))
        self._matrix.multiply(known, unknown)
