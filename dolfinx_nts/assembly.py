r"""Assembly: bulk forms and contact blocks in PETSc.

The unknowns of a Newton iteration are du (all nodes) and dlambda_N (active
pairs). Each rank's multipliers follow its displacements:

    [ K + sum lambda_N dF/dq   F ] [ du       ]     [ R              ]
    [ G^T                      0 ] [ dlambda_N ] = - [ g_N - g_ref    ]

with the contact force F of the step and the gap gradient G at its end; the
matrix is not symmetric.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from dolfinx.fem import petsc as fem_petsc
from ufl.algorithms import expand_derivatives

from dolfinx_nts.contact_rows import ContactState
from dolfinx_nts.contact_step import ContactStep
from dolfinx_nts.forms import compile_form
from dolfinx_nts.loads import Supports

__all__ = ["Bulk", "SaddleSystem", "contact_residual"]

Floats = npt.NDArray[np.float64]

# Compliance of a constraint, relative to that of the stiffest node.
_DEPENDENT = 1e-10


class Bulk:
    """Residual and tangent of the bodies for one step of a scheme.

    Args:
        residual: Residual form, linear in the test function [N].
        u: Unknown displacement, a coefficient of the form.
        bcs: Dirichlet conditions on u.
        loads: Virtual work of loads, each linear in the test function [N].

    Attributes:
        u: The unknown.
        supports: The conditions.
        fixed: Owned scalar dofs with a Dirichlet condition, sorted.
        cell_size: Smallest cell diameter of the mesh [m].
        point: Values of all functions and constants of the tangent when
            it was last assembled; None before.
        num_residuals: Assembled residuals.
        num_actions: Assembled actions of the tangent.
        num_tangents: Assembled tangents.
    """

    def __init__(
        self,
        residual: ufl.Form,
        u: fem.Function,
        bcs: Sequence[fem.DirichletBC],
        loads: Sequence[ufl.Form] = (),
    ) -> None:
        """Compile the forms and allocate."""
        V = u.function_space
        self.comm: MPI.Comm = V.mesh.comm
        self.u, self.bcs = u, list(bcs)
        self.supports = Supports(V, bcs)
        self.supports.check()
        self.fixed = self.supports.fixed
        self._direction = fem.Function(V)
        forms = [residual, *(-load for load in loads)]
        self._residual = _compile(forms)
        tangents = [ufl.derivative(form, u, ufl.TrialFunction(V)) for form in forms]
        self._tangent = _compile(tangents)
        self._inputs = _inputs(tangents)
        self.point: Sequence[npt.NDArray[Any]] | None = None
        self._action = _compile(ufl.derivative(form, u, self._direction) for form in forms)
        self._vector = la.vector(V.dofmap.index_map, 3)
        self.num_owned = 3 * V.dofmap.index_map.size_local
        self._rows: BlockRows | None = None
        self._matrix: Any = None
        self._stiffness: Floats | None = None
        mesh = V.mesh
        cells = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
        smallest = mesh.h(3, cells).min(initial=np.inf)
        self.cell_size = float(mesh.comm.allreduce(smallest, op=MPI.MIN))
        self.num_residuals = self.num_actions = self.num_tangents = 0

    def residual(self) -> Floats:
        """Residual at u on the owned dofs, 0 where u is given [N].

        Collective.
        """
        R = self.forces()
        R[self.fixed] = 0
        return R

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
        direction = self._direction.x
        direction.array[: self.num_owned] = x.ravel()
        direction.array[self.fixed] = 0
        direction.scatter_forward()
        self.num_actions += 1
        y = self._assembled(self._action)
        y[self.fixed] = x.ravel()[self.fixed]
        return y.reshape(-1, 3)

    def nodal_stiffness(self) -> Floats:
        """Mean diagonal entry of the last tangent at each owned node [N/m].

        At strongly deformed nodes it can be small or negative; a weight
        must be neither, so it is at least a tenth of the global mean.
        Collective.
        """
        if self._stiffness is None:
            self.tangent()
        assert self._stiffness is not None
        return self._stiffness

    def tangent(self) -> Any:
        """Tangent matrix at u, unit rows where u is given. Collective.

        Returns:
            PETSc matrix of 3 x 3 blocks; `rows` has the same values.
        """
        if self._rows is None:
            self._rows = BlockRows(fem.create_matrix(self._tangent[0]))
            self._matrix = fem_petsc.create_matrix(self._tangent[0], "baij")
        csr = self._rows.matrix
        csr.set_value(0.0)
        for form in self._tangent:
            fem.assemble_matrix(csr, form, self.bcs)
        csr.scatter_reverse()
        self._rows.insert(self._matrix)
        mean = self._rows.diagonal().mean(axis=1)
        total, count = self.comm.allreduce(np.array([np.abs(mean).sum(), len(mean)]))
        self._stiffness = np.maximum(mean, 0.1 * total / count)
        self.num_tangents += 1
        self.point = [array.copy() for array in self._inputs]
        return self._matrix

    @contextmanager
    def at(self, point: Sequence[npt.NDArray[Any]]) -> Iterator[None]:
        """Context in which functions and constants have other values. Local.

        Args:
            point: A former `point`.
        """
        present = [array.copy() for array in self._inputs]
        _set(self._inputs, point)
        try:
            yield
        finally:
            _set(self._inputs, present)

    def forget(self) -> None:
        """Be as before the first tangent. Local."""
        self.point = self._stiffness = None

    def rigid_modes(self) -> Any:
        """Rigid motions of the present positions, a PETSc null space. Collective."""
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
    def rows(self) -> "BlockRows":
        """Owned rows of the last tangent."""
        assert self._rows is not None
        return self._rows

    def _assembled(self, forms: Sequence[fem.Form]) -> Floats:
        """Sum of linear forms on the owned dofs, a copy."""
        self._vector.array[:] = 0
        for form in forms:
            fem.assemble_vector(self._vector.array, form)
        self._vector.scatter_reverse(la.InsertMode.add)
        values: Floats = self._vector.array[: self.num_owned].copy()
        return values


class BlockRows:
    """Owned rows of a matrix of 3 x 3 blocks, as DOLFINx stores it.

    Args:
        matrix: Matrix in compact blocks.

    Attributes:
        matrix: The matrix.
        index_map: Of the rows.
        start: Where each row begins, and the end, shape ``(n + 1,)``.
        column: Local column of each block, shape ``(b,)``.
        value: Blocks by rows, shape ``(9 b,)``.
    """

    def __init__(self, matrix: la.MatrixCSR) -> None:
        """Take views on the owned rows."""
        self.matrix = matrix
        self.index_map = matrix.index_map(0)
        n = self.index_map.size_local
        self.start: npt.NDArray[np.int64] = matrix.indptr[: n + 1]
        self.column: npt.NDArray[np.int32] = matrix.indices[: self.start[n]]
        self.value: Floats = matrix.data[: 9 * self.start[n]]
        columns = matrix.index_map(1)
        self._global = columns.local_to_global(self.column).astype(PETSc.IntType)
        row = np.repeat(np.arange(n), np.diff(self.start))
        self._diagonal = np.flatnonzero(row == self.column)

    def diagonal(self) -> Floats:
        """Entries on the diagonal, shape ``(n, 3)``. Local."""
        return self.value.reshape(-1, 9)[self._diagonal, ::4]

    def insert(self, matrix: Any) -> None:
        """Copy the values to a PETSc matrix of the same pattern. Collective."""
        start = self.start.astype(PETSc.IntType)
        matrix.setValuesBlockedCSR(start, self._global, self.value)
        matrix.assemble()

    def gather(
        self, nodes: npt.NDArray[np.int64], ends: npt.NDArray[np.int64]
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Floats]:
        """Rows of any nodes. Collective.

        Args:
            nodes: Global numbers, sorted, shape ``(m,)``.
            ends: First number after those of each rank, shape ``(ranks,)``.

        Returns:
            Where each row begins and the end, shape ``(m + 1,)``; global
            columns, shape ``(b,)``; blocks, shape ``(9 b,)``.
        """
        comm = self.index_map.comm
        asked = comm.alltoall(np.split(nodes, np.searchsorted(nodes, ends[:-1])))
        answers = []
        for wanted in asked:
            row = wanted - self.index_map.local_range[0]
            length = self.start[row + 1] - self.start[row]
            begin = np.cumsum(length) - length
            blocks = np.arange(length.sum()) + np.repeat(self.start[row] - begin, length)
            answers.append((length, self._global[blocks], self.value.reshape(-1, 9)[blocks]))
        parts = comm.alltoall(answers)
        length, column, value = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        start = np.concatenate([[0], np.cumsum(length)])
        return start, column.astype(np.int64), value.ravel()


def _compile(forms: Iterable[ufl.Form]) -> list[fem.Form]:
    """Compile forms, leaving out those without integrals."""
    expanded = (expand_derivatives(form) for form in forms)
    return [compile_form(form) for form in expanded if not form.empty()]


def _inputs(forms: Sequence[ufl.Form]) -> list[npt.NDArray[Any]]:
    """Values of all functions and constants of forms, which they share."""
    expanded = [expand_derivatives(form) for form in forms]
    functions = dict.fromkeys(f for form in expanded for f in form.coefficients())
    constants = dict.fromkeys(c for form in expanded for c in form.constants())
    return [*(f.x.array for f in functions), *(c.value for c in constants)]


def _set(arrays: Sequence[npt.NDArray[Any]], values: Sequence[npt.NDArray[Any]]) -> None:
    for array, value in zip(arrays, values, strict=True):
        array[...] = value


def contact_residual(
    steps: Sequence[ContactStep], states: Sequence[ContactState], num_owned: int
) -> Floats:
    """Sum of lambda_N F on the owned dofs, shape (num_owned,) [N]. Collective."""
    total = np.zeros(num_owned)
    for step, state in zip(steps, states, strict=True):
        if step.num_active:
            here = step.neighbourhood
            total += here.to_owners(state.nodal_forces(here.num_local)).ravel()
    return total


class SaddleSystem:
    """The whole system, factorised by MUMPS.

    Args:
        bulk: Forms of the bodies.
    """

    def __init__(self, bulk: Bulk) -> None:
        """Keep the forms."""
        self._bulk = bulk

    def solve(
        self, R: Floats, steps: Sequence[ContactStep], states: Sequence[ContactState]
    ) -> tuple[Floats, list[Floats]]:
        """Newton increments. Collective.

        Args:
            R: Residual on the owned dofs [N].
            steps: Contact attempts.
            states: Their pairs.

        Returns:
            du on the owned dofs [m], and the increments of the multipliers
            of each state, constraint by constraint [N].
        """
        comm = self._bulk.comm
        K = self._bulk.tangent()
        # Constraints that given displacements make dependent stay solvable;
        # multipliers converge with Newton's iteration, so nothing is lost.
        compliance = _DEPENDENT / float(self._bulk.nodal_stiffness().max(initial=1e-300))
        compliance = comm.allreduce(compliance, op=MPI.MIN)
        first, last = K.getOwnershipRange()
        counts = [int(state.rank.sum()) for state in states]
        num_local = np.array(comm.allgather((last - first, sum(counts))))
        u_start = np.concatenate([[0], np.cumsum(num_local[:, 0])])
        shift = np.concatenate([[0], np.cumsum(num_local[:, 1])])

        def saddle(dofs: npt.NDArray[Any]) -> npt.NDArray[np.int32]:
            """Number in the saddle system of displacement dofs."""
            rank = np.searchsorted(u_start, dofs, side="right") - 1
            return np.asarray(dofs + shift[rank], dtype=np.int32)

        n = last - first + sum(counts)
        A = PETSc.Mat().create(comm)
        A.setSizes(((n, None), (n, None)))
        A.setType("aij")
        A.setUp()
        copy = K.convert("aij", PETSc.Mat())
        indptr, columns, values = copy.getValuesCSR()
        copy.destroy()
        rows = (np.arange(first, last) + shift[comm.rank]).astype(np.int32)
        A.setValuesIJV(indptr, saddle(columns), values, addv=True, rowmap=rows)
        multiplier = last + int(shift[comm.rank])
        right = np.empty(n)
        right[: last - first] = -R
        for step, state in zip(steps, states, strict=True):
            active = np.flatnonzero(state.active)
            nodes = step.neighbourhood.index_map.local_to_global(state.dofs[active].ravel())
            dofs = saddle((3 * nodes[:, None] + np.arange(3)).ravel())
            dofs = dofs.reshape(len(active), state.residual.shape[1])
            for i, pair_dofs in zip(active, dofs, strict=True):
                A.setValues(pair_dofs, pair_dofs, state.tangent[i], addv=True)
                for a in range(state.rank[i]):
                    A.setValues(pair_dofs, multiplier, state.columns[i, a], addv=True)
                    A.setValues(multiplier, pair_dofs, state.gradients[i, a], addv=True)
                    A.setValue(multiplier, multiplier, -compliance, addv=True)
                    right[multiplier - first - shift[comm.rank]] = -state.excess[i, a]
                    multiplier += 1
        A.assemble()

        x, b = A.createVecs()
        b.array[:] = right
        ksp = PETSc.KSP().create(comm)
        ksp.setOperators(A)
        ksp.setType("preonly")
        ksp.getPC().setType("lu")
        ksp.getPC().setFactorSolverType("mumps")
        ksp.solve(b, x)
        solution = x.array.copy()
        for item in (ksp, A, b, x):
            item.destroy()
        du, dlambda = np.split(solution, [last - first])
        return du, np.split(dlambda, np.cumsum(counts)[:-1]) if counts else []
