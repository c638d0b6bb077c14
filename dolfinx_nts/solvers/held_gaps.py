"""Gaps that nodes without mass keep or close, and what these leave free of nodal vectors."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["HeldGaps", "Holds"]

# Part of a gradient [-] that is left where nodes are free, below which others decide on the gap.
_NO_FREEDOM = 1e-3
# Reduction in least squares [-], and most iterations: rows of neighbours are nearly orthogonal,
# unless two pairs hold a node nearly in the same direction.
_REDUCTION, _MAX_ITERATIONS = 1e-13, 50


class Holds(NamedTuple):
    """Gaps of one pair that are kept or closed.

    Attributes:
        scatter: Brings values of nodes to this rank.
        dofs: Nodes in its map on which each gap depends, shape ``(m, k)``.
        gradient: Gradient of each gap by these, shape ``(m, 3 k)``.
        way: How far each gap opens, shape ``(m,)`` [m].
    """

    scatter: NodalScatter
    dofs: Ints
    gradient: Floats
    way: Floats


class HeldGaps:
    """Constraints G x = way on nodal vectors x. Collective, as are its methods.

    They are met by least squares, so that they may contradict each other, or come twice.

    Args:
        comm: Communicator.
        holds: The gaps of each pair.
        free: 1 where an owned node may move, otherwise 0, shape ``(n, 3)``.
        stiffness: That of the owned nodes, which makes nodal vectors orthogonal, shape
            ``(n, 1)`` [N/m].
    """

    def __init__(
        self, comm: MPI.Comm, holds: Sequence[Holds], free: Floats, stiffness: Floats
    ) -> None:
        """Scale all gradients to unit length."""
        self._comm, self._root = comm, np.sqrt(stiffness)
        weight = free / self._root
        self._parts: list[tuple[Holds, Floats]] = []
        ways = [np.empty(0)]
        for hold in holds:
            shape = (*hold.dofs.shape, 3)
            gradient = hold.gradient.reshape(shape)
            left = gradient * hold.scatter.forward(free)[hold.dofs]
            row = gradient * hold.scatter.forward(weight)[hold.dofs]
            is_free = _length(left) > _NO_FREEDOM * _length(gradient)
            length = np.where(is_free, _length(row), np.inf)
            self._parts.append((hold, row / length[:, None, None]))
            ways.append(hold.way / length)
        self._way = np.concatenate(ways)
        self._exists = reductions.anywhere(comm, len(self._way) > 0)

    def shortest(self) -> Floats:
        """Shortest x that meets them, as far as any does, shape ``(n, 3)`` [m]."""
        if not reductions.anywhere(self._comm, bool(self._way.any())):
            return np.zeros((len(self._root), 3))
        x: Floats = self._least_squares(self._times, self._transposed, self._way) / self._root
        return x

    def project(self, forces: Floats) -> Floats:
        """Leave of forces, ``(n, 3)`` [N], what those of the gaps cannot balance, in place."""
        if self._exists:
            scaled = forces / self._root
            multipliers = self._least_squares(self._transposed, self._times, scaled)
            forces -= self._root * self._transposed(multipliers)
        return forces

    def _times(self, x: Floats) -> Floats:
        """Multiply the rows by nodal values, ``(n, 3)``; shape ``(m,)``."""
        return np.concatenate(
            [
                np.einsum("mki,mki->m", row, hold.scatter.forward(x)[hold.dofs])
                for hold, row in self._parts
            ]
        )

    def _transposed(self, multipliers: Floats) -> Floats:
        """Sum of the rows times multipliers, ``(m,)``, at the owned nodes, ``(n, 3)``."""
        total, begin = np.zeros((len(self._root), 3)), 0
        for hold, row in self._parts:
            part = multipliers[begin : begin + len(row)]
            hold.scatter.add(total, hold.dofs, part[:, None, None] * row)
            begin += len(row)
        return total

    def _least_squares(
        self,
        times: Callable[[Floats], Floats],
        transposed: Callable[[Floats], Floats],
        b: Floats,
    ) -> Floats:
        """Solve by conjugate gradients; the shortest solution, of the shape of A^T b."""
        r = b.copy()
        s = transposed(r)
        x, p, first = np.zeros_like(s), s, self._dot(s, s)
        old = first
        for _ in range(_MAX_ITERATIONS):
            if old <= _REDUCTION**2 * first:
                break
            q = times(p)
            step = old / self._dot(q, q)
            x += step * p
            r -= step * q
            s = transposed(r)
            new = self._dot(s, s)
            p, old = s + new / old * p, new
        return x

    def _dot(self, a: Floats, b: Floats) -> float:
        return reductions.total(self._comm, float(np.vdot(a, b)))


def _length(rows: Floats) -> Floats:
    """Lengths of rows, ``(m, k, 3)``, 0 where they are no numbers, ``(m,)``."""
    length: Floats = np.sqrt(np.einsum("mki,mki->m", rows, rows))
    return length
