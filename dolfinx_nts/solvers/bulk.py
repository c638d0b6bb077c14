"""Residual of the bodies, without contact, and the action of its derivative."""

from collections.abc import Callable, Iterable, Sequence

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import common, fem, la
from ufl.algorithms import expand_derivatives

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.linear_forms import CellForm, PackedForm
from dolfinx_nts.model.dirichlet import Supports

__all__ = ["Bulk"]


class Bulk:
    """Residual of the bodies in one step of a scheme, and its directional derivative.

    Args:
        residual: Residual form, linear in the test function [N].
        u: Unknown displacement, a coefficient of the form.
        bcs: Dirichlet conditions on u.
        loads: Virtual work of loads, each linear in the test function [N].

    Attributes:
        comm: Communicator of the mesh.
        u: The unknown.
        supports: The conditions.
        num_owned: Scalar dofs of this rank.
        num_cells: Owned cells that residual and action go over.
        given: Owned scalar dofs that residual and action take as given, sorted.
        stabilisation: What the action of the tangent has beside that of the forms, a function
            of a nodal vector.
    """

    def __init__(
        self,
        residual: ufl.Form,
        u: fem.Function,
        bcs: Sequence[fem.DirichletBC],
        loads: Sequence[ufl.Form] = (),
    ) -> None:
        """Create the compiled forms of the residual and of its derivative."""
        V = u.function_space
        self.comm: MPI.Comm = V.mesh.comm
        self.u = u
        self.supports = Supports(V, bcs)
        self.supports.check()
        self.given = self.fixed
        self._direction = fem.Function(V)
        # DOLFINx takes 2 us each time that it is asked for the array.
        self._direction_values: Floats = self._direction.x.array
        forms = [residual, *(-load for load in loads)]
        actions = [ufl.derivative(form, u, self._direction) for form in forms]
        nodes = V.dofmap.index_map
        self._residual, self._action = (_NodalSum(some, nodes) for some in (forms, actions))
        self.num_owned = 3 * nodes.size_local
        self._all_cells = int(V.mesh.topology.index_map(3).size_local)
        self.num_cells = self._all_cells
        self.stabilisation: Callable[[Floats], Floats] | None = None

    @property
    def fixed(self) -> Ints:
        """Owned scalar dofs with a Dirichlet condition, sorted."""
        fixed: Ints = self.supports.fixed
        return fixed

    @property
    def num_residuals(self) -> int:
        """Residuals assembled so far."""
        return self._residual.num_assembled

    @property
    def num_actions(self) -> int:
        """Actions of the derivative assembled so far."""
        return self._action.num_assembled

    def residual(self) -> Floats:
        """Residual at u on the owned dofs, 0 where u is given [N].

        Collective.
        """
        R = self.forces()
        R[self.given] = 0
        return R

    def leave_out(self, cells: Ints, nodes: Ints) -> None:
        """Give nodes their present displacement until the next call.

        The residual and the action of the tangent are then assembled on
        the other cells only. Local.

        Args:
            cells: Owned cells left out.
            nodes: Owned nodes that are only in cells left out.
        """
        for form in (self._residual, self._action):
            form.bodies.leave_out(cells)
        self.num_cells = self._all_cells - len(cells)
        dofs = (3 * nodes[:, None] + np.arange(3, dtype=np.int32)).ravel()
        self.given = np.union1d(self.fixed, dofs)

    def forces(self) -> Floats:
        """Residual at u on the owned dofs, given or not [N]. Collective."""
        return self._residual.assembled()

    def load(self) -> Floats:
        """Forces of the loads at u on the owned dofs [N]. Collective."""
        return -self._residual.assembled_loads()

    def action(self, x: Floats) -> Floats:
        """Tangent at u times a nodal vector, identity where u is given.

        Collective.

        Args:
            x: Values at the owned nodes, shape ``(n, 3)`` [m].

        Returns:
            Values at the owned nodes, shape ``(n, 3)`` [N].
        """
        direction, given = self._direction_values, self.given
        direction[: self.num_owned] = x.ravel()
        direction[given] = 0
        self._direction.x.scatter_forward()
        y = self._forces_by(direction[: self.num_owned])
        if self.stabilisation is not None:
            y += self.stabilisation(x).ravel()
        y[given] = x.ravel()[given]
        return y.reshape(-1, 3)

    def _forces_by(self, direction: Floats) -> Floats:
        """Derivative of the forces in the direction that is set, ``(3 n,)`` [m]. Collective."""
        return self._action.assembled()


class _NodalSum:
    """Sum of linear forms at the owned nodes, the first of bodies, others of loads.

    Args:
        forms: The form of the bodies, then those of the loads.
        index_map: That of the nodes.

    Attributes:
        bodies: The form of the bodies.
        num_assembled: Sums of all forms so far.
    """

    def __init__(self, forms: Sequence[ufl.Form], index_map: common.IndexMap) -> None:
        first, *loads = map(expand_derivatives, forms)
        self.bodies = CellForm(first)
        # Dead loads have no derivative.
        self._loads = [PackedForm(load) for load in loads if not load.empty()]
        self._vector = la.vector(index_map, 3)
        self._values: Floats = self._vector.array
        self._num_owned = 3 * index_map.size_local
        self.num_assembled = 0

    def assembled(self) -> Floats:
        """Sum of all forms, a copy. Collective."""
        self.num_assembled += 1
        return self._sum([self.bodies, *self._loads])

    def assembled_bodies(self) -> Floats:
        """The form of the bodies alone, a copy. Collective."""
        self.num_assembled += 1
        return self._sum([self.bodies])

    def assembled_loads(self) -> Floats:
        """Sum of the forms of the loads, a copy. Collective."""
        return self._sum(self._loads)

    def _sum(self, forms: Iterable[CellForm | PackedForm]) -> Floats:
        self._values.fill(0.0)
        for form in forms:
            form.assemble(self._values)
        self._vector.scatter_reverse(la.InsertMode.add)
        owned: Floats = self._values[: self._num_owned].copy()
        return owned
