"""Pressure of a plane wave under blocks of narrow cells, whose edges belong to the surface."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import CellType, create_rectangle, meshtags

import dolfinx_nts as nts
from helpers.once import once_except

pytestmark = pytest.mark.serial

E, RHO = 1.0e7, 1.0e3  # Pa, kg/m^3, without lateral strain


def wave(scheme, cells, until):
    """Nodal pressures over rho c v under a block of 0.1 x 1 m that strikes a plane.

    Args:
        scheme: The stepper.
        cells: Numbers of cells along the width and the height.
        until: End of the run [s]; waves need 0.01 s for the height.
    """
    mesh = create_rectangle(
        MPI.COMM_SELF, [(0.0, 1e-3), (0.1, 1.001)], cells, CellType.quadrilateral
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    number = mesh.topology.index_map(2).size_local
    every = np.arange(number, dtype=np.int32)
    tags = meshtags(mesh, 2, every, np.ones(number, dtype=np.int32))
    block = nts.Body(V, tags, 1, nts.NeoHookean(E=E, nu=0.0, rho=RHO))
    pair = nts.ContactPair(nts.boundary_of(block), nts.RigidPlane((0.0, 0.0), (0.0, 1.0)))
    dt = None if scheme is nts.CentralDifference else 1e-4
    stepper = scheme([block], [pair], dt=dt)
    stepper.set_velocity(block, (0.0, -1.0))
    while stepper.t < until:
        stepper.advance()
    X = V.tabulate_dof_coordinates()[pair.nodes.nodes]
    (contact,) = stepper.pairs
    return contact.pressure[X[:, 1] < 2e-3] / np.sqrt(E * RHO)


@pytest.mark.parametrize("cells", [(40, 40), (4, 200)], ids=["narrow", "flat"])
@pytest.mark.parametrize(
    "scheme",
    once_except([nts.EnergyMomentum, nts.CentralDifference], nts.EnergyMomentum),
    ids=lambda scheme: scheme.__name__,
)
def test_plane_waves_press_evenly_up_to_the_edges(scheme, cells):
    pressure = wave(scheme, cells, until=0.008)
    np.testing.assert_allclose(pressure, 1.0, rtol=0.06)
    assert np.ptp(pressure) < 0.02
