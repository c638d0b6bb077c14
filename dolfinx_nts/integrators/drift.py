"""Motion of all nodes in an explicit step, by the velocity in the middle of it."""

import math
from collections.abc import Sequence

import numpy as np
from dolfinx import fem, la

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import dimension, nodal
from dolfinx_nts.integrators.rigid_leapfrog import RigidLeapfrog
from dolfinx_nts.model.dirichlet import Supports

__all__ = ["Drift"]


class Drift:
    """Moves the nodes from the start of a step to its end. Collective.

    Args:
        functions: Displacements at its start and its end, velocities at its start and in its
            middle.
        supports: Dirichlet conditions.
        rigid: Motion of the rigid bodies.
        ghosts: Vectors whose ghosts the forces need.

    Attributes:
        arrays: The four functions and the increment of the displacement, of the owned nodes,
            each of shape ``(n, d)``.
        given: Which displacements of the owned nodes are given, shape ``(n, d)``.
    """

    def __init__(
        self,
        functions: tuple[fem.Function, fem.Function, fem.Function, fem.Function],
        supports: Supports,
        rigid: RigidLeapfrog,
        ghosts: Sequence[la.Vector],
    ) -> None:
        u = functions[1]
        V = u.function_space
        self._u, self._ghosts = u.x.array, tuple(ghosts)
        n = V.dofmap.index_map.size_local
        u_n, end, v, rate = (nodal(f)[:n] for f in functions)
        self.arrays: tuple[Floats, ...] = (u_n, end, v, rate, np.empty_like(end))
        self._supports, self._rigid = supports, rigid
        self.given = np.zeros((n, dimension(V)), dtype=bool)
        self.given.ravel()[supports.fixed] = True

    def move(self, dt: float, a: Floats, forces: Floats, about: Floats) -> tuple[float, float, str]:
        """Set displacements at the end of a step and velocities in its middle.

        Args:
            dt: Length of the step [s].
            a: Accelerations at its start, shape ``(n, d)`` [m/s^2].
            forces: Forces at its start, shape ``(n, d)`` [N].
            about: Velocity about which motions are measured, shape ``(d,)`` [m/s].

        Returns:
            Largest motion of any node of this rank; its largest motion about that velocity, or
            the same again where supports or rigid bodies move too [m]; and why the step has to be
            refused, or "".
        """
        u_n, u, v, rate, du = self.arrays
        moved, relative = _kernels.drift(dt, v, a, rate, u, du, about)
        rigid, supports = self._rigid, self._supports
        if rigid.exists:
            if reason := rigid.drift(u_n, v, forces, dt, du):
                return 0.0, 0.0, reason
            nodes = rigid.nodes
            u[nodes], rate[nodes] = (u_n + du)[nodes], du[nodes] / dt
        if supports.exist:
            self._u[:] = supports.applied(self._u)
            np.subtract(u, u_n, out=du)
            rate[self.given] = du[self.given] / dt
        if rigid.exists or supports.exist:
            longest = float(np.linalg.norm(du, axis=1).max(initial=0.0))
            moved = relative = longest if math.isfinite(moved) else moved
        for ghosts in self._ghosts:
            ghosts.scatter_forward()
        # A maximum over ranks may ignore NaN, but not infinity.
        return (moved if math.isfinite(moved) else math.inf), relative, ""
