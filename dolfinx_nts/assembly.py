r"""Assembly: bulk forms and contact blocks in PETSc.

The unknowns of a Newton iteration are du (all nodes) and dlambda_N (active
pairs). Each rank's multipliers follow its displacements:

    [ K + sum lambda_N dF/dq   F ] [ du       ]     [ R              ]
    [ G^T                      0 ] [ dlambda_N ] = - [ g_N - g_ref    ]

with the contact force F of the step and the gap gradient G at its end; the
matrix is not symmetric.
"""

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from dolfinx.fem import petsc as fem_petsc

from dolfinx_nts.contact import ContactState, ContactStep

__all__ = ["JIT_OPTIONS", "Bulk", "SaddleSolver"]

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


class Bulk:
    """Residual and tangent of the bodies for one step of a scheme.

    Args:
        residual: Residual form, linear in the test function [N].
        u: Unknown displacement, a coefficient of the form.
        bcs: Dirichlet conditions on u.

    Attributes:
        u: The unknown.
        fixed: Owned scalar dofs with a Dirichlet condition, sorted.
        cell_size: Smallest cell diameter of the mesh [m].
        num_residuals: Assembled residuals.
        num_tangents: Assembled tangents.
    """

    def __init__(
        self, residual: ufl.Form, u: fem.Function, bcs: Sequence[fem.DirichletBC]
    ) -> None:
        """Compile the forms and allocate."""
        V = u.function_space
        self.u, self.bcs = u, list(bcs)
        self._residual = fem.form(residual, jit_options=JIT_OPTIONS)
        self._tangent = fem.form(
            ufl.derivative(residual, u, ufl.TrialFunction(V)), jit_options=JIT_OPTIONS
        )
        self._vector = la.vector(V.dofmap.index_map, 3)
        self._num_owned = 3 * V.dofmap.index_map.size_local
        self._matrix: Any = None
        owned = [bc.dof_indices()[0][: bc.dof_indices()[1]] for bc in self.bcs]
        self.fixed = np.unique(np.concatenate([np.empty(0, dtype=np.int32), *owned]))
        mesh = V.mesh
        cells = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
        smallest = mesh.h(3, cells).min(initial=np.inf)
        self.cell_size = float(mesh.comm.allreduce(smallest, op=MPI.MIN))
        self.num_residuals = self.num_tangents = 0

    def residual(self) -> Floats:
        """Residual at u on the owned dofs, 0 where u is given [N].

        Collective.
        """
        self._vector.array[:] = 0
        fem.assemble_vector(self._vector.array, self._residual)
        self._vector.scatter_reverse(la.InsertMode.add)
        self.num_residuals += 1
        R = self._vector.array[: self._num_owned].copy()
        R[self.fixed] = 0
        return R

    def nodal_stiffness(self) -> Floats:
        """Mean diagonal entry of the last tangent at each owned node [N/m].

        Collective.
        """
        matrix = self.tangent() if self._matrix is None else self._matrix
        mean: Floats = matrix.getDiagonal().array.reshape(-1, 3).mean(axis=1)
        return mean

    def tangent(self) -> Any:
        """Tangent matrix at u, unit rows where u is given. Collective."""
        if self._matrix is None:
            self._matrix = fem_petsc.create_matrix(self._tangent)
        self._matrix.zeroEntries()
        fem_petsc.assemble_matrix(self._matrix, self._tangent, bcs=self.bcs)
        self._matrix.assemble()
        self.num_tangents += 1
        return self._matrix


def contact_residual(steps: Sequence[ContactStep], states: Sequence[ContactState]) -> Floats:
    """Contact forces on the owned dofs, sum of lambda_N F [N]. Collective."""
    total = 0.0
    for step, state in zip(steps, states, strict=True):
        index_map = step.neighbourhood.index_map
        forces = state.nodal_forces(state.lambda_N, index_map.size_local + index_map.num_ghosts)
        total = total + step.neighbourhood.to_owners(forces).ravel()
    return total


class SaddleSolver:
    """Direct solver of the whole system.

    Args:
        comm: Communicator.
        fixed: Owned scalar dofs with a Dirichlet condition.
    """

    def __init__(self, comm: MPI.Comm, fixed: npt.NDArray[np.int32]) -> None:
        """Keep what does not change."""
        self._comm = comm
        self._fixed = fixed

    def solve(
        self, K: Any, R: Floats, steps: Sequence[ContactStep], states: Sequence[ContactState]
    ) -> tuple[Floats, list[Floats]]:
        """Newton increments. Collective.

        Args:
            K: Bulk tangent.
            R: Residual on the owned dofs [N].
            steps: Contact attempts.
            states: Their pairs.

        Returns:
            du on the owned dofs [m], and dlambda_N of the active pairs
            of each state [N].
        """
        first, last = K.getOwnershipRange()
        counts = [int(np.count_nonzero(state.active)) for state in states]
        num_local = np.array(self._comm.allgather((last - first, sum(counts))))
        u_start = np.concatenate([[0], np.cumsum(num_local[:, 0])])
        shift = np.concatenate([[0], np.cumsum(num_local[:, 1])])

        def saddle(dofs: npt.NDArray[Any]) -> npt.NDArray[np.int32]:
            rank = np.searchsorted(u_start, dofs, side="right") - 1
            return (dofs + shift[rank]).astype(np.int32)

        fixed = np.zeros(u_start[-1], dtype=bool)
        fixed[np.concatenate(self._comm.allgather(first + self._fixed))] = True

        n = last - first + sum(counts)
        A = PETSc.Mat().create(self._comm)
        A.setSizes(((n, None), (n, None)))
        A.setType("aij")
        A.setUp()
        indptr, columns, values = K.getValuesCSR()
        rows = np.arange(first, last) + shift[self._comm.rank]
        A.setValuesIJV(
            indptr, saddle(columns), values, addv=True, rowmap=rows.astype(np.int32)
        )
        multiplier = last + shift[self._comm.rank]
        right = np.empty(n)
        right[: last - first] = -R
        for step, state in zip(steps, states, strict=True):
            size = state.force.shape[1]
            nodes = step.neighbourhood.index_map.local_to_global(state.dofs[state.active].ravel())
            dofs = (3 * nodes[:, None] + np.arange(3)).reshape(-1, size)
            free = ~fixed[dofs]
            dofs = saddle(dofs)
            for j, i in enumerate(np.flatnonzero(state.active)):
                f = free[j]
                block = state.lambda_N[i] * state.tangent[i] * np.outer(f, f)
                A.setValues(dofs[j], dofs[j], block, addv=True)
                A.setValues(dofs[j], multiplier, state.force[i] * f, addv=True)
                A.setValues(multiplier, dofs[j], state.gradient[i] * f, addv=True)
                A.setValue(multiplier, multiplier, 0.0, addv=True)
                right[multiplier - first - shift[self._comm.rank]] = -state.excess[i]
                multiplier += 1
        A.assemble()

        b = A.createVecLeft()
        b.array[:] = right
        ksp = PETSc.KSP().create(self._comm)
        ksp.setOperators(A)
        ksp.setType("preonly")
        ksp.getPC().setType("lu")
        ksp.getPC().setFactorSolverType("mumps")
        x = A.createVecRight()
        ksp.solve(b, x)
        solution = x.array.copy()
        for item in (ksp, A, b, x):
            item.destroy()
        bounds = last - first + np.concatenate([[0], np.cumsum(counts)])
        dlambda = [solution[a:b] for a, b in zip(bounds[:-1], bounds[1:], strict=True)]
        return solution[: last - first], dlambda
