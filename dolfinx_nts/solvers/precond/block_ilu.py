"""Incomplete factors and products of the bulk tangent in single precision, for preconditioners.

Single precision is accurate enough and takes half the time, as memory bandwidth limits both.
"""

from typing import Any

import numpy as np
from dolfinx import la

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints, indices
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.scatter import NodalScatter
from dolfinx_nts.solvers.linear.block_csr import BlockCSR
from dolfinx_nts.solvers.linear.shells import shell_matrix

__all__ = ["BlockILU", "SinglePrecisionOperator"]


class BlockILU:
    """Incomplete LU factors of a block matrix, see `cpp/nts/solvers/incomplete_factors.h`.

    On one rank all rows are factorised. On several ranks each one factorises the rows of its nodes
    and of their ghosts, and keeps the solution at its own nodes (restricted additive Schwarz method
    with an overlap of 1).

    Args:
        rows: Owned rows of the matrix; their values may change.
        fill: Whether to use ILU(1), with fill between neighbours of a node eliminated before,
            instead of ILU(0).

    ``str`` is the kind of the factors.
    """

    def __init__(self, rows: BlockCSR, *, fill: bool = False) -> None:
        self._rows, self._fill = rows, fill
        self._alone = bool(rows.index_map.comm.size == 1)
        self._order: Ints | None = None
        self._factors = _kernels.IncompleteFactors()
        self._places: Ints | None = None  # positions of the rows to solve for; None: all rows
        # Its ghosts are the nodes of other ranks in the columns of the owned rows.
        self._scatter = NodalScatter(rows.matrix.index_map(1))
        self._ends = np.array(rows.index_map.comm.allgather(rows.index_map.local_range[1]))

    def __str__(self) -> str:
        kind = "ILU(1)" if self._fill else "ILU"
        return f"{'' if self._alone else 'ASM of '}{kind} in single precision"

    def build(self) -> bool:
        """Factorise the current values. Collective.

        Returns:
            Whether the factors exist on all ranks.
        """
        rows = self._rows
        start, column, behind = rows.start, rows.column, None
        if not self._alone:
            start, column, behind = self._overlapping()
        if self._order is None:
            self._order = _order(start, column, rows.index_map.size_local)
        exist: bool = self._factors.factorise(
            start, column, rows.value, self._order, self._fill, behind
        )
        return bool(reductions.everywhere(rows.index_map.comm, exist))

    def restrict(self, nodes: Flags | None) -> None:
        """Restrict the following solves to some nodes, with zero at all others. Collective.

        Args:
            nodes: Flags of the owned nodes, shape ``(n,)``; None: all nodes.
        """
        if nodes is None:
            self._places = None
            return
        flags = nodes[:, None].astype(np.float64)
        flags = np.concatenate([flags, self._scatter.at_ghosts(flags)])
        assert self._order is not None
        self._places = indices(flags[self._order] > 0)

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
        behind = None if self._alone else self._scatter.at_ghosts(known)
        if self._places is None:
            self._factors.apply(known, unknown, behind)
        else:
            unknown.fill(0)
            self._factors.apply_at(self._places, known, unknown, behind)

    def _overlapping(self) -> tuple[GlobalInts, Ints, Floats]:
        """Rows of the owned nodes and of their ghosts, with local columns. Collective.

        Returns:
            Offsets of the rows; their columns; blocks of the rows of other ranks.
        """
        own, nodes = self._rows, self._scatter.index_map
        start, far, value = own.gather(nodes.ghosts, self._ends)
        column = nodes.global_to_local(far)
        column[column < 0] = nodes.size_local + nodes.num_ghosts  # columns outside of these nodes
        start = np.concatenate([own.start, own.start[-1] + start[1:]])
        return start, np.concatenate([own.column, column]), value


def _order(start: GlobalInts, column: Ints, num_owned: int) -> Ints:
    """Elimination order: the reverse order of DOLFINx, with ghosts next to their neighbours.

    With ghosts at the end, as in DOLFINx, a reduction by 1e-8 takes up to 18 iterations instead of
    11. Reverse Cuthill-McKee takes 2 % more than this order.
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
    """Shell matrix with a copy of the rows of a matrix in single precision. Collective.

    Args:
        rows: Owned rows of the matrix.
    """

    def __init__(self, rows: BlockCSR) -> None:
        self._map, self._dim = rows.index_map, rows.dim
        self._matrix = _kernels.SingleMatrix(rows.start, rows.column, rows.value)
        self._vector = la.vector(rows.matrix.index_map(1), rows.dim)

    def matrix(self) -> Any:
        """Create the shell matrix, which is valid as long as this object exists. Collective."""
        size = self._dim * self._map.size_local, self._dim * self._map.size_global
        return shell_matrix(self._map.comm, size, self)

    def mult(self, _matrix: Any, x: Any, y: Any) -> None:
        """Set y to A x; called by PETSc."""
        owned = x.array_r
        self._vector.array[: len(owned)] = owned
        self._vector.scatter_forward()
        known, unknown = (a.reshape(-1, self._dim) for a in (self._vector.array, y.array))
        self._matrix.multiply(known, unknown)
