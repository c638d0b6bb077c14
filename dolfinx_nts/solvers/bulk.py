"""Residual of the bodies, without contact, and the action of its derivative."""

import math
from collections.abc import Callable, Sequence
from functools import partial

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.linear_forms import Kernels
from dolfinx_nts.model.dirichlet import Supports
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.nodal_sum import NodalSum

__all__ = ["Bulk"]

# Kernels of actions that every run needs: those of most iterations, and others to judge them.
_PROMPT: tuple[Kernels, Kernels] = ("single", "slow")
# Cells of each material on which they are compared.
_SAMPLE = 512


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
        self._residual = NodalSum(forms, nodes)
        self._actions = {kernels: NodalSum(actions, nodes, kernels) for kernels in _PROMPT}
        self._new_action = partial(NodalSum, actions, nodes)
        self._left_out: Ints = np.empty(0, dtype=np.int32)
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
        return sum(action.num_assembled for action in self._actions.values())

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
        self._left_out = cells
        for form in (self._residual, *self._actions.values()):
            form.leave_out(cells)
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
        if "double" not in self._actions:
            # Few runs need it, and it takes time to compile.
            self._actions["double"] = self._new_action("double")
            self._actions["double"].leave_out(self._left_out)
        return self._along(x, "double")

    def rounded_action(self, x: Floats) -> Floats:
        """The same as `action` in single precision, where there are kernels for it. Collective."""
        return self._along(x, "single")

    def rounding(self, x: Floats) -> float:
        """Error of `rounded_action`, relative, on a sample of cells. Collective.

        It depends on the law, and on displacements in sizes of cells.

        Args:
            x: Values at the owned nodes, shape ``(n, 3)`` [m].
        """
        self._set_direction(x)
        rounded, exact = (self._actions[kernels].sample(_SAMPLE) for kernels in _PROMPT)
        error = rounded - exact
        squares = [float(error @ error), float(exact @ exact)]
        part, whole = reductions.total(self.comm, squares)
        return math.sqrt(part / whole) if whole > 0 else math.inf

    def _along(self, x: Floats, kernels: Kernels) -> Floats:
        self._set_direction(x)
        y = self._forces_by(self._actions[kernels], self._direction_values[: self.num_owned])
        if self.stabilisation is not None:
            y += self.stabilisation(x).ravel()
        y[self.given] = x.ravel()[self.given]
        return y.reshape(-1, 3)

    def _forces_by(self, action: NodalSum, direction: Floats) -> Floats:
        """Derivative of the forces in the direction that is set, ``(3 n,)`` [m]. Collective."""
        return action.assembled()

    def _set_direction(self, x: Floats) -> None:
        direction = self._direction_values
        direction[: self.num_owned] = x.ravel()
        direction[self.given] = 0
        self._direction.x.scatter_forward()
