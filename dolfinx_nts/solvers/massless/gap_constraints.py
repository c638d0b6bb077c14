"""Constraints on gaps and slips of massless nodes, and projection on them."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["GapConstraints", "PairConstraints"]

# Fraction of a gradient on free nodes [-] below which the constraint is left out.
_NO_FREEDOM = 1e-3
# Reduction of the least-squares residual [-], and largest number of iterations. Rows of neighbours
# are nearly orthogonal, unless two pairs constrain a node in nearly the same direction.
_REDUCTION, _MAX_ITERATIONS = 1e-13, 50
# Relative round-off of a vector [-].
_ROUND_OFF = 4 * float(np.finfo(np.float64).eps)
# Number of projections with friction. Each reduces the error by some orders of magnitude.
_SLIDING_PASSES = 4


class PairConstraints(NamedTuple):
    """Constraints of one pair: gaps with a prescribed change, and constant slips.

    Attributes:
        scatter: Exchange of nodal values between ranks.
        dofs: Nodes of each constraint in the map of the scatter, shape ``(m, k)``.
        gradient: Gradient with respect to these nodes, shape ``(m, 3 k)``.
        force: Constraint force per multiplier, shape ``(m, 3 k)``: the gradient, plus the friction
            of sliding nodes.
        opening: Prescribed change of each gap, shape ``(m,)`` [m].
    """

    scatter: NodalScatter
    dofs: Ints
    gradient: Floats
    force: Floats
    opening: Floats


class _SomeNodes:
    """Exchange of values between some owned nodes and the rows of a pair.

    Args:
        scatter: Exchange of nodal values between ranks.
        nodes: The owned nodes, shape ``(n,)``.
    """

    def __init__(self, scatter: NodalScatter, nodes: Ints) -> None:
        self._scatter, self._nodes = scatter, nodes
        self._all: Floats = np.zeros((scatter.index_map.size_local, 3))

    def forward(self, values: Floats) -> Floats:
        """Values on the scatter's map, 0 at all other nodes; valid until the next call."""
        self._all[self._nodes] = in_space(values)
        return self._scatter.forward(self._all)

    def add(self, total: Floats, dofs: Ints, values: Floats) -> None:
        """Add values on the scatter's map, ``(*dofs.shape, 3)``, to the values of the nodes."""
        sums = np.zeros_like(self._all)
        self._scatter.add(sums, dofs, values)
        total += sums[self._nodes, : total.shape[1]]


class _Rows(NamedTuple):
    """Rows of one pair, restricted to free nodes and scaled to gradients of length 1.

    Attributes:
        nodes: Exchange of nodal vectors.
        which: Range of these rows among the rows of all pairs.
        dofs: Nodes with nonzero entries, shape ``(m, k)``.
        gradient, force: Shape ``(m, k, 3)``.
    """

    nodes: _SomeNodes
    which: slice
    dofs: Ints
    gradient: Floats
    force: Floats


