"""Work of the stress of a step in the cells at a surface."""

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.solvers.nodal_sum import NodalSum

__all__ = ["SurfaceWork"]


class SurfaceWork:
    """Work of the forces of a step in some cells.

    With conserving stress it is the change of energy in the cells plus their dissipation.

    Args:
        residual: Forces of bodies without inertia, linear in the test function [N].
        u_n: Displacement at the start of a step, a coefficient of the form.
        u: Displacement at its end.
        cells: Owned cells, sorted.
    """

    def __init__(self, residual: ufl.Form, u_n: fem.Function, u: fem.Function, cells: Ints) -> None:
        V = u.function_space
        topology = V.mesh.topology
        owned = topology.index_map(topology.dim).size_local
        self._forces = NodalSum([expand_derivatives(residual)], V)
        self._forces.leave_out(np.setdiff1d(np.arange(owned, dtype=np.int32), cells))
        self._ends, self._dim = (u_n.x.array, u.x.array), dimension(V)

    def at_nodes(self) -> Floats:
        """Contributions of the owned nodes to the work, shape ``(n,)`` [J]. Collective."""
        forces = self._forces.assembled()
        u_n, u = (end[: len(forces)] for end in self._ends)
        work: Floats = (forces * (u - u_n)).reshape(-1, self._dim).sum(axis=1)
        return work
