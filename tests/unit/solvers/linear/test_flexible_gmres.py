"""Iterations of flexible GMRES against least squares by NumPy."""

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_nts import _kernels
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.linear.petsc_krylov import PetscKrylov
from dolfinx_nts.solvers.linear.petsc_options import PetscOptions

NODES, DIM = 700, 2  # more numbers than one block holds, on one rank or on several
ROUNDING = 1e-11


def test_residuals_are_the_least_in_the_krylov_space(comm, rng):
    bounds = np.linspace(0, NODES, comm.size + 1).astype(int)
    own = slice(*bounds[comm.rank : comm.rank + 2])
    A = np.eye(NODES * DIM) + 0.1 * rng.normal(size=(NODES * DIM,) * 2) / np.sqrt(NODES * DIM)
    b = rng.normal(size=(NODES, DIM))

    def whole(x):
        return np.vstack(comm.allgather(x)).ravel()

    sums = None if comm.size == 1 else lambda values: reductions.total(comm, values)
    gmres = _kernels.FlexibleGmres(b[own], sums)
    np.testing.assert_allclose(gmres.residual, np.linalg.norm(b), rtol=ROUNDING)
    assert not gmres.solution().any()
    given = []
    for k in range(6):
        # Another preconditioner in each iteration.
        z = gmres.vector * (1 + rng.uniform(size=(NODES, DIM))[own]) / (k + 1)
        given.append(whole(z))
        residual = gmres.add(z, (A @ given[-1]).reshape(NODES, DIM)[own].copy())
        y, *_ = np.linalg.lstsq(A @ np.transpose(given), b.ravel())
        x = np.transpose(given) @ y
        np.testing.assert_allclose(whole(gmres.solution()), x, rtol=0, atol=ROUNDING)
        expected = np.linalg.norm(b.ravel() - A @ x)
        np.testing.assert_allclose([residual, gmres.residual], expected, rtol=ROUNDING)


@pytest.mark.serial
def test_residuals_of_solutions_are_zero_and_of_singular_systems_not_finite():
    b = np.array([[3.0, 0.0], [4.0, 0.0]])
    exact, singular = _kernels.FlexibleGmres(b, None), _kernels.FlexibleGmres(b, None)
    assert exact.residual == 5.0
    assert exact.add(exact.vector, 2 * exact.vector) <= 1e-15
    np.testing.assert_allclose(exact.solution(), b / 2, rtol=1e-15)
    assert np.isnan(singular.add(singular.vector, 0 * b))


@pytest.mark.serial
def test_fgmres_of_petsc_takes_as_many_iterations_as_the_kernel():
    """The method of PETSc does not restart either; 60 different eigenvalues take as many."""
    eigenvalues, b = np.linspace(1.0, 60.0, 60)[:, None], np.ones((60, 1))
    options = PetscOptions(MPI.COMM_SELF, {"ksp_type": "fgmres"})
    functions = (lambda x, _: eigenvalues * x), np.copy
    petsc = PetscKrylov(MPI.COMM_SELF, b.shape, *functions, options, 100)
    x, iterations = petsc.solve(b, 1e-10, 1e10)
    np.testing.assert_allclose(x, b / eigenvalues, rtol=1e-8)
    gmres = _kernels.FlexibleGmres(b, None)
    expected = 0
    while gmres.residual > 1e-10 * np.linalg.norm(b):
        gmres.add(gmres.vector, eigenvalues * gmres.vector)
        expected += 1
    assert iterations == expected > 30


@pytest.mark.serial
def test_vectors_of_other_shapes_are_refused():
    b = np.ones((4, 2))
    with pytest.raises(ValueError, match=r"b: expected shape \(any, any\), given \(8\)"):
        _kernels.FlexibleGmres(b.ravel(), None)
    gmres = _kernels.FlexibleGmres(b, None)
    for name, z, w in (("z", b[:3], b), ("w", b, b[:3])):
        with pytest.raises(ValueError, match=rf"{name}: expected shape \(4, 2\), given \(3, 2\)"):
            gmres.add(z.copy(), w.copy())
