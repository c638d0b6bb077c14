"""Half models: friction on planes of symmetry, and whole boundaries as surfaces."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

pytestmark = pytest.mark.at_most_two_ranks

MU = 0.3  # -
WIDTH, HEIGHT, GAP, RADIUS = 0.05, 0.5, 1e-4, 1.0  # m


@pytest.mark.parametrize("method", ["mortar", "node-to-segment"])
def test_no_friction_acts_across_a_plane_of_symmetry(comm, method):
    """A slice of a round block is pressed down, and then pushed aside until it slides."""

    def build(model):
        for name, cells, z in (("lower", 15, -HEIGHT), ("upper", 20, GAP)):
            corner, size = (-0.5, 0, z), (1, WIDTH, HEIGHT)
            parts.add_box(model, name, corner=corner, size=size, cells=(cells, 1, 4))

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    x, _, z = mesh.geometry.x.T
    z += np.where(z > GAP / 2, (GAP + HEIGHT - z) * x**2 / RADIUS, 0.0)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(E=1e5, nu=0.3, rho=1e3)
    bodies = [nts.Body(V, cells, tag[name], rubber) for name in ("lower", "upper")]
    bottom, top = (nts.Surface(V, facets, tag[name]) for name in ("upper_bottom", "lower_top"))
    pair = nts.ContactPair(
        bottom, top, friction=nts.Coulomb(MU), method=method, enforcement=nts.LagrangeMultiplier()
    )
    travel, still, across = fem.Constant(mesh, np.zeros(3)), np.zeros(3), V.sub(1).collapse()[0]
    everywhere = fem.locate_dofs_geometrical((V.sub(1), across), lambda x: x[0] > -1.0)
    bcs = [fem.dirichletbc(fem.Function(across), everywhere, V.sub(1))]
    for name, value in (("upper_top", travel), ("lower_bottom", still)):
        dofs = fem.locate_dofs_topological(V, 2, facets.find(tag[name]))
        bcs.append(fem.dirichletbc(value, dofs, V))

    def update(t):
        travel.value = [0.004 * max(t - 1.0, 0.0), 0.0, -0.003 * min(t, 1.0)]

    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, update=update)
    for _ in stepper.run(until=2.0):
        history = pair.history
        sideways = np.abs(history.traction[:, 1]).max(initial=0.0)
        pressing = np.abs(history.lambda_N).max(initial=0.0)
        sideways, pressing = np.max(comm.allgather([sideways, pressing]), axis=0)
        assert sideways <= 1e-12 * MU * pressing


@pytest.mark.parametrize(
    ("scheme", "options"),
    [
        (nts.CentralDifference, {"method": None}),
        (nts.EnergyMomentum, {"method": None}),
        (nts.EnergyMomentum, {"method": "node-to-segment"}),
        (nts.QuasiStatic, {"method": None}),
    ],
)
@pytest.mark.parametrize("mu", [None, 0.3])
def test_whole_boundaries_of_half_the_bodies_act_as_those_of_the_whole(comm, scheme, options, mu):
    """A block strikes a plate and slides on it; in statics its top moves so."""
    statics, states = scheme is nts.QuasiStatic, []
    for is_half in (False, True):

        def build(model, parts_of=0.5 if is_half else 1.0, least=0.0 if is_half else -0.5):
            long, high = (2, 1 * parts_of, 0.4), (0.55, 0.6 * parts_of, 0.4)
            many = round(4 * parts_of)
            box = {"corner": (-1, least, -0.4), "size": long, "cells": (8, many, 2)}
            parts.add_box(model, "plate", **box)
            corner = (-0.3, 0.6 * least, 0.02)
            parts.add_box(model, "block", corner=corner, size=high, cells=(4, many, 3))

        mesh, cells, facets, tag = nts.read_mesh(build, comm)
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        rubber = nts.NeoHookean(E=1e6, nu=0.3, rho=1e3)
        plate, block = (nts.Body(V, cells, tag[name], rubber) for name in ("plate", "block"))
        bottom = fem.locate_dofs_topological(V, 2, facets.find(tag["plate_bottom"]))
        bcs = [fem.dirichletbc(np.zeros(3), bottom, V)]
        across, way = V.sub(1).collapse()[0], fem.Constant(mesh, np.zeros(3))
        on_plane = fem.locate_dofs_geometrical((V.sub(1), across), lambda x: np.isclose(x[1], 0.0))
        bcs.append(fem.dirichletbc(fem.Function(across), on_plane, V.sub(1)))
        if statics:
            top = fem.locate_dofs_topological(V, 2, facets.find(tag["block_top"]))
            bcs.append(fem.dirichletbc(way, top, V))

        def update(t, way=way):
            way.value[:] = max(t - 1, 0) * 0.1, 0.0, -0.05 * min(t, 1)

        pairs = nts.all_pairs([plate, block], friction=mu, **options)
        if statics:
            stepper = scheme([plate, block], pairs, dt=0.5, bcs=bcs, update=update)
        else:
            dt = 1e-3 if scheme is nts.CentralDifference else 4e-3
            stepper = scheme([plate, block], pairs, dt=dt, bcs=bcs)
            stepper.set_velocity(block, (1.0, 0.0, -2.0))
        diagnostics, forces = nts.Diagnostics(stepper), []
        for _ in stepper.run(until=2.0 if statics else 0.06):
            (balance,) = diagnostics.pairs().values()
            forces.append(balance.force[[0, 2]] * (2 if is_half else 1))
        states.append(np.array(forces))
    largest = np.abs(states[0]).max()
    assert largest > 1e3
    np.testing.assert_allclose(states[1], states[0], rtol=0, atol=1e-3 * largest)


def test_nodes_that_a_support_holds_along_the_normal_have_no_friction(comm):
    """A pressed block expands on rollers, also if an obstacle with friction lies below them.

    The rollers carry the load, so that the normal force of contact is zero, and so is friction.
    """

    def build(model):
        parts.add_rectangle(model, "block", corner=(0, 0), size=(1, 0.5), cells=(8, 4))

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    block = nts.Body(V, cells, tag["block"], nts.NeoHookean(E=1e6, nu=0.3, rho=1e3))
    bottom = nts.Surface(V, facets, tag["block_bottom"])
    pair = nts.ContactPair(bottom, nts.RigidPlane((0, 0), (0, 1)), friction=MU)

    def held(axis, where, value):
        W = V.sub(axis)
        return fem.dirichletbc(
            np.float64(value), fem.locate_dofs_geometrical((W, W.collapse()[0]), where)[0], W
        )

    bcs = [
        held(0, lambda x: np.isclose(x[0], 0), 0),
        held(1, lambda x: np.isclose(x[1], 0), 0),
        held(1, lambda x: np.isclose(x[1], 0.5), -0.05),
    ]
    widths = []
    for pairs in ([pair], []):
        stepper = nts.QuasiStatic([block], pairs, dt=1.0, bcs=bcs)
        stepper.advance()
        widths.append(comm.allreduce(stepper.u.x.array[::2].max(initial=0.0), MPI.MAX))
    assert widths[0] == pytest.approx(widths[1], rel=1e-9)
    assert not pair.history.traction.any()
