"""Static equilibrium of nodes without mass, while all others stay where they are.

Each of these nodes hangs on others that do not move, so that conjugate gradients need few
iterations, whatever the size of the surface.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem, la

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.held_gaps import HeldGaps, Holds
from dolfinx_nts.solvers.shells import shell_matrix, use_shell

__all__ = ["SurfaceEquilibrium"]

# Reduction of the residual [-]: what is left is of the size of what one step of Newton's method
# leaves, and the next step goes on with it.
_REDUCTION = 1e-2
_MAX_ITERATIONS = 200
# Residual, relative to the stiffness of a node times the size of its displacement [-], that is
# round-off.
_ROUND_OFF = 16 * np.finfo(np.float64).eps


class SurfaceEquilibrium:
    """Finds the displacement of nodes without mass. Collective, as are its methods.

    Args:
        bulk: Forces between u_n and u of bodies without inertia, conserving ones, used by nobody
            else. With u_n = u they are those of statics.
        u_n: Displacement at the start of a step.
        massless: The owned nodes, shape ``(m,)``.
        share: Derivative of the forces by u, as a part of that of statics [-].
    """

    def __init__(self, bulk: Bulk, u_n: fem.Function, massless: Ints, share: float) -> None:
        """Leave out all cells but those at the nodes."""
        V = u_n.function_space
        index_map = V.dofmap.index_map
        self._bulk, self._u, self._u_n, self._share = bulk, bulk.u.x, u_n.x.array, share
        self._comm: MPI.Comm = bulk.comm
        self.massless = massless
        marker = la.vector(index_map)
        marker.array[massless] = 1
        marker.scatter_forward()
        owned = V.mesh.topology.index_map(3).size_local
        beside = (marker.array[V.dofmap.list[:owned]] == 0).all(axis=1)
        others = np.setdiff1d(np.arange(index_map.size_local, dtype=np.int32), massless)
        bulk.leave_out(np.flatnonzero(beside).astype(np.int32), others)
        n = bulk.num_owned
        self._free: Floats = np.ones((n // 3, 3))
        self._free.ravel()[bulk.given] = 0
        self._stiffness: Floats = np.ones((n // 3, 1))
        matrix = shell_matrix(self._comm, (n, None), self)
        matrix.setUp()
        self._krylov = {name: self._solver(matrix, name) for name in ("cg", "gmres")}
        self._x, self._b = matrix.createVecs()

    def _solver(self, matrix: Any, name: str) -> Any:
        """Make a Krylov method that measures residuals as they are."""
        ksp = PETSc.KSP().create(self._comm)
        ksp.setOperators(matrix)
        ksp.setType(name)
        if name == "gmres":
            ksp.setPCSide(PETSc.PC.Side.RIGHT)
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        use_shell(ksp.getPC(), self)
        return ksp

    def find(self, holds: Sequence[Holds], stiffness: Floats) -> Floats:
        """Solve for increments of all owned nodes, shape ``(n, 3)`` [m].

        It is one step of Newton's method from u. Nodes that nothing holds are free; where the
        surface is about to buckle it is a step towards less energy.

        Args:
            holds: What the nodes keep, pair by pair.
            stiffness: That of the owned nodes, for the preconditioner, shape ``(n,)`` [N/m].
        """
        with self._start(self._u.array):
            return self._find(holds, stiffness[:, None])

    def _residual(self) -> Floats:
        """Residual of the bodies on the owned dofs, 0 where u is given [N]."""
        R = self._bulk.forces()
        R[self._bulk.given] = 0
        return R

    def work(self, u_before: Floats) -> Floats:
        """Strain energy that increments from a displacement to u gave, node by node.

        Args:
            u_before: Displacement of the local dofs before them, shape ``(3 l,)`` [m].

        Returns:
            Parts whose sum is the change of energy, shape ``(n,)`` [J].
        """
        n = self._bulk.num_owned
        with self._start(u_before):
            forces = self._residual()
        du = self._u.array[:n] - u_before[:n]
        work: Floats = (forces * du).reshape(-1, 3).sum(axis=1)
        return work

    @contextmanager
    def _start(self, u: Floats) -> Iterator[None]:
        """Context in which a step starts at a displacement."""
        u_n = self._u_n.copy()
        self._u_n[:] = u
        try:
            yield
        finally:
            self._u_n[:] = u_n

    def _find(self, holds: Sequence[Holds], stiffness: Floats) -> Floats:
        r: Floats = -self._residual().reshape(-1, 3)
        self._held = HeldGaps(self._comm, holds, self._free, stiffness)
        self._stiffness, x = stiffness, self._held.shortest()
        if reductions.anywhere(self._comm, bool(x.any())):
            r -= self._times(x)
        size = reductions.largest(self._comm, float(np.abs(self._u.array).max(initial=0.0)))
        floor = _ROUND_OFF * size * stiffness[self.massless]
        least = float(np.sqrt(reductions.total(self._comm, float(np.vdot(floor, floor)))))
        self._b.array[:] = self._held.project(r).ravel()
        # Friction that scales with normal forces is not symmetric.
        ksp = self._krylov["gmres" if self._held.slides else "cg"]
        ksp.setTolerances(rtol=_REDUCTION, atol=least, max_it=_MAX_ITERATIONS)
        # Where the surface is about to buckle it ends with the last iterate, which is kept.
        ksp.solve(self._b, self._x)
        x += self._x.array.reshape(-1, 3)
        return x

    def mult(self, _matrix: Any, x: Any, y: Any) -> None:
        """Multiply by the stiffness where nodes are free; called by PETSc."""
        y.array[:] = self._held.project(self._times(x.array_r.reshape(-1, 3))).ravel()

    def apply(self, _pc: Any, r: Any, z: Any) -> None:
        """Divide by the stiffness of each node, which keeps gaps; called by PETSc."""
        z.array[:] = (r.array_r.reshape(-1, 3) / self._stiffness).ravel()

    def _times(self, x: Floats) -> Floats:
        """Stiffness of statics times increments that are zero at all other nodes."""
        y = self._bulk.action(x)
        y /= self._share
        y.ravel()[self._bulk.given] = 0
        return y
