"""Rigid motion of free bodies under forces, where factors of a matrix are too stiff for it."""

import numpy as np
import pytest

from dolfinx_nts.solvers.precond.mobility import Mobility

NODES, MOTIONS = 7, 3


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("num_held", range(MOTIONS + 1))
def test_free_motions_have_the_stiffness_that_is_wanted(comm, rng, num_held):
    """Clamped motions are left out; straining ones stay as the factors resist them."""
    first, last = (NODES * rank // comm.size for rank in (comm.rank, comm.rank + 1))
    motions = rng.normal(size=(MOTIONS, NODES, 2))
    P = motions.reshape(MOTIONS, -1)
    strains = rng.normal(size=(2 * NODES, 2 * NODES))
    strains -= strains @ np.linalg.pinv(P) @ P
    added, wanted = rng.uniform(0.5, 1.5, size=(2, NODES, 1))
    D, K = np.diag(np.repeat(added.ravel(), 2)), strains.T @ strains
    held = rng.normal(size=(MOTIONS, num_held))
    part = slice(first, last)
    own = motions[:, part], held, added[part], wanted[part]
    mobility = Mobility.of(comm, *own)
    f = rng.normal(size=(NODES, 2))
    amounts = mobility.by(comm, f[part].ravel())
    alone = np.linalg.solve(K + D, f.ravel())
    u = alone + amounts @ P
    weighted = (wanted * motions).reshape(MOTIONS, -1)
    made = np.linalg.solve(P @ D @ P.T, P @ D @ u)
    free = np.linalg.svd(held)[0][:, num_held:]
    assert held.T @ made == pytest.approx(0, abs=1e-11)
    assert free.T @ (weighted @ P.T @ made - P @ f.ravel()) == pytest.approx(0, abs=1e-11)
    np.testing.assert_allclose(K @ u, K @ alone, rtol=0, atol=1e-11 * np.abs(K).max())
