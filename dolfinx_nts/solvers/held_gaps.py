"""Gaps and slips that nodes without mass keep or close, and what these leave free."""

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
# Part of a vector [-] that is round-off.
_ROUND_OFF = 4 * float(np.finfo(np.float64).eps)
# Projections with friction, each of which reduces by some orders what is wrong.
_SLIDING_PASSES = 4


class Holds(NamedTuple):
    """Gaps of one pair that are kept or closed, and slips that are kept.

    Attributes:
        scatter: Brings values of nodes to this rank.
        dofs: Nodes in its map on which each depends, shape ``(m, k)``.
        gradient: Gradient of each by these, shape ``(m, 3 k)``.
        force: Force that holds it, per multiplier, shape ``(m, 3 k)``: the gradient, and where
            nodes slide the friction that scales with it.
        way: How far each opens, shape ``(m,)`` [m].
    """

    scatter: NodalScatter
    dofs: Ints
    gradient: Floats
    force: Floats
    way: Floats


class _Rows(NamedTuple):
    """Those of one pair on nodes that are free, by scaled nodal vectors; gradients have length 1.

    Attributes:
        hold: What they are.
        gradient, force: Shape ``(m, k, 3)``.
    """

    hold: Holds
    gradient: Floats
    force: Floats


class HeldGaps:
    """Constraints G x = way on nodal vectors x. Collective, as are its methods.

    They are met by least squares, so that they may contradict each other, or come twice.

    Args:
        comm: Communicator.
        holds: The gaps of each pair.
        free: 1 where an owned node may move, otherwise 0, shape ``(n, 3)``.
        stiffness: That of the owned nodes, which makes nodal vectors orthogonal, shape
            ``(n, 1)`` [N/m].

    Attributes:
        slides: Whether there is friction that scales with normal forces, on any rank.
    """

    def __init__(
        self, comm: MPI.Comm, holds: Sequence[Holds], free: Floats, stiffness: Floats
    ) -> None:
        """Scale all gradients to unit length."""
        self._comm, self._root = comm, np.sqrt(stiffness)
        weight = free / self._root
        self._rows: list[_Rows] = []
        ways, slides = [np.empty(0)], False
        for hold in holds:
            shape = (*hold.dofs.shape, 3)
            gradient, force = hold.gradient.reshape(shape), hold.force.reshape(shape)
            slides |= not np.array_equal(gradient, force)
            left = gradient * hold.scatter.forward(free)[hold.dofs]
            weights = hold.scatter.forward(weight)[hold.dofs]
            is_free = _length(left) > _NO_FREEDOM * _length(gradient)
            length = np.where(is_free, _length(weights * gradient), np.inf)
            scaled = weights / length[:, None, None]
            self._rows.append(_Rows(hold, scaled * gradient, scaled * force))
            ways.append(hold.way / length)
        self._way = np.concatenate(ways)
        self.slides = reductions.anywhere(comm, slides)
        exists = reductions.anywhere(comm, len(self._way) > 0)
        self._passes = _SLIDING_PASSES if self.slides else int(exists)

    def shortest(self) -> Floats:
        """Shortest x that meets them, as far as any does, shape ``(n, 3)`` [m]."""
        if not reductions.anywhere(self._comm, bool(self._way.any())):
            return np.zeros((len(self._root), 3))
        x: Floats = self._least_squares(self._times, self._transposed, self._way) / self._root
        return x

    def project(self, forces: Floats) -> Floats:
        """Leave of forces, ``(n, 3)`` [N], what those that hold cannot balance, in place."""
        columns = [rows.force for rows in self._rows]
        # Friction is nearly orthogonal to all gradients: what it leaves becomes less each time.
        for _ in range(self._passes):
            scaled = forces / self._root
            multipliers = self._least_squares(self._transposed, self._times, scaled)
            forces -= self._root * self._sum(columns, multipliers)
        return forces

    def _times(self, x: Floats) -> Floats:
        """Multiply the gradients by nodal values, ``(n, 3)``; shape ``(m,)``."""
        products = (
            np.einsum("mki,mki->m", rows.gradient, rows.hold.scatter.forward(x)[rows.hold.dofs])
            for rows in self._rows
        )
        return np.concatenate([np.empty(0), *products])

    def _transposed(self, multipliers: Floats) -> Floats:
        """Sum of gradients times multipliers, ``(m,)``, at the owned nodes, ``(n, 3)``."""
        return self._sum([rows.gradient for rows in self._rows], multipliers)

    def _sum(self, vectors: Sequence[Floats], multipliers: Floats) -> Floats:
        """Sum of vectors of all pairs times multipliers, ``(m,)``, at the owned nodes."""
        total, rest = np.zeros((len(self._root), 3)), multipliers
        for (hold, *_), some in zip(self._rows, vectors, strict=True):
            mine, rest = np.split(rest, [len(some)])
            hold.scatter.add(total, hold.dofs, mine[:, None, None] * some)
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
        x, p, old = np.zeros_like(s), s, self._dot(s, s)
        # Gradients have unit length, so that s has the round-off of b.
        least = max(_REDUCTION**2 * old, _ROUND_OFF**2 * self._dot(b, b))
        for _ in range(_MAX_ITERATIONS):
            if old <= least:
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
