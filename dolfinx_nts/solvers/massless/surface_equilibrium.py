"""Static equilibrium of massless nodes, with all other nodes fixed.

Each massless node is connected to fixed nodes, so conjugate gradients need few iterations for any
size of the surface.
"""

from collections.abc import Callable, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.linear.shells import shell_matrix, use_shell
from dolfinx_nts.solvers.massless.gap_constraints import GapConstraints, PairConstraints
from dolfinx_nts.solvers.massless.surface_forces import SurfaceForces

__all__ = ["SurfaceEquilibrium"]

# Reduction of the residual [-]; the next step removes the remainder. Smaller: displacements in an
# impact change by at most 0.1 % of the time discretisation error, with more iterations.
_REDUCTION = 5e-2
_MAX_ITERATIONS = 200
# Round-off of the residual, relative to the stiffness of a node times its displacement [-].
_ROUND_OFF = 16 * np.finfo(np.float64).eps


class SurfaceEquilibrium:
    """Solves for the displacement of massless nodes. Collective, as are its methods.

    Args:
        forces: Conserving forces between u_n and u, without inertia, at the m massless nodes. With
            u_n = u they are static forces.
        u_n: Displacement at the start of a step.
        share: Ratio of the derivative of the forces with respect to u to the static stiffness [-].
        stiffness: Stiffness of these nodes, for the preconditioner, shape ``(m,)`` [N/m].
        resistance: Additional resistance of the nodes, by its derivative at u_n = u, if any.

    Attributes:
        nodes: The massless nodes.
    """

    def __init__(
        self,
        forces: SurfaceForces,
        u_n: fem.Function,
        share: float,
        stiffness: Floats,
        resistance: SurfaceForces | None = None,
    ) -> None:
        self._forces, self._u, self._u_n = forces, forces.u.x, u_n.x.array
        self._comm, self.nodes, self._share = forces.comm, forces.nodes, share
        n = forces.free.size
        self._stiffness, self._resistance = stiffness[:, None], resistance
        matrix = shell_matrix(self._comm, (n, None), self)
        matrix.setUp()
        self._krylov = {name: self._solver(matrix, name) for name in ("cg", "gmres")}
        self._x, self._b = matrix.createVecs()

    def _solver(self, matrix: Any, name: str) -> Any:
        """Create a Krylov method with unpreconditioned residual norms."""
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
        constraints: Sequence[PairConstraints],
        affordable: Callable[[Floats], Floats],
        damping: Floats | float,
    ) -> Floats:
        """Solve for increments of the massless nodes, shape ``(m, d)`` [m].

        The result is one Newton iteration from u. Nodes without constraints are free. If the
        stiffness is indefinite, the increment still decreases the energy.

        Args:
            constraints: Constraints of the nodes, pair by pair.
            affordable: Returns the admissible fractions of the prescribed increments, given an
                upper bound on the energy that they exchange, both of shape ``(m,)`` [-, J].
            damping: Forces that damp the motion of the nodes, shape ``(m, d)`` [N].
        """
        u_n = self._u_n.copy()
        self._u_n[:] = self._u.array
        try:
            return self._find(constraints, affordable, damping)
        finally:
            self._u_n[:] = u_n

    def _find(
        self,
        constraints: Sequence[PairConstraints],
        affordable: Callable[[Floats], Floats],
        damping: Floats | float,
    ) -> Floats:
        r = -self._forces.at_nodes()
        self._constraints = GapConstraints(
            self._comm, constraints, self.nodes, self._forces.free, self._stiffness
        )
        x = self._constraints.shortest()
        if reductions.anywhere(self._comm, bool(x.any())):
            Kx = self._static(x)
            costs = np.abs((r - damping) * x).sum(axis=1) + np.abs(Kx * x).sum(axis=1) / 2
            x *= affordable(costs)[:, None]
            r -= self._times(x)
        size = reductions.largest(self._comm, _kernels.largest_size(self._u.array))
        floor = _ROUND_OFF * size * self._stiffness
        least = float(np.sqrt(reductions.total(self._comm, float(np.vdot(floor, floor)))))
        self._b.array[:] = self._constraints.project(r).ravel()
        # The friction of sliding nodes makes the system nonsymmetric.
        ksp = self._krylov["gmres" if self._constraints.slides else "cg"]
        ksp.setTolerances(rtol=_REDUCTION, atol=least, max_it=_MAX_ITERATIONS)
        # If the stiffness is indefinite, the last iterate is kept.
        ksp.solve(self._b, self._x)
        x += self._x.array.reshape(x.shape)
        return x

    def mult(self, _matrix: Any, x: Any, y: Any) -> None:
        """Multiply by the projected stiffness; called by PETSc."""
        y.array[:] = self._constraints.project(self._times(self._rows(x))).ravel()

    def apply(self, _pc: Any, r: Any, z: Any) -> None:
        """Divide by the nodal stiffness, which preserves the constraints; called by PETSc."""
        z.array[:] = (self._rows(r) / self._stiffness).ravel()

    def _rows(self, x: Any) -> Floats:
        """Values of a vector by nodes, shape ``(m, d)``."""
        rows: Floats = x.array_r.reshape(self._forces.free.shape)
        return rows

    def _times(self, x: Floats) -> Floats:
        """Product of increments with static stiffness and additional resistance."""
        y = self._static(x)
        if self._resistance is not None:
            y += self._resistance.along(x)
        return y

    def _static(self, x: Floats) -> Floats:
        """Product of increments with the static stiffness."""
        y = self._forces.along(x)
        y /= self._share
        return y
