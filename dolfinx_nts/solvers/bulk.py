"""Assembly: the forms of the bodies, and the forces of contact."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.fem import petsc as fem_petsc
from ufl.algorithms import expand_derivatives

from dolfinx_nts.common.arrays import Array, Floats, Ints
from dolfinx_nts.fem.jit import compile_form
from dolfinx_nts.fem.linear_forms import CellForm, PackedForm
from dolfinx_nts.model.dirichlet import Supports
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.block_csr import BlockCSR

__all__ = ["Bulk"]

LinearForm = CellForm | PackedForm


class Bulk:
    """Residual and tangent of the bodies for one step of a scheme.

    Args:
        residual: Residual form, linear in the test function [N].
        u: Unknown displacement, a coefficient of the form.
        bcs: Dirichlet conditions on u.
        loads: Virtual work of loads, each linear in the test function [N].
        nearby: Bilinear form near the tangent that is definite whatever
            the state, for preconditioners; None: the tangent itself.

    Attributes:
        u: The unknown.
        supports: The conditions.
        fixed: Owned scalar dofs with a Dirichlet condition, sorted.
        num_owned, num_dofs: Scalar dofs of this rank, and of all.
        cell_size: Smallest cell diameter of the mesh [m].
        num_cells: Owned cells that residual and action go over.
        nodal_size: Largest diameter of the cells of each owned node [m].
        point: What `restore` needs to make the last matrix again: the values
            of all functions and constants in the forms; None before.
        num_residuals: Assembled residuals.
        num_actions: Assembled actions of the tangent.
        num_tangents: Assembled matrices.
    """

    def __init__(
        self,
        residual: ufl.Form,
        u: fem.Function,
        bcs: Sequence[fem.DirichletBC],
        loads: Sequence[ufl.Form] = (),
        nearby: ufl.Form | None = None,
    ) -> None:
        """Compile the forms and allocate."""
        V = u.function_space
        self.comm: MPI.Comm = V.mesh.comm
        self.u, self.bcs = u, list(bcs)
        self.supports = Supports(V, bcs)
        self.supports.check()
        self.fixed = self._given = self.supports.fixed
        self._direction = fem.Function(V)
        forms = [residual, *(-load for load in loads)]
        actions = [ufl.derivative(form, u, self._direction) for form in forms]
        # First the form of the bodies, then those of the loads.
        self._bodies = [CellForm(expand_derivatives(some[0])) for some in (forms, actions)]
        self._residual, self._action = (
            _with_loads(body, some[1:])
            for body, some in zip(self._bodies, (forms, actions), strict=True)
        )
        self._derivatives = [ufl.derivative(form, u, ufl.TrialFunction(V)) for form in forms]
        self._tangent: list[fem.Form] = []
        self._nearby = None if nearby is None else _compile([nearby])
        self._inputs = _inputs([*forms, *([] if nearby is None else [nearby])])
        self.point: Sequence[Array] | None = None
        self._vector = la.vector(V.dofmap.index_map, 3)
        # Asking for an array takes 2 us each time.
        self._towards: Floats = self._direction.x.array
        self._local: Floats = self._vector.array
        self.num_owned = 3 * V.dofmap.index_map.size_local
        self.num_dofs = 3 * V.dofmap.index_map.size_global
        self._rows: BlockCSR | None = None
        self._pattern: fem.Form  # has that of all matrices
        self._matrix: Any = None
        self._stiffness: Floats | None = None
        mesh = V.mesh
        index_map = mesh.topology.index_map(3)
        self.num_cells = self._all_cells = int(index_map.size_local)
        cells = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
        h = mesh.h(3, cells)
        self.cell_size = float(reductions.least(mesh.comm, h.min(initial=np.inf)))
        size = np.zeros(self._local.size // 3)
        np.maximum.at(size, V.dofmap.list, h[:, None])
        self.nodal_size: Floats = size[: self.num_owned // 3]
        self.num_residuals = self.num_actions = self.num_tangents = 0

    def residual(self) -> Floats:
        """Residual at u on the owned dofs, 0 where u is given [N].

        Collective.
        """
        R = self.forces()
        R[self._given] = 0
        return R

    def leave_out(self, cells: Ints, nodes: Ints) -> None:
        """Give nodes their present displacement until the next call.

        The residual and the action of the tangent are then assembled on
        the other cells only. Local.

        Args:
            cells: Owned cells left out.
            nodes: Owned nodes that are only in cells left out.
        """
        for form in self._bodies:
            form.leave_out(cells)
        self.num_cells = self._all_cells - len(cells)
        dofs = (3 * nodes[:, None] + np.arange(3, dtype=np.int32)).ravel()
        self._given = np.union1d(self.fixed, dofs)

    def forces(self) -> Floats:
        """Residual at u on the owned dofs, given or not [N]. Collective."""
        self.num_residuals += 1
        return self._assembled(self._residual)

    def load(self) -> Floats:
        """Forces of the loads at u on the owned dofs [N]. Collective."""
        return -self._assembled(self._residual[1:])

    def action(self, x: Floats) -> Floats:
        """Tangent at u times a nodal vector, identity where u is given.

        Collective.

        Args:
            x: Values at the owned nodes, shape ``(n, 3)`` [m].

        Returns:
            Values at the owned nodes, shape ``(n, 3)`` [N].
        """
        direction, given = self._towards, self._given
        direction[: self.num_owned] = x.ravel()
        direction[given] = 0
        self._direction.x.scatter_forward()
        self.num_actions += 1
        y = self._assembled(self._action)
        y[given] = x.ravel()[given]
        return y.reshape(-1, 3)

    def nodal_stiffness(self) -> Floats:
        """Mean diagonal entry of the last tangent at each owned node [N/m].

        At strongly deformed nodes it can be small or negative; a weight
        must be neither, so it is at least a tenth of the global mean.
        Collective.
        """
        if self._stiffness is None:
            self.assemble_nearby()
        assert self._stiffness is not None
        return self._stiffness

    def assemble_nearby(self) -> None:
        """Bring `rows` up to the matrix near the tangent at u. Collective.

        It is to be factorised and kept for many steps.
        """
        if self._nearby is None:
            self._assemble_tangent()
        else:
            self._assemble(self._nearby, is_exact=False)

    def tangent(self) -> Any:
        """Tangent matrix at u, unit rows where u is given. Collective.

        Returns:
            As of `matrix`.
        """
        self._assemble_tangent()
        return self.matrix()

    def matrix(self) -> Any:
        """Copy of `rows` for PETSc, made when first asked for. Collective.

        Returns:
            PETSc matrix of 3 x 3 blocks, always the same one.
        """
        if self._matrix is None:
            self._matrix = fem_petsc.create_matrix(self._pattern, "baij")
        self.rows.insert(self._matrix)
        return self._matrix

    def _assemble_tangent(self) -> None:
        if not self._tangent:
            # Its kernels are the longest to compile, and few runs need them.
            self._tangent = _compile(self._derivatives)
        self._assemble(self._tangent, is_exact=True)

    def _assemble(self, forms: Sequence[fem.Form], *, is_exact: bool) -> None:
        if self._rows is None:
            self._pattern = forms[0]
            self._rows = BlockCSR(fem.create_matrix(self._pattern))
        csr = self._rows.matrix
        csr.set_value(0.0)
        for form in forms:
            fem.assemble_matrix(csr, form, self.bcs)
        csr.scatter_reverse()
        mean = self._rows.diagonal().mean(axis=1)
        total, count = reductions.total(self.comm, [np.abs(mean).sum(), len(mean)])
        self._stiffness = np.maximum(mean, 0.1 * total / count)
        self.num_tangents += 1
        self.point = [np.array(is_exact), *(array.copy() for array in self._inputs)]

    def restore(self, point: Sequence[Array]) -> None:
        """Make a former matrix again. Collective.

        Args:
            point: The `point` that it left.
        """
        with self.at(point):
            if point[0]:
                self._assemble_tangent()
            else:
                self.assemble_nearby()

    @contextmanager
    def at(self, point: Sequence[Array]) -> Iterator[None]:
        """Context in which functions and constants have other values. Local.

        Args:
            point: A former `point`.
        """
        present = [array.copy() for array in self._inputs]
        _set(self._inputs, point[1:])
        try:
            yield
        finally:
            _set(self._inputs, present)

    def forget(self) -> None:
        """Be as before the first tangent. Local."""
        self.point = self._stiffness = None

    def rigid_modes(self) -> Any:
        """Rigid motions of the present positions, a PETSc null space. Collective.

        For `matrix`, which must have been made.
        """
        V = self.u.function_space
        n = self.num_owned // 3
        x = V.tabulate_dof_coordinates()[:n] + self.u.x.array[: 3 * n].reshape(n, 3)
        modes = np.concatenate(
            [np.repeat(np.eye(3)[:, None], n, axis=1), np.cross(np.eye(3)[:, None], x)]
        )
        vectors: list[Any] = []
        for mode in modes:
            vector = self._matrix.createVecRight()
            vector.array[:] = mode.ravel()
            for other in vectors:
                vector.axpy(-vector.dot(other), other)
            vector.normalize()
            vectors.append(vector)
        return PETSc.NullSpace().create(vectors=vectors, comm=self.comm)

    @property
    def rows(self) -> BlockCSR:
        """Owned rows of the last matrix."""
        assert self._rows is not None
        return self._rows

    def _assembled(self, forms: Sequence[LinearForm]) -> Floats:
        """Sum of linear forms on the owned dofs, a copy."""
        self._local.fill(0.0)
        for form in forms:
            form.assemble(self._local)
        self._vector.scatter_reverse(la.InsertMode.add)
        values: Floats = self._local[: self.num_owned].copy()
        return values


def _with_loads(bodies: CellForm, loads: Iterable[ufl.Form]) -> list[LinearForm]:
    """The form of the bodies, then those of loads that have integrals."""
    return [bodies, *map(PackedForm, _expanded(loads))]


def _compile(forms: Iterable[ufl.Form]) -> list[fem.Form]:
    """Compile forms, leaving out those without integrals."""
    return [compile_form(form) for form in _expanded(forms)]


def _expanded(forms: Iterable[ufl.Form]) -> Iterator[ufl.Form]:
    """Those that have integrals once their derivatives are taken."""
    return (form for form in map(expand_derivatives, forms) if not form.empty())


def _inputs(forms: Sequence[ufl.Form]) -> list[Array]:
    """Values of all functions and constants of forms, which they share."""
    functions = dict.fromkeys(f for form in forms for f in form.coefficients())
    constants = dict.fromkeys(c for form in forms for c in form.constants())
    return [*(f.x.array for f in functions), *(c.value for c in constants)]


def _set(arrays: Sequence[Array], values: Sequence[Array]) -> None:
    for array, value in zip(arrays, values, strict=True):
        array[...] = value