class GapConstraints:
    """Constraints G x = opening on nodal vectors x. Collective, as are its methods.

    They are solved in the least-squares sense, so they may be redundant or contradictory. In the
    plane nodal vectors have two components, and rows normal to it have no effect.

    Args:
        comm: Communicator.
        constraints: Gap and slip constraints of each pair.
        nodes: Owned nodes that may move, shape ``(n,)``; nodal vectors refer to them.
        free: 1 in free components, otherwise 0, shape ``(n, d)``.
        stiffness: Stiffness of the nodes, which defines orthogonality, shape ``(n, 1)`` [N/m].

    Attributes:
        slides: Whether a sliding node has friction, on any rank.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        constraints: Sequence[PairConstraints],
        nodes: Ints,
        free: Floats,
        stiffness: Floats,
    ) -> None:
        self._comm, self._root, self._shape = comm, np.sqrt(stiffness), free.shape
        weight = free / self._root
        self._rows: list[_Rows] = []
        openings, slides, end = [np.empty(0)], False, 0
        for each in constraints:
            shape = (*each.dofs.shape, 3)
            gradient, force = each.gradient.reshape(shape), each.force.reshape(shape)
            slides |= not np.array_equal(gradient, force)
            some = _SomeNodes(each.scatter, nodes)
            left = gradient * some.forward(free)[each.dofs]
            weights = some.forward(weight)[each.dofs]
            is_free = _length(left) > _NO_FREEDOM * _length(gradient)
            length = np.where(is_free, _length(weights * gradient), np.inf)
            scaled = weights / length[:, None, None]
            # Most nodes of a row belong to the segments, which are fixed.
            moves = scaled.any(axis=2)
            first = np.argsort(~moves, axis=1, kind="stable")
            first = first[:, : moves.sum(axis=1).max(initial=0)]
            begin, end = end, end + len(each.dofs)
            self._rows.append(
                _Rows(
                    some,
                    slice(begin, end),
                    np.take_along_axis(each.dofs, first, axis=1),
                    np.take_along_axis(scaled * gradient, first[:, :, None], axis=1),
                    np.take_along_axis(scaled * force, first[:, :, None], axis=1),
                )
            )
            openings.append(each.opening / length)
        self._opening = np.concatenate(openings)
        ones = [rows.gradient.any(axis=2, keepdims=True) * np.ones(3) for rows in self._rows]
        most = self._sum(ones, np.ones(len(self._opening))).max(initial=0.0)
        self._share_no_nodes = bool(reductions.largest(comm, float(most)) <= 1)
        self.slides = reductions.anywhere(comm, slides)
        exists = reductions.anywhere(comm, len(self._opening) > 0)
        self._passes = _SLIDING_PASSES if self.slides else int(exists)

    def shortest(self) -> Floats:
        """Shortest least-squares solution x, shape ``(n, d)`` [m]."""
        if not reductions.anywhere(self._comm, bool(self._opening.any())):
            return np.zeros(self._shape)
        x, _ = self._least_squares(self._times, self._transposed, self._opening)
        x /= self._root
        return x

    def project(self, forces: Floats) -> Floats:
        """Remove constraint forces from forces ``(n, d)`` [N], in place."""
        columns = [rows.force for rows in self._rows]
        # Friction is nearly orthogonal to all gradients, so each pass reduces the remainder.
        for _ in range(self._passes):
            scaled = forces / self._root
            multipliers, left = self._least_squares(self._transposed, self._times, scaled)
            if self.slides:
                forces -= self._root * self._sum(columns, multipliers)
            else:
                np.multiply(self._root, left, out=forces)
        return forces

    def _times(self, x: Floats) -> Floats:
        """Products of the gradients with nodal values ``(n, d)``, shape ``(m,)``."""
        products = np.empty(len(self._opening))
        for rows in self._rows:
            values = rows.nodes.forward(x)[rows.dofs]
            np.einsum("mki,mki->m", rows.gradient, values, out=products[rows.which])
        return products

    def _transposed(self, multipliers: Floats) -> Floats:
        """Sum of gradients times multipliers, ``(m,)``, at the nodes, ``(n, d)``."""
        return self._sum([rows.gradient for rows in self._rows], multipliers)

    def _sum(self, vectors: Sequence[Floats], multipliers: Floats) -> Floats:
        """Sum of vectors of all pairs times multipliers, ``(m,)``, at the nodes, ``(n, d)``."""
        total: Floats = np.zeros(self._shape)
        for rows, some in zip(self._rows, vectors, strict=True):
            rows.nodes.add(total, rows.dofs, multipliers[rows.which, None, None] * some)
        return total

    def _least_squares(
        self,
        times: Callable[[Floats], Floats],
        transposed: Callable[[Floats], Floats],
        b: Floats,
    ) -> tuple[Floats, Floats]:
        """Solve A x = b by conjugate gradients; the shortest x, and b - A x."""
        s = transposed(b)
        if self._share_no_nodes:  # A has orthonormal rows or columns: no iteration.
            return s, b - times(s)
        r = b.copy()
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
        return x, r

    def _dot(self, a: Floats, b: Floats) -> float:
        return reductions.total(self._comm, float(np.vdot(a, b)))


def _length(rows: Floats) -> Floats:
    """Euclidean lengths of rows of shape ``(m, k, 3)``, ``(m,)``."""
    length: Floats = np.sqrt(np.einsum("mki,mki->m", rows, rows))
    return length
