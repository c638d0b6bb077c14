"""Factors of a whole system get as much memory as their pivots need."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

from dolfinx_nts.solvers.linear.reduced_systems import solved
from dolfinx_nts.solvers.precond import mumps


def constrained(n, m, rng):
    """Matrix of n soft springs in series with m constraints and a nearly vanishing diagonal."""
    soft = 1e-6 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    gradients = np.eye(m, n)
    rows, columns = np.repeat(np.arange(m), 3), rng.integers(0, n, 3 * m)
    np.add.at(gradients, (rows, columns), rng.normal(size=3 * m))
    return np.block([[soft, gradients.T], [gradients, -1e-14 * np.eye(m)]])


def as_sparse(A):
    """Convert the matrix to PETSc."""
    rows, columns = np.nonzero(A)
    start = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=len(A)))])
    csr = start.astype(np.int32), columns.astype(np.int32), A[rows, columns]
    matrix = PETSc.Mat().createAIJ(A.shape, csr=csr, comm=MPI.COMM_SELF)
    matrix.assemble()
    return matrix


@pytest.mark.serial
@pytest.mark.parametrize(("n", "m"), [(300, 200), (300, 290)])
def test_systems_of_many_constraints_are_solved(n, m):
    # The memory estimate of MUMPS suffices for the first matrix, not for the second.
    rng = np.random.default_rng(0)
    A, x = constrained(n, m, rng), rng.normal(size=n + m)
    matrix = as_sparse(A)
    assert solved(matrix, A @ x) == pytest.approx(x, abs=1e-6)
    matrix.destroy()


@pytest.mark.serial
def test_factors_without_memory_fail_and_signs_are_of_eigenvalues(monkeypatch):
    A = constrained(300, 290, np.random.default_rng(0))
    matrix = as_sparse(A)
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    pc = mumps.factorised(matrix, is_symmetric=True)
    assert mumps.signs(pc) == (np.count_nonzero(np.linalg.eigvalsh(A) < 0), 0)
    pc.destroy()
    monkeypatch.setattr(mumps, "_ROOM", (0,))
    pc = mumps.factorised(matrix, is_symmetric=True)
    assert mumps.signs(pc) is None
    for item in (pc, matrix):
        item.destroy()
