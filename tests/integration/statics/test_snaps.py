"""Statics without an equilibrium near the last one: snap-through of arches, rolling discs."""

import logging
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers.laws import NODAL
from helpers.models.plane import blocks
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

SPAN, RISE, THICK = 2.0, 0.15, 0.04  # of the arch [m]
LOAD = 100.0  # of the punch at the end [N/m]


class Arch(NamedTuple):
    """Statics of a shallow arch under a round punch."""

    stepper: nts.QuasiStatic
    punch: nts.RigidBody

    def place(self) -> tuple[float, float]:
        """Height of the punch [m], and the force on it [N/m]."""
        diagnostics = nts.Diagnostics(self.stepper)
        height: float = diagnostics.centre_of_mass(self.punch)[1]
        return height, -diagnostics.contact_force()[1]


def arch(dt: float, guide: nts.Guide, *loads: Any) -> Arch:
    """An arch clamped at its ends, with a punch at its top, loaded or moved."""

    def build(model):
        disc = model.occ.addDisk(0, RISE + THICK + 0.2 + 1e-4, 0, 0.2, 0.2)
        model.occ.synchronize()
        model.addPhysicalGroup(2, [disc], name="punch")
        model.mesh.setSize(model.getEntities(0), 0.03)
        model.mesh.setRecombine(2, disc)
        model.mesh.generate(2)
        parts.add_rectangle(
            model, "arch", corner=(-SPAN / 2, -5.0), size=(SPAN, THICK), cells=(40, 2)
        )

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    x = mesh.geometry.x
    low = x[:, 1] < -2
    x[low, 1] += 5 + RISE * np.cos(np.pi * x[low, 0] / SPAN)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    body = nts.Body(V, cells, tag["arch"], nts.NeoHookean(1e6, 0.3, 1e3))
    punch = nts.RigidBody(V, cells, tag["punch"], rho=7.8e3, guide=guide)
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["arch_top"]),
        nts.boundary_of(punch),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    sides = [facets.find(tag[f"arch_{side}"]) for side in ("left", "right")]
    ends = fem.locate_dofs_topological(V, 1, np.concatenate(sides))
    held = fem.dirichletbc(np.zeros(2), ends, V)
    given = [load(punch) for load in loads]
    return Arch(nts.QuasiStatic([body, punch], [pair], dt=dt, bcs=[held], loads=given), punch)


def pushed(dt):
    """Push the punch by a force that grows with time."""
    return arch(dt, nts.Guide(slides="y"), lambda punch: nts.Force(punch, lambda t: (0, -LOAD * t)))


def driven(travel, num_steps):
    """Heights of a punch with prescribed displacement [m], and its reactions [N/m]."""
    guide = nts.Guide(motion=nts.Motion(translation=lambda t: (0, -travel * t)))
    scene = arch(1 / num_steps, guide)
    curve = [scene.place() for _ in scene.stepper.run(1.0)]
    assert len(curve) == num_steps
    return np.array(curve).T


def check_snap(start, scene):
    """Compare the state under the whole load with the one under prescribed displacement."""
    height, force = scene.place()
    assert force == pytest.approx(LOAD, rel=1e-9)
    heights, forces = driven(start - height, 40)
    assert heights[-1] == pytest.approx(height, rel=1e-12)
    assert forces[-1] == pytest.approx(LOAD, rel=1e-8)
    # The arch has a limit load, from which the force falls to less than half.
    least = int(np.argmin(forces[5:])) + 5
    assert forces[least] < 0.5 * forces[:least].max() < 0.5 * LOAD


@pytest.mark.serial
@pytest.mark.parametrize("control", [None, nts.StepControl()])
def test_an_arch_snaps_under_a_force_to_the_state_of_prescribed_motion(control):
    """Beyond the limit load there is one equilibrium, the same as by prescribed motion."""
    scene = pushed(0.05)
    start, _ = scene.place()
    for step in scene.stepper.run(1.0, control):
        assert step.residual_norms[-1] < 1e-8 * LOAD
    check_snap(start, scene)


