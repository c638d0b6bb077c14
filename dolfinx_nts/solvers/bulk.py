"""Residual of the bodies without contact, and its directional derivative."""

from collections.abc import Callable, Sequence

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.linear_forms import Kernels
from dolfinx_nts.model.dirichlet import Supports
from dolfinx_nts.solvers.derivative import Derivative
from dolfinx_nts.solvers.nodal_sum import NodalSum
from dolfinx_nts.solvers.rigid.rigid_motion import RigidMotion

__all__ = ["Bulk"]

_NONE: Ints = np.empty(0, dtype=np.int32)


class Bulk:
    """Residual of the bodies in one step of a scheme, and its directional derivative.

    Args:
        residual: Residual form, linear in the test function [N].
        u: Unknown displacement, a coefficient of the form.
        bcs: Dirichlet conditions on u.
        loads: Virtual work of loads, each linear in the test function [N].
        jumps: Whether the derivative is discontinuous, as at the onset of plastic flow.

    Attributes:
        comm: Communicator of the mesh.
        u: The unknown.
        forms: Residual form of the bodies, then the form of each load, with the sign of the
            residual.
        supports: The conditions.
        num_owned: Scalar dofs of this rank.
        num_cells: Owned cells on which residual and derivative are assembled.
        is_prescribed: Flags of the owned dofs with prescribed values, shape ``(d n,)``.
        stabilisation: Additional term of the tangent, a function of a nodal vector.
        rigid: Motion of the rigid bodies.
    """

    def __init__(
        self,
        residual: ufl.Form,
        u: fem.Function,
        bcs: Sequence[fem.DirichletBC],
        loads: Sequence[ufl.Form] = (),
        *,
        jumps: bool = False,
    ) -> None:
        V = u.function_space
        self.comm: MPI.Comm = V.mesh.comm
        self.u = u
        self.supports = Supports(V, bcs)
        self.supports.check()
        self.supports.warn_of_empty()
        self.forms = forms = (residual, *(-load for load in loads))
        nodes = V.dofmap.index_map
        self._residual = NodalSum([expand_derivatives(form) for form in forms], V)
        self._derivative = Derivative(forms, u, jumps=jumps)
        self._dim = dimension(V)
        self.num_owned = self._dim * nodes.size_local
        self.num_cells = int(V.mesh.topology.index_map(V.mesh.topology.dim).size_local)
        self._left_out: tuple[Ints, Ints] = _NONE, _NONE
        self.is_prescribed: Flags = self._prescribed_flags(_NONE)
        self.stabilisation: Callable[[Floats], Floats] | None = None
        self.rigid = RigidMotion(V)

    @property
    def num_assembled(self) -> tuple[int, int]:
        """Residuals, and actions of the derivative, assembled so far. Local."""
        return self._residual.num_assembled, self._derivative.num_assembled

    def leave_out(self, cells: Ints, nodes: Ints) -> tuple[Ints, Ints]:
        """Clamp nodes at their current displacement until the next call.

        Residual and derivative are then assembled only on the other cells. Local.

        Args:
            cells: Owned cells left out.
            nodes: Clamped owned nodes; these include all nodes without any other cell.

        Returns:
            The cells and nodes of the previous call.
        """
        self._residual.leave_out(cells)
        self._derivative.leave_out(cells)
        before, self._left_out = self._left_out, (cells, nodes)
        self.num_cells += len(before[0]) - len(cells)
        self.is_prescribed = self._prescribed_flags(nodes)
        return before

    def forces(self) -> Floats:
        """Residual at u on the owned dofs, also where u is prescribed [N]. Collective."""
        return self._residual.assembled()

    def loads(self) -> list[Floats]:
        """Forces of each load at u on the owned dofs [N]. Collective."""
        return [-load for load in self._residual.assembled_each_load()]

    def action(self, x: Floats, *, with_prescribed: bool = False) -> Floats:
        """Tangent at u times a nodal vector. Collective.

        Args:
            x: Values at the owned nodes, shape ``(n, d)`` [m].
            with_prescribed: Whether values of x at prescribed dofs act on other dofs; results at
                prescribed dofs are then zero. By default rows and columns of prescribed dofs are
                those of the identity.

        Returns:
            Values at the owned nodes, shape ``(n, d)`` [N].
        """
        if with_prescribed:
            direction = self._derivative.set_direction(x)
            forces = self._forces_by(self._derivative.with_kernels("slow"), direction)
            forces[self.is_prescribed] = 0
            return forces.reshape(-1, self._dim)
        return self._along(x, "double")

    def rounded_action(self, x: Floats) -> Floats:
        """`action` in single precision, unless the derivative is discontinuous.

        Collective.
        """
        return self._along(x, self._derivative.rounded)

    def rounding(self, x: Floats) -> float:
        """Relative round-off error of `rounded_action`. Collective."""
        self._derivative.set_direction(x, self.is_prescribed)
        return self._derivative.rounding()

    def _along(self, x: Floats, kernels: Kernels) -> Floats:
        direction = self._derivative.set_direction(x, self.is_prescribed)
        y = self._forces_by(self._derivative.with_kernels(kernels), direction)
        if self.stabilisation is not None:
            y += self.stabilisation(x).ravel()
        y[self.is_prescribed] = x.ravel()[self.is_prescribed]
        return y.reshape(-1, self._dim)

    def _prescribed_flags(self, nodes: Ints) -> Flags:
        """Flags of the owned dofs of given nodes and of supports, shape ``(d n,)``. Local."""
        nodal = np.zeros((self.num_owned // self._dim, self._dim), dtype=bool)
        nodal[nodes] = True
        flags: Flags = nodal.ravel()
        flags[self.supports.fixed] = True
        return flags

    def _forces_by(self, action: NodalSum, direction: Floats) -> Floats:
        """Derivative of the forces in the current direction ``(d n,)`` [m]. Collective."""
        return action.assembled()
