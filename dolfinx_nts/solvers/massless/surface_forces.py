"""Forces of bodies at some nodes, and their derivative with respect to these nodes."""

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, la
from ufl.algorithms import expand_derivatives

from dolfinx_nts.common.arrays import Floats, Ints, indices
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.solvers.nodal_sum import NodalSum

__all__ = ["SurfaceForces"]


class SurfaceForces:
    """Residual of bodies at some nodes, assembled on their cells only. Collective.

    Args:
        residual: Residual form of the bodies, linear in the test function [N].
        u: Displacement, a coefficient of the form.
        nodes: Owned nodes, shape ``(m,)``.
        fixed: Owned scalar dofs with prescribed u.

    Attributes:
        comm: Communicator of the mesh.
        u: Displacement.
        nodes: The argument.
        cells: Owned cells with at least one of the nodes.
        free: 1 in free components of the nodes, otherwise 0, shape ``(m, d)``.
    """

    def __init__(self, residual: ufl.Form, u: fem.Function, nodes: Ints, fixed: Ints) -> None:
        V = u.function_space
        index_map, self._dim = V.dofmap.index_map, dimension(V)
        self.comm: MPI.Comm = index_map.comm
        self.u, self.nodes = u, nodes
        self._direction = fem.Function(V)
        # Each access to the array of a DOLFINx Function takes 2 us.
        self._values = self._rows(self._direction.x.array)
        forms = residual, ufl.derivative(residual, u, self._direction)
        self._residual, self._derivative = (NodalSum([expand_derivatives(f)], V) for f in forms)
        marker = la.vector(index_map)
        marker.array[nodes] = 1
        marker.scatter_forward()
        topology = V.mesh.topology
        owned = topology.index_map(topology.dim).size_local
        touches = (marker.array[V.dofmap.list[:owned]] > 0).any(axis=1)
        self.cells: Ints = indices(touches)
        for form in (self._residual, self._derivative):
            form.leave_out(indices(~touches))
        free: Floats = np.ones((index_map.size_local, self._dim))
        free.ravel()[fixed] = 0
        self.free: Floats = free[nodes]

    def at_nodes(self) -> Floats:
        """Residual at u, 0 where u is prescribed, shape ``(m, d)`` [N]."""
        return self._of_nodes(self._residual)

    def along(self, x: Floats) -> Floats:
        """Derivative of the residual with respect to the nodes, times increments.

        Args:
            x: Increments of the nodes, shape ``(m, d)`` [m].

        Returns:
            Values at the nodes, 0 where u is prescribed, shape ``(m, d)`` [N].
        """
        self._values[self.nodes] = self.free * x
        self._direction.x.scatter_forward()
        return self._of_nodes(self._derivative)

    def _of_nodes(self, form: NodalSum) -> Floats:
        return self.free * self._rows(form.assembled())[self.nodes]

    def _rows(self, values: Floats) -> Floats:
        """Values of dofs by node, a view. Local."""
        return values.reshape(-1, self._dim)