@pytest.mark.serial
def test_steps_are_long_again_after_a_snap(caplog):
    """Steps close in on the limit load; where the arch has snapped to there is none."""
    stepper = pushed(0.01).stepper
    lengths = []
    for step in stepper.run(0.45, nts.StepControl()):
        lengths.append(step.dt)
        if any("no equilibrium near the last one" in text for text in caplog.messages):
            break
    assert min(lengths) < 0.01 / 16
    assert next(stepper.run(0.45, nts.StepControl())).dt == pytest.approx(0.01)


def test_a_snap_with_resistance_is_reported_and_exact(caplog):
    """Without another start, the whole load in one step gives the same state, too."""
    scene = pushed(1.0)
    start, _ = scene.place()
    step = scene.stepper._advance_to(1.0, 1.0, far=True)
    assert step.residual_norms[-1] < 1e-8 * LOAD
    messages = [text for text in caplog.messages if "no equilibrium near the last one" in text]
    assert len(messages) == (1 if MPI.COMM_WORLD.rank == 0 else 0)
    assert all("against a viscous resistance" in text for text in messages)
    check_snap(start, scene)


def disc(num_facets: int, turn: float, dt: float, squeeze: float) -> nts.QuasiStatic:
    """A disc of radius 1 m between two planes without friction, which close."""

    def build(model):
        occ = model.occ
        face = occ.addDisk(0, 0, 0, 1, 1)
        occ.rotate([(2, face)], 0, 0, 0, 0, 0, 1, turn)
        occ.synchronize()
        model.addPhysicalGroup(2, [face], name="disc")
        model.mesh.setSize(model.getEntities(0), 2 * np.pi / num_facets)
        model.mesh.generate(2)

    mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    body = nts.Body(V, cells, tag["disc"], nts.NeoHookean(1e6, 0.4, 1e3))
    pairs = []
    for side in (1, -1):
        plane = nts.RigidPlane(point=(0, -side), normal=(0, side))
        motion = nts.Motion(translation=lambda t, side=side: (0, side * squeeze * t))
        pairs.append(
            nts.ContactPair(
                nts.boundary_of(body),
                plane.moving(motion),
                enforcement=nts.LagrangeMultiplier(),
                method="node-to-segment",
            )
        )
    return nts.QuasiStatic([body], pairs, dt=dt)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("num_facets", "turn", "dt", "control"),
    [
        (32, 0.05, 0.05, None),
        (32, 0.05, 0.02, nts.StepControl(smallest=0.02 / 2**5)),
        (48, 0.0, 0.05, None),
    ],
)
def test_a_disc_between_planes_rolls_from_facet_to_facet(num_facets, turn, dt, control):
    """Nothing but the facets keeps it from rolling; planes press with no resultant nor moment."""
    stepper = disc(num_facets, turn, dt, 0.3)
    for _ in stepper.run(1.0, control):
        pass
    assert stepper.t == pytest.approx(1.0)
    forces = [pair.history.force.sum(axis=0) for pair in stepper.contacts]
    scale = np.linalg.norm(forces[0])
    assert np.linalg.norm(forces[0] + forces[1]) < 1e-9 * scale
    moment = 0.0
    for contact in stepper.contacts:
        x = stepper.x[contact.nodes.nodes]
        moment += float(np.cross(x, contact.history.force)[:, 2].sum())
    assert abs(moment) < 1e-9 * scale


def pressed(**laws: Any) -> nts.QuasiStatic:
    """A block that is pressed 0.03 m into another one and moved sideways, in one step."""
    scene = blocks(material=nts.NeoHookean(1e5, 0.3, 1e3))
    V, u = scene.V, fem.Function(scene.V)
    low = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], -0.5))
    top = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 1.02))

    def update(t):
        u.x.array.reshape(-1, 2)[top] = 0.01 * t, -0.05 * t

    pair = nts.ContactPair(scene.nodes, scene.segments, **(NODAL | laws))
    bcs = [fem.dirichletbc(u, dofs) for dofs in (low, top)]
    return nts.QuasiStatic([scene.lower, scene.upper], [pair], dt=1.0, bcs=bcs, update=update)


