"""Bodies faster than their waves are reported, with the units that may be wrong."""

import math

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.model.checks.speed_limit import wave_speed
from helpers import scenes


def test_p_waves_have_the_speed_of_the_closed_form(comm):
    """sqrt((lambda + 2 mu) / rho)."""
    old = scenes.blocks(comm).stepper.bodies[0]
    material = nts.NeoHookean(E=2.1e11, nu=0.3, rho=7850.0)
    modulus = 2.1e11 * 0.7 / (1.3 * 0.4)
    assert wave_speed(scenes.of_material(old, material)) == pytest.approx(math.sqrt(modulus / 7850))


@pytest.mark.parametrize(("factor", "warns"), [(0.99, False), (1.01, True)])
def test_body_faster_than_its_waves_is_reported_once(comm, caplog, factor, warns):
    stepper = scenes.blocks(comm).stepper
    body = stepper.bodies[0]
    direction = np.array([2.0, -1.0, 2.0]) / 3
    caplog.clear()
    stepper.set_velocity(body, factor * wave_speed(body) * direction)
    texts = [record.getMessage() for record in caplog.records]
    assert len(texts) == (warns and comm.rank == 0)
    if texts:
        assert texts[0].startswith(f"{body.name} moves at up to ")
        assert "consistent units" in texts[0]


def test_rigid_body_has_no_limit(comm):
    mesh, cells, _, tag = nts.read_mesh(scenes.BALL_PLATE, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    assert wave_speed(nts.RigidBody(V, cells, tag["ball"], rho=1.0)) == math.inf
