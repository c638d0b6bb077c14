"""The way of supports in a solution without inertia: bodies go with them, part by part.

Displacements that are given at once, with those of all other nodes as before, crush or tear the
cells at supports, and near incompressibility Newton's method does not find its way back. Here the
part that is yet to come belongs to the linear systems, so that its increments carry the bodies
along. Where these would strain cells by too much, supports go a part of their way, and wait
until the bodies are near equilibrium.
"""

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk

__all__ = ["SupportWay", "behind", "largest_strain"]

# Largest change of displacements within a cell in an increment with moving supports, relative to
# the size of the cell [-].
_LARGEST_STRAIN = 0.05
# Residual, relative to what the way that is left would add to it [-], at which supports go on.
_FOLLOWED = 1e-4
# Parts of the way [-]: a rest for which nothing waits, as the forces that it would add are lost in
# the round-off of the residual; and one that is none.
_REST, _ROUND_OFF = 1e-6, 1e-12
# The same of an increment that takes supports on [-].
_ADVANCE = 1e-2


class SupportWay:
    """What supports have still to go in a solution. Collective, as all its methods.

    Args:
        bulk: Residual of the bodies; its ``u`` may be behind its conditions.

    Attributes:
        duration: Number of increments until the last one that took supports on by a part of
            their way that counts.
    """

    def __init__(self, bulk: Bulk) -> None:
        """Find how far supports are behind."""
        self._bulk = bulk
        self._left = behind(bulk)
        self._length = self._largest(self._left)
        self._moves = False
        self._has_begun = False
        self.duration = self._increments = 0

    @property
    def is_over(self) -> bool:
        """Whether all displacements are as given. Local."""
        return self._left is None

    def pull(self, R: Floats, target: float) -> Floats:
        """Add the forces of supports that move in this iteration to a residual.

        Args:
            R: Residual on the owned dofs, of rigid bodies their balance, shape ``(d n,)`` [N].
            target: Norm of the residual of a solution [N], for which supports need not wait: where
                all of a body is led, they add no forces.
        """
        if self._left is None:
            return R
        forces = self._bulk.action(self._left, moves_given=True)
        forces = self._bulk.rigid.project(np.zeros_like(forces), forces).ravel()
        squares = reductions.total(self._bulk.comm, np.array([R @ R, forces @ forces]))
        has_followed = squares[0] <= max(_FOLLOWED**2 * squares[1], target**2)
        is_rest = self._largest(self._left) <= _REST * self._length
        self._moves = bool(not self._has_begun or has_followed or is_rest)
        self._has_begun = True
        return R + forces if self._moves else R

    def follow(self, du: Floats) -> Floats:
        """Increment of all nodes, shape ``(d n,)`` [m], with that of supports in its place."""
        if self._left is None or not self._moves:
            return du
        du = du + self._left.ravel()
        strain = largest_strain(self._bulk, du)
        return du if strain <= _LARGEST_STRAIN else _LARGEST_STRAIN / strain * du

    def go(self) -> None:
        """Note what is left after an increment of ``u``."""
        self._increments += 1
        if self._left is None or not self._moves:
            return
        before = self._largest(self._left)
        self._left = behind(self._bulk)
        left = self._largest(self._left)
        if before - left > _ADVANCE * self._length:
            self.duration = self._increments
        if left <= _ROUND_OFF * self._length:
            u = self._bulk.u.x.array
            u[:] = self._bulk.supports.applied(u)
            self._left = None

    def _largest(self, way: Floats | None) -> float:
        most = 0.0 if way is None else float(np.abs(way).max(initial=0.0))
        return reductions.largest(self._bulk.comm, most)


def behind(bulk: Bulk) -> Floats | None:
    """Displacements by which u is behind its conditions. Collective.

    Returns:
        Values at the owned nodes, shape ``(n, d)`` [m]; None where u is as given.
    """
    if not bulk.supports.exist:
        return None
    u = bulk.u.x.array
    way = (bulk.supports.applied(u) - u)[: bulk.num_owned]
    is_there = reductions.anywhere(bulk.comm, bool(way.any()))
    return way.reshape(-1, bulk.rigid.dim) if is_there else None


def largest_strain(bulk: Bulk, du: Floats) -> float:
    """Largest change of an increment ``(d n,)`` [m] within a cell, by its size. Collective."""
    V = bulk.u.function_space
    field = fem.Function(V)
    field.x.array[: bulk.num_owned] = du
    field.x.scatter_forward()
    values = field.x.array.reshape(-1, dimension(V))[V.dofmap.list]
    X = V.tabulate_dof_coordinates()[V.dofmap.list]
    change, size = (np.ptp(of_cells, axis=1).max(axis=1) for of_cells in (values, X))
    return reductions.largest(bulk.comm, float((change / size).max(initial=0.0)))
