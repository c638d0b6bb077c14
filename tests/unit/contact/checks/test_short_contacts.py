"""Impacts of few steps are reported, with a step that resolves them."""

import logging

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

pytestmark = pytest.mark.at_most_two_ranks

LENGTH, SPEED, DURATION = 1.0, 0.3, 0.0632  # m, m/s, s; waves of 31.6 m/s run to the end and back


def rod(comm, dt, law=None, kind=nts.Body):
    """A rod with the speed of a wave there and back, in front of a wall."""

    def build(model):
        box = {"corner": (0, 0.002), "size": (0.25, LENGTH), "cells": (1, 8)}
        parts.add_rectangle(model, "rod", **box)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    if kind is nts.Body:
        body = nts.Body(V, cells, tag["rod"], nts.NeoHookean(E=1e6, nu=0.0, rho=1e3))
    else:
        body = nts.RigidBody(V, cells, tag["rod"], rho=1e3)
    end = nts.boundary_of(body, where=lambda x: x[1] < 0.0021)
    pair = nts.ContactPair(end, nts.RigidPlane((0, 0), (0, 1)), law)
    stepper = nts.EnergyMomentum([body], [pair], dt=dt)
    stepper.set_velocity(body, (0.0, -SPEED))
    return stepper, body


def reported(caplog):
    return [r.getMessage() for r in caplog.records if "has lasted" in r.getMessage()]


def test_a_rod_that_rebounds_within_few_steps_is_reported_once(comm, caplog):
    stepper, body = rod(comm, DURATION / 2)
    for _ in range(14):
        stepper.advance()
    lost = 1 - nts.Diagnostics(stepper).body_velocity(body)[1] / SPEED
    assert lost > 0.05
    messages = reported(caplog)
    assert len(messages) == (comm.rank == 0)
    if messages:
        assert "a part of the boundary of rod" in messages[0]
        advised = float(messages[0].split("use steps of ")[1].split()[0])
        assert DURATION / 20 <= advised <= DURATION / 5


@pytest.mark.parametrize(
    ("dt", "options"),
    [
        (DURATION / 20, {}),
        (DURATION / 2, {"kind": nts.RigidBody}),
        (DURATION / 20, {"law": nts.LagrangeMultiplier()}),
    ],
    ids=["resolved", "rigid", "chatter"],
)
def test_impacts_of_enough_steps_or_without_deformation_are_not_reported(comm, caplog, dt, options):
    stepper, body = rod(comm, dt, **options)
    with caplog.at_level(logging.WARNING):
        for _ in range(round(5 * DURATION / dt)):
            stepper.advance()
    assert nts.Diagnostics(stepper).body_velocity(body)[1] > 0.8 * SPEED
    assert not reported(caplog)
    assert np.isfinite(stepper.x).all()
