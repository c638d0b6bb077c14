"""Bodies with initial penetration: reports, and effect of the suggested remedies."""

import logging

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.io import checkpoint

pytestmark = pytest.mark.at_most_two_ranks

STEP = 1e-3  # s


@pytest.fixture
def stepper(comm):
    """A function that makes a stepper of a block between walls and one 10 mm inside of it."""

    def build(model):
        for number, z in enumerate((0.0, 0.19)):
            shape = {"size": (0.2, 0.2, 0.2), "cells": (2, 2, 2)}
            parts.add_box(model, f"block_{number}", corner=(0, 0, z), **shape)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.NeoHookean(E=1e6, nu=0.3, rho=1e3)
    bodies = [nts.Body(V, cells, tag[f"block_{number}"], rubber) for number in range(2)]
    ends = [tag["block_0_bottom"], tag["block_1_top"]]
    dofs = fem.locate_dofs_topological(V, 2, facets.indices[np.isin(facets.values, ends)])
    walls = fem.dirichletbc(np.zeros(3), dofs, V)
    top, bottom = tag["block_0_top"], tag["block_1_bottom"]

    def make(scheme):
        surfaces = [nts.Surface(V, facets, number) for number in (bottom, top)]
        pair = nts.ContactPair(
            *surfaces, nts.LagrangeMultiplier("plastic"), method="node-to-segment"
        )
        return scheme(bodies, [pair], dt=STEP, bcs=[walls])

    return make


def test_plastic_impact_throws_overlapping_bodies_apart_with_a_warning(stepper, comm, caplog):
    caplog.set_level(logging.WARNING, "dolfinx_nts")
    thrown = stepper(nts.EnergyMomentum)
    thrown.advance()
    messages = {r.module: r.getMessage() for r in caplog.records} if comm.rank == 0 else {}
    messages = comm.bcast(messages)
    assert set(messages) == {"overlap_watch", "watch"}
    assert all("a step of QuasiStatic" in text for text in messages.values())
    assert "throw the bodies apart" in messages["overlap_watch"]


def test_press_fit_that_statics_has_made_is_at_rest(stepper, comm, caplog, tmp_path):
    path = comm.bcast(tmp_path) / "fit.h5"
    fitted = stepper(nts.QuasiStatic)
    fitted.advance()
    checkpoint.save(path, fitted)
    caplog.clear()
    going_on = stepper(nts.EnergyMomentum)
    nts.load_state(path, going_on)
    for _ in going_on.run(STEP + 5 * STEP):
        pass
    balance = nts.Diagnostics(going_on).balance()
    assert balance.strain_energy > 0.1
    assert balance.kinetic_energy < 1e-16 * balance.strain_energy
    assert not [r for r in caplog.records if r.levelno >= logging.WARNING]
