"""Vertices of segments inside the surface of the nodes."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.diagnostics.reverse_penetration import ReversePenetration

RUBBER = nts.NeoHookean(E=1e5, nu=0.3, rho=1e3)


def boxes(comm, depth, make_pairs):
    """A box of one cell, ``depth`` inside the top of one of four by four."""

    def build(model):
        parts.add_box(model, "lower", corner=(0, 0, 0), size=(1, 1, 1), cells=(4, 4, 1))
        parts.add_box(model, "upper", corner=(0.1, 0.1, 1), size=(0.8, 0.8, 1), cells=(1, 1, 1))

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    lower, upper = (nts.Body(V, cells, tag[name], RUBBER) for name in ("lower", "upper"))
    top, bottom = (nts.Surface(V, facets, tag[name]) for name in ("lower_top", "upper_bottom"))
    pairs = make_pairs(top, bottom)
    stepper = nts.EnergyMomentum([lower, upper], pairs, dt=0.01)
    stepper.set_displacement(upper, (0.0, 0.0, -depth))
    return stepper


def touch(stepper):
    for contact in stepper.contacts:
        active = np.ones(len(contact.nodes.nodes), dtype=bool)
        contact.accept(replace(contact.history, active=active))


@pytest.mark.parametrize(("depth", "warns"), [(0.05, False), (0.2, True)])
def test_the_deepest_vertex_is_found_and_told_once(comm, depth, warns, caplog):
    stepper = boxes(comm, depth, lambda top, bottom: [nts.ContactPair(bottom, top)])
    penetration = ReversePenetration(stepper)
    penetration.look()
    assert penetration.deepest == {0: 0.0}  # nothing touches
    touch(stepper)
    for _ in range(2):
        penetration.look()
    np.testing.assert_allclose(penetration.deepest[0], depth, rtol=1e-12)
    told = [r for r in caplog.records if r.levelno == logging.WARNING]
    assert len(told) == (warns and comm.rank == 0)
    text = "vertices of lower_top are 0.2 (18 % of a facet) inside upper_bottom, whose nodes alone"
    assert all(text in r.message for r in told)


def test_pairs_in_both_directions_and_obstacles_are_left_out(comm):
    plane = nts.RigidPlane((0, 0, -1), (0, 0, 1))

    def both(top, bottom):
        return [*nts.two_half_passes(top, bottom), nts.ContactPair(top, plane)]

    stepper = boxes(comm, 0.2, both)
    touch(stepper)
    penetration = ReversePenetration(stepper)
    penetration.look()
    assert penetration.deepest == {}
