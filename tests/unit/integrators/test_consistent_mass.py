"""Rates of given momenta by the consistent mass."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.integrators.rates import ConsistentMass

# It takes 22; without the lumped mass as preconditioner 458, with an error of 3e-10.
MOST_PRODUCTS = 30
ROUND_OFF = 1e-12


@pytest.fixture
def mass(comm):
    """Mass of a heavy coarse block and of a light fine one with elongated cells."""

    def build(model):
        box = {"size": (1, 1, 1)}
        parts.add_box(model, "heavy", corner=(0, 0, 0), cells=(3, 3, 3), **box)
        parts.add_box(model, "light", corner=(0, 0, 2), cells=(6, 2, 12), **box)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bodies = [
        nts.Body(V, cells, tag[name], nts.NeoHookean(1e5, 0.3, rho))
        for name, rho in (("heavy", 1e4), ("light", 1.0))
    ]
    return ConsistentMass(bodies, fem.Function(V)), V


def test_a_rate_is_found_from_its_momentum_in_few_products(comm, mass):
    mass, V = mass
    x = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]
    rate = np.stack([np.sin(x[:, 0]), x[:, 1] * x[:, 2], np.cos(3 * x[:, 2])], axis=1).ravel()
    force, calls = mass.times(rate), 0

    def projected(values):
        nonlocal calls
        calls += 1
        return values

    found = mass.solve(force, projected)
    off = comm.allreduce(np.abs(found - rate).max(initial=0.0), MPI.MAX)
    assert off <= ROUND_OFF * 9  # of the largest rate
    assert calls / 2 <= MOST_PRODUCTS


def test_no_force_gives_no_rate(comm, mass):
    mass, V = mass
    found = mass.solve(np.zeros(3 * V.dofmap.index_map.size_local), lambda values: values)
    assert not found.any()