@pytest.mark.parametrize(
    "laws",
    [
        {"friction": nts.Coulomb(0.3)},
        once({}),
        once({"enforcement": nts.Penalty(1e6), "friction": nts.Coulomb(0.3)}),
        once({"method": "mortar", "friction": nts.Coulomb(0.3)}),
    ],
)
def test_a_resistance_leads_to_the_only_equilibrium(laws):
    """Slip, work and history refer to the step, for any number of pseudo-steps."""
    usual, far = pressed(**laws), pressed(**laws)
    expected = usual.advance()
    found = far._advance_to(1.0, 1.0, far=True)
    assert far.u.x.array == pytest.approx(usual.u.x.array, abs=1e-10)
    work = np.array(found.contact_work) / expected.support_work
    assert work == pytest.approx(np.array(expected.contact_work) / expected.support_work, abs=1e-8)
    assert found.support_work == pytest.approx(expected.support_work, rel=1e-8)
    for other, history in zip(far.contacts, [c.history for c in usual.contacts], strict=True):
        assert (other.history.active == history.active).all()
        assert (other.history.sliding == history.sliding).all()


@pytest.mark.serial
def test_a_block_that_is_sheared_rolls_over_its_edge():
    """Nearly incompressible, and with as much friction as pressure, it snaps before t = 8."""
    num, nu, mu = 16, 0.49, 1.0

    def build(model):
        size = {"corner": (0, 0), "size": (1, 1), "cells": (num, num)}
        parts.add_rectangle(model, "block", **size)

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    body = nts.Body(V, cells, tag["block"], nts.NeoHookean(1e6, nu, 1e3))
    driven = fem.Constant(mesh, np.zeros(2))
    top = fem.locate_dofs_topological(V, 1, facets.find(tag["block_top"]))

    def update(t):
        driven.value[:] = 0.05 * max(t - 1, 0), -0.05 * min(t, 1)

    plane = nts.RigidPlane((0, 0), (0, 1))
    pair = nts.ContactPair(
        nts.boundary_of(body),
        plane,
        friction=nts.Coulomb(mu),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    bcs = [fem.dirichletbc(driven, top, V)]
    stepper = nts.QuasiStatic([body], [pair], dt=1.0, bcs=bcs, update=update)
    *_, last = stepper.run(8.0)
    (contact,) = stepper.contacts
    force, y = contact.history.force[:, :2], stepper.x[contact.nodes.nodes, 1]
    pressing = np.linalg.norm(force, axis=1) > 0
    assert np.abs(y[pressing]).max() < 1e-9 and y.min() > -1e-9
    assert (np.abs(force[:, 0]) <= mu * np.abs(force[:, 1]) * (1 + 1e-6) + 1e-6).all()
    total = np.abs(force.sum(axis=0))
    assert total == pytest.approx(np.abs(last.reactions[0].force[:2]), rel=1e-7)


@pytest.mark.serial
def test_equal_steps_are_halved_before_they_are_relaxed(caplog):
    """A disc that nearly fits into its cup: the whole step fails, and both halves succeed."""

    def build(model):
        occ = model.occ
        disc, block = occ.addDisk(0, 0, 0, 5, 5), occ.addRectangle(-8, -8, 0, 16, 8)
        (cup,), _ = occ.cut([(2, block)], [(2, occ.addDisk(0, 0, 0, 5.05, 5.05))])
        occ.synchronize()
        for body, name, size in (((2, disc), "disc", 1.4), (cup, "cup", 1.9)):
            model.addPhysicalGroup(2, [body[1]], name=name)
            model.mesh.setSize(model.getBoundary([body], recursive=True), size)
        model.mesh.generate(2)

    mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    rubber = nts.NeoHookean(E=100.0, nu=0.3, rho=1.0)
    disc, cup = (nts.Body(V, cells, tag[name], rubber) for name in ("disc", "cup"))
    core = fem.locate_dofs_geometrical(V, lambda x: np.hypot(x[0], x[1]) < 2.2)
    bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], -8))
    push = fem.Constant(mesh, np.zeros(2))

    def update(t):
        push.value[1] = -t

    stepper = nts.QuasiStatic(
        [disc, cup],
        [nts.ContactPair(nts.boundary_of(disc), nts.boundary_of(cup))],
        dt=1.0,
        bcs=[fem.dirichletbc(push, core, V), fem.dirichletbc(np.zeros(2), bottom, V)],
        update=update,
    )
    with caplog.at_level(logging.DEBUG, logger="dolfinx_nts"):
        assert [step.t for step in stepper.run(until=1.0)] == [0.5, 1.0]
    assert any("is cut" in text for text in caplog.messages)
    assert not any("pseudo-step" in text for text in caplog.messages)
