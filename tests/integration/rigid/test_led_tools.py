"""Statics with tools moved by guides, obstacle motions or supports: equal results."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import meshing
from helpers.models.plane import blocks, turning
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

BORE, RIM, GAP = 1.0, 1.8, 0.005  # m
SQUEEZE, ASIDE, ANGLE = 0.03, 0.08, 0.06  # m, m, rad


def bushing(comm, tool, method="node-to-segment"):
    """A rubber sleeve, squeezed onto a pin until t = 1; the pin shifts until t = 2 and rotates.

    The pin moves as a rigid body, as an exact obstacle, or by supports at all of its nodes.
    """
    ends = {"sleeve": {BORE: 64, RIM: 96}}  # number of cells around, by radii
    if tool != "obstacle":
        ends["pin"] = {0.4 * BORE: 32, BORE - GAP: 48}

    def build(model):
        occ = model.occ
        for name, cells in ends.items():
            inner, outer = ([(2, occ.addDisk(0, 0, 0, r, r))] for r in cells)
            (surface,), _ = occ.cut(outer, inner)
            occ.synchronize()
            model.addPhysicalGroup(2, [surface[1]], name=name)
            for curve in model.getBoundary([surface], oriented=False):
                radius = min(cells, key=lambda r: abs(r - model.getBoundingBox(*curve)[3]))
                model.mesh.setTransfiniteCurve(curve[1], cells[radius] + 1)
            model.mesh.setRecombine(*surface)
        model.mesh.generate(2)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    sleeve = nts.Body(V, cells, tag["sleeve"], nts.NeoHookean(E=4e6, nu=0.499, rho=1100.0))
    u, X = fem.Function(V), V.tabulate_dof_coordinates()[:, :2]
    rim = fem.locate_dofs_geometrical(V, lambda x: np.hypot(x[0], x[1]) > 0.99 * RIM)
    bcs = [fem.dirichletbc(u, rim)]

    def shift(t):
        return ASIDE * float(np.clip(t - 1, 0, 1)), 0.0

    def angle(t):
        return 4 * ANGLE * max(t - 2, 0.0)

    motion, bodies, driven = nts.Motion(shift, angle, (0.0, 0.0)), [sleeve], np.empty(0, int)
    if tool == "obstacle":
        shaft = nts.RigidSphere((0.0, 0.0), BORE - GAP).moving(motion)
    elif tool == "guide":
        bodies.append(nts.RigidBody(V, cells, tag["pin"], 7800.0, guide=nts.Guide(motion=motion)))
        shaft = nts.boundary_of(bodies[1])
    else:
        bodies.append(nts.Body(V, cells, tag["pin"], nts.NeoHookean(E=1e9, nu=0.3, rho=7800.0)))
        shaft = nts.boundary_of(bodies[1])
        driven = fem.locate_dofs_geometrical(V, lambda x: np.hypot(x[0], x[1]) < BORE - GAP / 2)
        bcs.append(fem.dirichletbc(u, driven))

    def update(t):
        values = u.x.array.reshape(-1, 2)
        values[rim] = -SQUEEZE * min(t, 1.0) * X[rim] / RIM
        values[driven] = X[driven] @ turning(angle(t)).T - X[driven] + shift(t)

    bore = nts.boundary_of(sleeve, where=lambda x: np.hypot(x[0], x[1]) < 1.1 * BORE)
    pair = nts.ContactPair(
        bore, shaft, friction=nts.Coulomb(0.3), method=method, enforcement=nts.LagrangeMultiplier()
    )
    return nts.QuasiStatic(bodies, [pair], dt=0.25, bcs=bcs, update=update)


def pressed(stepper):
    """Force and torque on the nodes of the pair."""
    (pair,) = nts.Diagnostics(stepper).pairs().values()
    return np.array([*pair.force, *pair.torque])


@pytest.mark.parametrize(
    ("tool", "method"),
    [
        once("guide", "node-to-segment"),
        once("obstacle", "node-to-segment"),
        once("supports", "node-to-segment"),
        ("guide", "mortar"),
    ],
)
def test_a_pin_that_begins_to_turn_takes_a_bushing_along(comm, tool, method):
    """After a rotation in one increment, forces far from equilibrium let most nodes slide."""
    whole, parts = (bushing(comm, tool, method) for _ in range(2))
    for stepper in (whole, parts):
        for _ in stepper.run(until=2.0):
            pass
    (step,) = whole.run(until=2.25)
    assert step.newton_iterations <= 12
    control = nts.StepControl(times=2.0 + np.arange(1, 9) / 32)
    for _ in parts.run(until=2.25, control=control):
        pass
    expected = pressed(parts)
    np.testing.assert_allclose(pressed(whole), expected, atol=1e-6 * np.abs(expected).max())


def dragged(tool, travel, angle=0.0, nu=0.3):
    """A block that is pressed into a tool until t = 1; then the tool moves away and rotates.

    The tool is below the block, whose top supports press down.
    """
    centre = (0.5, 0.0)

    def shift(t):
        return travel * max(t - 1, 0.0), 0.0

    def turn(t):
        return angle * max(t - 1, 0.0)

    motion = nts.Motion(shift, turn, centre)
    law = nts.NeoHookean(1e5, nu, 1e3)
    scene = blocks(width=8, material=law)
    V, u = scene.V, fem.Function(scene.V)
    X = V.tabulate_dof_coordinates()[:, :2]
    top = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 1.02))
    low = fem.locate_dofs_geometrical(V, lambda x: x[1] < 0.01)
    bcs, segments = [fem.dirichletbc(u, np.union1d(top, low).astype(np.int32))], scene.segments
    if tool == "obstacle":
        segments = nts.RigidPlane((0.0, 0.0), (0.0, 1.0)).moving(motion)

    def update(t):
        values = u.x.array.reshape(-1, 2)
        values[top] = 0.0, -0.07 * min(t, 1.0)
        if tool == "supports":
            values[low] = (X[low] - centre) @ turning(turn(t)).T + centre - X[low] + shift(t)

    pair = nts.ContactPair(
        scene.nodes,
        segments,
        friction=nts.Coulomb(2.0),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    bodies = [scene.lower, scene.upper]
    return nts.QuasiStatic(bodies, [pair], dt=0.25, bcs=bcs, update=update)


@pytest.mark.parametrize("tool", ["obstacle", "supports"])
@pytest.mark.parametrize("motion", [once("shift"), "turn"])
def test_the_first_iterate_follows_the_tool_to_first_order(tool, motion):
    """Bodies, closed and sticking contact, and its forces follow with their tangents."""
    residuals = []
    for size in (0.004, 0.002):
        travel, angle = {"shift": (size, 0.0), "turn": (0.0, size)}[motion]
        stepper = dragged(tool, 4 * travel, 4 * angle)
        *_, step = stepper.run(until=1.25)
        residuals.append(step.residual_norms[1])
    assert residuals[0] / residuals[1] == pytest.approx(4.0, rel=0.2)


def test_a_plane_that_begins_to_drag_is_no_more_work_than_one_that_presses():
    """The motion of obstacles also decides whether bodies move as in the last step."""
    *_, dragging = (
        step.newton_iterations for step in dragged("obstacle", 0.4, nu=0.499).run(until=1.25)
    )
    assert dragging <= 12


def on_a_roller(comm, before):
    """Iterations of a block that is pressed on a roller, with springs, and rolls on it.

    The roller is an obstacle, and has turned by an angle ``before`` until they meet [rad].
    """

    def build(model):
        shape = {"corner": (-0.5, 0.001), "size": (1.0, 0.5), "cells": (12, 6)}
        meshing.add_rectangle(model, "block", **shape)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    block = nts.Body(V, cells, tag["block"], nts.NeoHookean(1e5, 0.3, 1e3))
    u = fem.Function(V)
    top = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 0.501))

    def update(t):
        u.x.array.reshape(-1, 2)[top] = 0.0, -0.05 * np.clip(t - 1, 0, 1)

    def turn(t):
        return before * min(t, 1.0) + 0.035 * max(t - 2, 0.0)

    centre = (0.0, -1.0)
    roller = nts.RigidSphere(centre, 1.0).moving(nts.Motion(None, turn, centre))
    bottom = nts.Surface(V, facets, tag["block_bottom"])
    pair = nts.ContactPair(
        bottom, roller, nts.Penalty(), nts.Coulomb(0.5), method="node-to-segment"
    )
    held = [fem.dirichletbc(u, top)]
    stepper = nts.QuasiStatic([block], [pair], dt=0.25, bcs=held, update=update)
    return [step.newton_iterations for step in stepper.run(until=4.0)]


def test_springs_do_not_depend_on_the_rotation_of_a_tool(comm):
    """Gaps and slips follow the linear system in space, not in the frame of the tool."""
    straight, turned = (on_a_roller(comm, before)[4:] for before in (0.0, np.pi / 2))
    assert turned == straight
    assert max(straight) <= 6
