r"""Assembly: bulk forms and contact blocks in PETSc.

The unknowns of a Newton iteration are du (all nodes) and dlambda_N (active
pairs). Each rank's multipliers follow its displacements:

    [ K + sum lambda_N dF/dq   F ] [ du       ]     [ R              ]
    [ G^T                      0 ] [ dlambda_N ] = - [ g_N - g_ref    ]

with the contact force F of the step and the gap gradient G at its end; the
matrix is not symmetric.
"""

from collections.abc import Iterable, Sequence
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
from dolfinx_nts.loads import Supports

__all__ = ["JIT_OPTIONS", "Bulk", "SaddleSystem", "contact_residual"]

Floats = npt.NDArray[np.float64]

# As fast as -ffast-math but for the assumption that there are no NaNs.
JIT_OPTIONS = {
    "cffi_extra_compile_args": [
        "-O3",
        "-march=native",
        "-ffp-contract=fast",
        "-fno-math-errno",
        "-fno-trapping-math",
        "-fno-signed-zeros",
        "-fassociative-math",
    ]
}


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
        nodal_size: Largest diameter of the cells of each owned node [m].
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
        self._tangent = _compile(ufl.derivative(form, u, ufl.TrialFunction(V)) for form in forms)
        self._action = _compile(ufl.derivative(form, u, self._direction) for form in forms)
        self._vector = la.vector(V.dofmap.index_map, 3)
        self.num_owned = 3 * V.dofmap.index_map.size_local
        self._matrix: Any = None
        mesh = V.mesh
        index_map = mesh.topology.index_map(3)
        cells = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
        h = mesh.h(3, cells)
        self.cell_size = float(mesh.comm.allreduce(h.min(initial=np.inf), op=MPI.MIN))
        size = np.zeros(self._vector.array.size // 3)
        np.maximum.at(size, V.dofmap.list, h[:, None])
        self.nodal_size: Floats = size[: self.num_owned // 3]
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
        matrix = self.tangent() if self._matrix is None else self._matrix
        mean: Floats = matrix.getDiagonal().array.reshape(-1, 3).mean(axis=1)
        total, count = self.comm.allreduce(np.array([np.abs(mean).sum(), len(mean)]))
        stiffness: Floats = np.maximum(mean, 0.1 * total / count)
        return stiffness

    def tangent(self) -> Any:
        """Tangent matrix at u, unit rows where u is given. Collective."""
        if self._matrix is None:
            self._matrix = fem_petsc.create_matrix(self._tangent[0], "baij")
        self._matrix.zeroEntries()
        for form in self._tangent:
            # The last form has left unit rows, which are not added to.
            self._matrix.assemble(PETSc.Mat.AssemblyType.FLUSH)
            fem_petsc.assemble_matrix(self._matrix, form, bcs=self.bcs)
        self._matrix.assemble()
        self.num_tangents += 1
        return self._matrix

    def _assembled(self, forms: Sequence[fem.Form]) -> Floats:
        """Sum of linear forms on the owned dofs, a copy."""
        self._vector.array[:] = 0
        for form in forms:
            fem.assemble_vector(self._vector.array, form)
        self._vector.scatter_reverse(la.InsertMode.add)
        values: Floats = self._vector.array[: self.num_owned].copy()
        return values


def _compile(forms: Iterable[ufl.Form]) -> list[fem.Form]:
    """Compile forms, leaving out those without integrals."""
    expanded = (expand_derivatives(form) for form in forms)
    return [fem.form(form, jit_options=JIT_OPTIONS) for form in expanded if not form.empty()]


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
