"""Faces that roll over an edge on which one of their nodes lies."""

import logging

from mpi4py import MPI

import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models.plane import block
from helpers.models.round import plane_mesh, tagged

pytestmark = pytest.mark.serial


def tipped(cells, caplog):
    """Let a rigid block with a number of cells tip over the edge of a rigid table; warnings."""
    table = block((-1.0, -0.3), (1.0, 0.3), (20, 6))
    tipping = block((-0.15, 0.0), (0.4, 0.1), (cells, 2))
    mesh = plane_mesh(MPI.COMM_SELF, table, tipping)
    tags = tagged(mesh, lambda x: x[:, 1] > 0)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    bodies = [
        nts.RigidBody(V, tags, 2, rho=1000.0, name="block"),
        nts.RigidBody(V, tags, 1, rho=1000.0, name="table", guide=nts.Guide()),
    ]
    sides = [nts.boundary_of(body) for body in bodies]
    pair = nts.ContactPair(*sides, friction=nts.Coulomb(1.0), method="node-to-segment")
    gravity = nts.Gravity(bodies[:1], lambda t: (0.0, -9.81 * min(1.0, 10 * t)))
    stepper = nts.EnergyMomentum(bodies, [pair], dt=2e-3, loads=[gravity])
    with caplog.at_level(logging.WARNING, logger="dolfinx_nts"):
        while stepper.t < 0.34:
            stepper.advance()
    return [record.message for record in caplog.records if "along normals" in record.message]


def test_nodes_that_stick_to_an_edge_are_reported_once(caplog):
    (warning,) = tipped(8, caplog)
    assert "the boundary of block" in warning
    assert "[0.0, 0.0, 0.0] m" in warning.replace("-0.0", "0.0")


def test_faces_without_a_node_on_the_edge_are_not_reported(caplog):
    assert tipped(7, caplog) == []
