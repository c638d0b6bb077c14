"""Matrix of the tangent of the bodies, for preconditioners."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import cpp, fem, la
from ufl.algorithms import expand_derivatives

from dolfinx_nts.common.arrays import Array, Floats, Ints
from dolfinx_nts.fem.bilinear_forms import CellMatrix, compiled_matrix
from dolfinx_nts.fem.cell_constant import changing
from dolfinx_nts.fem.components import in_space, nodal
from dolfinx_nts.fem.jit import compile_bilinear_form
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.dirichlet import Supports
from dolfinx_nts.solvers.linear.block_csr import BlockCSR
from dolfinx_nts.solvers.precond.nodal_stiffness import NEARBY_SHIFT, AddedStiffness, NodalStiffness

__all__ = ["Tangent", "TangentOfAllCells"]


class Tangent(AddedStiffness):
    """Matrix of the derivative of a residual, or of a nearby bilinear form.

    Args:
        residual: Residual form, linear in the test function [N].
        u: Unknown displacement, a coefficient of the form.
        bcs: Dirichlet conditions on u.
        loads: Virtual work of loads, each linear in the test function [N].
        nearby: Approximation of the derivative by a bilinear form that is definite in any state,
            for preconditioners; None for the derivative itself.
        bodies: Nodes of each body, see `NodalStiffness`.

    Attributes:
        comm: Communicator of the mesh.
        shift, num_free, drag, in_addition: See `AddedStiffness`.
        num_assembled: Number of assembled matrices, which identifies the values of the last one.
        point: State from which `restore` assembles the last matrix again: values of functions and
            constants in the forms; None before the first matrix.
    """

    def __init__(
        self,
        residual: ufl.Form,
        u: fem.Function,
        bcs: Sequence[fem.DirichletBC],
        loads: Sequence[ufl.Form] = (),
        nearby: ufl.Form | None = None,
        bodies: Sequence[Ints] = (),
    ) -> None:
        super().__init__()
        self.comm: MPI.Comm = u.function_space.mesh.comm
        self._u, self._supports = u, Supports(u.function_space, bcs)
        forms = [residual, *(-load for load in loads)]
        trial = ufl.TrialFunction(u.function_space)
        self._derivatives = [ufl.derivative(form, u, trial) for form in forms]
        self._exact: list[fem.Form] = []
        self._nearby = None if nearby is None else CellMatrix(expand_derivatives(nearby))
        self._inputs = _inputs(forms if nearby is None else [*forms, nearby])
        self._rows: BlockCSR | None = None
        self._stiffness = NodalStiffness(u.function_space, self._supports.fixed, bodies)
        self.point: Sequence[Array] | None = None
        self.num_assembled = 0

    @property
    def rows(self) -> BlockCSR:
        """Owned rows of the last matrix, unit rows where u is prescribed."""
        assert self._rows is not None
        return self._rows

    @property
    def num_unknowns(self) -> int:
        """Number of rows on all ranks. Local."""
        dofmap = self._u.function_space.dofmap
        return int(dofmap.index_map.size_global * dofmap.index_map_bs)

    @property
    def X(self) -> Floats:
        """Reference positions of the owned nodes, shape ``(n, 3)`` [m]. Local."""
        X: Floats = reference_positions(self._u.function_space)
        return X[: self.rows.index_map.size_local]

    def nodal_stiffness(self) -> Floats:
        """Mean diagonal entry of the last matrix at each owned node [N/m]. Collective."""
        if self._stiffness.values is None:
            self.assemble_nearby()
        assert self._stiffness.values is not None
        return self._stiffness.values

    def assemble_nearby(self) -> None:
        """Assemble the definite approximation ``nearby`` of the derivative at u. Collective."""
        if self._nearby is not None:
            self._assemble([self._nearby.compiled], is_exact=False)
        else:
            self.assemble_exact()

    def assemble_exact(self) -> None:
        """Assemble the derivative at u. Collective."""
        if not self._exact:
            # Compiled on demand: it takes the longest time to compile, and few runs need it.
            self._exact = _compiled(self._derivatives)
        self._assemble(self._exact, is_exact=True)

    def matrix(self, *, scalar: bool) -> Any:
        """PETSc matrix with a copy of the last matrix. Collective.

        Args:
            scalar: Whether entries are scalars, which all of PETSc supports, or nodal blocks. A
                scalar matrix has the rigid motions at the current positions as its near null space,
                for multigrid.
        """
        matrix = self.rows.petsc()
        if scalar:
            matrix.convert("aij")
            matrix.setNearNullSpace(self._rigid_motions(matrix))
        return matrix

    def restore(self, point: Sequence[Array]) -> None:
        """Assemble a former matrix again. Collective.

        Args:
            point: Its `point`.
        """
        with self.at(point):
            if point[0]:
                self.assemble_exact()
            else:
                self.assemble_nearby()

    @contextmanager
    def at(self, point: Sequence[Array]) -> Iterator[None]:
        """Context in which functions and constants have the values of a former matrix. Local.

        Args:
            point: Its `point`.
        """
        present = [array.copy() for array in self._inputs]
        _set(self._inputs, point[1:])
        try:
            yield
        finally:
            _set(self._inputs, present)

    def clamp(self, nodes: Ints) -> Floats:
        """Clamp owned nodes in all matrices from now on. Collective.

        Returns:
            Clamping stiffness in matrices near the derivative, shape ``(m, 1)`` [N/m].
        """
        self._stiffness.leave_out(nodes)
        stiffness = self.nodal_stiffness()[:, None]
        clamping = self._stiffness.clamping = np.zeros_like(stiffness)
        clamping[nodes] = stiffness[nodes]
        self.forget()
        clamping_nearby: Floats = NEARBY_SHIFT * clamping[nodes]
        return clamping_nearby

    @property
    def clamping(self) -> Floats | float:
        """Clamping stiffness of the nodes passed to `clamp`, shape as for `shift`."""
        return self._stiffness.clamping

    def forget(self) -> None:
        """Discard the last matrix. Local."""
        self.point = self._stiffness.values = None

    def _rigid_motions(self, matrix: Any) -> Any:
        """Near null space of a matrix: rigid motions at the current positions. Collective."""
        n, dim = self.rows.index_map.size_local, self.rows.dim
        x = reference_positions(self._u.function_space) + in_space(nodal(self._u))
        axes = np.eye(3)[:, None]
        turns = np.cross(axes, x[:n])[:, :, :dim]
        modes = np.concatenate(
            [np.repeat(axes[:dim, :, :dim], n, axis=1), turns if dim == 3 else turns[2:]]
        )
        vectors: list[Any] = []
        for mode in modes:
            vector = matrix.createVecRight()
            vector.array[:] = mode.ravel()
            for other in vectors:
                vector.axpy(-vector.dot(other), other)
            vector.normalize()
            vectors.append(vector)
        return PETSc.NullSpace().create(vectors=vectors, comm=matrix.comm)

    def _created(self, form: fem.Form) -> la.MatrixCSR:
        """Matrix with the sparsity of a form. Collective."""
        return fem.create_matrix(form)

    def _add_to(self, rows: BlockCSR) -> Floats | float:
        """Add terms without a form to a matrix; return their nodal stiffness [N/m]. Local."""
        return 0.0

    def _assemble(self, forms: Sequence[fem.Form], *, is_exact: bool) -> None:
        if self._rows is None:
            self._rows = BlockCSR(self._created(forms[0]))
        csr = self._rows.matrix
        csr.set_value(0.0)
        for form in forms:
            _add(form, csr, self._supports.conditions)
        csr.scatter_reverse()
        self._rows.set_diagonal(self._supports.fixed, 1.0)
        self._rows.add_to_diagonal(self.added(self.clamping, is_exact=is_exact))
        self.in_addition = self.added(0.0, is_exact=is_exact)
        stiffness = self._stiffness.of(self._rows)
        self._stiffness.values = stiffness + self._add_to(self._rows)
        self.num_assembled += 1
        self.point = [np.array(is_exact), *(array.copy() for array in self._inputs)]


class TangentOfAllCells(Tangent):
    """Tangent with the sparsity pattern of all cells, as loads may act on cells of rigid bodies."""

    def _created(self, form: fem.Form) -> la.MatrixCSR:
        V = self._u.function_space
        every = ufl.inner(ufl.TrialFunction(V), ufl.TestFunction(V)) * ufl.dx
        return fem.create_matrix(compile_bilinear_form(every))


def _add(form: fem.Form, matrix: la.MatrixCSR, bcs: Sequence[fem.DirichletBC]) -> None:
    """Add a form to a matrix, except in rows and columns of prescribed displacements. Local."""
    # `fem.assemble_matrix` would set the diagonal to one. It treats ghosts of constant conditions
    # as owned, which fails on meshes with ghost cells.
    given = (
        form._cpp_object,
        *(pack(form._cpp_object) for pack in (cpp.fem.pack_constants, cpp.fem.pack_coefficients)),
    )
    cpp.fem.assemble_matrix(matrix._cpp_object, *given, [bc._cpp_object for bc in bcs])


def _compiled(forms: Sequence[ufl.Form]) -> list[fem.Form]:
    """Compiled derivatives of residual and loads, without empty ones. Collective."""
    forms = list(map(expand_derivatives, forms))
    residual, *loads = forms
    of_loads = [compile_bilinear_form(form) for form in loads if not form.empty()]
    return of_loads if residual.empty() else [compiled_matrix(residual), *of_loads]


def _inputs(forms: Sequence[ufl.Form]) -> list[Array]:
    """Values of the functions and constants in forms that may change, as shared views."""
    functions = changing(dict.fromkeys(f for form in forms for f in form.coefficients()))
    constants = dict.fromkeys(c for form in forms for c in form.constants())
    return [*(f.x.array for f in functions), *(c.value for c in constants)]


def _set(arrays: Sequence[Array], values: Sequence[Array]) -> None:
    for array, value in zip(arrays, values, strict=True):
        array[...] = value
