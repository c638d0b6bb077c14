"""Static equilibrium of nodes without mass, while all others stay where they are.

Each of these nodes hangs on others that do not move, so that conjugate gradients need few
iterations, whatever the size of the surface.
"""

from collections.abc import Callable, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.gap_constraints import GapConstraints, KeptGaps
from dolfinx_nts.solvers.shells import shell_matrix, use_shell
from dolfinx_nts.solvers.surface_forces import SurfaceForces

__all__ = ["SurfaceEquilibrium"]

# Reduction of the residual [-]: the next step goes on with what is left. Less of it changes the
# displacement of an impact by a thousandth of the error of the time step at most, and takes more
# iterations.
_REDUCTION = 5e-2
_MAX_ITERATIONS = 200
# Residual, relative to the stiffness of a node times the size of its displacement [-], that is
# round-off.
_ROUND_OFF = 16 * np.finfo(np.float64).eps


class SurfaceEquilibrium:
    """Finds the displacement of nodes without mass. Collective, as are its methods.

    Args:
        forces: Forces between u_n and u of bodies without inertia at the m nodes without mass,
            conserving ones. With u_n = u they are those of statics.
        u_n: Displacement at the start of a step.
        share: Derivative of the forces by u, as a part of that of statics [-].
        stiffness: That of these nodes, for the preconditioner, shape ``(m,)`` [N/m].
        resistance: What resists as the nodes move, by its derivative where u_n is u, if anything.

    Attributes:
        nodes: Those without mass.
    """

    def __init__(
        self,
        forces: SurfaceForces,
        u_n: fem.Function,
        share: float,
        stiffness: Floats,
        resistance: SurfaceForces | None = None,
    ) -> None:
        """Make Krylov methods on the nodes."""
        self._forces, self._u, self._u_n = forces, forces.u.x, u_n.x.array
        self._comm, self.nodes, self._share = forces.comm, forces.nodes, share
        n = forces.free.size
        self._stiffness, self._resistance = stiffness[:, None], resistance
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

    def find(
        self,
        holds: Sequence[KeptGaps],
        affordable: Callable[[Floats], Floats],
        damping: Floats | float,
    ) -> Floats:
        """Solve for increments of the nodes without mass, shape ``(m, d)`` [m].

        It is one step of Newton's method from u. Nodes that nothing holds are free; where the
        surface is about to buckle it is a step towards less energy.

        Args:
            holds: What the nodes keep, pair by pair.
            affordable: Returns the parts of the ways of these nodes that they go, by the energy
                that these ways exchange at most, both of shape ``(m,)`` [-, J].
            damping: Forces that damp the motion of the nodes, shape ``(m, d)`` [N].
        """
        u_n = self._u_n.copy()
        self._u_n[:] = self._u.array
        try:
            return self._find(holds, affordable, damping)
        finally:
            self._u_n[:] = u_n

    def _find(
        self,
        holds: Sequence[KeptGaps],
        affordable: Callable[[Floats], Floats],
        damping: Floats | float,
    ) -> Floats:
        r = -self._forces.at_nodes()
        self._held = GapConstraints(
            self._comm, holds, self.nodes, self._forces.free, self._stiffness
        )
        x = self._held.shortest()
        if reductions.anywhere(self._comm, bool(x.any())):
            Kx = self._static(x)
            costs = np.abs((r - damping) * x).sum(axis=1) + np.abs(Kx * x).sum(axis=1) / 2
            x *= affordable(costs)[:, None]
            r -= self._times(x)
        size = reductions.largest(self._comm, _kernels.largest_size(self._u.array))
        floor = _ROUND_OFF * size * self._stiffness
        least = float(np.sqrt(reductions.total(self._comm, float(np.vdot(floor, floor)))))
        self._b.array[:] = self._held.project(r).ravel()
        # Friction that scales with normal forces is not symmetric.
        ksp = self._krylov["gmres" if self._held.slides else "cg"]
        ksp.setTolerances(rtol=_REDUCTION, atol=least, max_it=_MAX_ITERATIONS)
        # Where the surface is about to buckle it ends with the last iterate, which is kept.
        ksp.solve(self._b, self._x)
        x += self._x.array.reshape(x.shape)
        return x

    def mult(self, _matrix: Any, x: Any, y: Any) -> None:
        """Multiply by the stiffness where nodes are free; called by PETSc."""
        y.array[:] = self._held.project(self._times(self._rows(x))).ravel()

    def apply(self, _pc: Any, r: Any, z: Any) -> None:
        """Divide by the stiffness of each node, which keeps gaps; called by PETSc."""
        z.array[:] = (self._rows(r) / self._stiffness).ravel()

    def _rows(self, x: Any) -> Floats:
        """Values of a vector node by node, shape ``(m, d)``."""
        rows: Floats = x.array_r.reshape(self._forces.free.shape)
        return rows

    def _times(self, x: Floats) -> Floats:
        """Stiffness of statics, and what resists, times increments."""
        y = self._static(x)
        if self._resistance is not None:
            y += self._resistance.along(x)
        return y

    def _static(self, x: Floats) -> Floats:
        """Stiffness of statics times increments."""
        y = self._forces.along(x)
        y /= self._share
        return y
