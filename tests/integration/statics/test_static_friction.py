"""Friction in statics is evaluated at the end of a step, for any rotation within it."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models.plane import blocks, turning
from helpers.once import once, once_except

pytestmark = pytest.mark.at_most_two_ranks

MU, ANGLE, TRAVEL, DEPTH = 0.3, 0.5, 0.25, 0.03  # -, rad, m, m
CENTRE = (0.0, -0.5)  # m


def press_and_turn(kind):
    """Press two blocks together, slide one of them and rotate both, all in one step.

    Returns the stepper with the pair, and the report.
    """
    scene = blocks()
    V = scene.V
    centre = np.array(CENTRE)[:, None]

    def top_u(low, high, extra):
        """Prescribed displacement of nodes between two heights: a shift, then a rotation."""
        u = fem.Function(V)

        def displacement(x):
            arm = x[:2] + extra[:, None] - centre
            return centre + turning(ANGLE) @ arm - x[:2]

        u.interpolate(displacement)
        dofs = fem.locate_dofs_geometrical(V, lambda x: (x[1] > low) & (x[1] < high))
        return fem.dirichletbc(u, dofs)

    bcs = [top_u(-0.51, -0.49, np.zeros(2)), top_u(1.01, 1.03, np.array([TRAVEL, -0.02 - DEPTH]))]
    segments, method, law = scene.segments, "node-to-segment", None
    if kind == "obstacle":
        motion = nts.Motion(rotation=lambda t: ANGLE * t, centre=CENTRE)
        segments = nts.RigidPlane((0.0, 0.0), (0.0, 1.0)).moving(motion)
    elif kind == "springs":
        law = nts.Penalty()
    elif kind != "facets":
        method = "mortar"
    pair = nts.ContactPair(scene.nodes, segments, law, nts.Coulomb(MU), method)
    stepper = nts.QuasiStatic([scene.lower, scene.upper], [pair], dt=1.0, bcs=bcs)
    return stepper, stepper.advance()


kinds = pytest.mark.parametrize(
    "kind", once_except(["facets", "obstacle", "springs", "mortar"], "springs", "mortar")
)


@kinds
def test_forces_and_moments_are_balanced(kind):
    stepper, step = press_and_turn(kind)
    force, moment = (
        np.array([getattr(reaction, name) for reaction in step.reactions])
        for name in ("force", "moment")
    )
    (pair,) = nts.Diagnostics(stepper).pairs().values()
    size = np.linalg.norm(pair.force)
    assert size > 1.0
    np.testing.assert_allclose(force[1], -pair.force, rtol=0, atol=1e-8 * size)
    np.testing.assert_allclose(moment[1], -pair.torque, rtol=0, atol=1e-8 * size)
    if kind != "obstacle":
        np.testing.assert_allclose(force[0], pair.force, rtol=0, atol=1e-8 * size)
        np.testing.assert_allclose(moment[0], pair.torque, rtol=0, atol=1e-8 * size)


def test_sliding_bodies_have_coulombs_friction_on_the_turned_surface():
    stepper, step = press_and_turn("obstacle")
    (contact,) = stepper.contacts
    assert step.num_active > 0 and contact.history.sliding[contact.history.active].all()
    along, away = turning(ANGLE).T
    force = nts.Diagnostics(stepper).contact_force()
    assert abs(force @ along / (force @ away) + MU) < 1e-8


@kinds
def test_the_ledger_closes(kind):
    stepper, step = press_and_turn(kind)
    diagnostics = nts.Diagnostics(stepper)
    defect, balance = diagnostics.after_step()
    given = sum(step.contact_work) + step.support_work + step.solver_work
    assert step.contact_work.friction < 0
    stored = balance.strain_energy
    assert abs(given + defect - stored) < 1e-9 * stored


ROUND = {
    "sphere": nts.RigidSphere((0.0, 0.0, 0.0), 0.5),
    "cylinder": nts.RigidCylinder((0.0, 0.0, 0.0), (0.3, 1.0, 0.0), 0.5),
}


@pytest.mark.parametrize("name", ROUND)
@pytest.mark.parametrize("law", [nts.LagrangeMultiplier(), once(nts.Penalty())], ids=repr)
@pytest.mark.parametrize("num_steps", [2, once(8)])
def test_nodes_that_slide_over_round_obstacles_have_coulombs_friction(comm, name, law, num_steps):
    """A block is loaded and moved obliquely: its nodes reach places with other tangent axes."""
    obstacle = ROUND[name]

    def build(model):
        size = {"corner": (-0.25, -0.25, 0.5), "size": (0.5, 0.5, 0.3), "cells": (5, 5, 2)}
        nts.parts.add_box(model, "block", **size)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, cells, tag["block"], nts.NeoHookean(E=1e5, nu=0.3, rho=1e3))
    top_u = fem.Constant(mesh, np.zeros(3))
    top = fem.locate_dofs_topological(V, 2, facets.find(tag["block_top"]))
    bcs = [fem.dirichletbc(top_u, top, V)]

    def update(t):
        top_u.value[:] = (0.0, 0.0, -0.06 * t) if t <= 1 else (0.2 * (t - 1), 0.13 * (t - 1), -0.06)

    bottom = nts.Surface(V, facets, tag["block_bottom"])
    pair = nts.ContactPair(bottom, obstacle, law, nts.Coulomb(MU), method="node-to-segment")
    stepper = nts.QuasiStatic([block], [pair], dt=0.25, bcs=bcs, update=update)
    for _ in stepper.run(until=1.0):
        pass
    stepper.dt = 1.0 / num_steps
    for _ in stepper.run(until=2.0):
        history, x = pair.history, stepper.x[bottom.nodes]
        slides = history.active & history.sliding
        force = history.force[slides]
        normal = obstacle.distance(x[slides])[1]
        pressing = np.einsum("mi,mi->m", force, normal)
        friction = np.linalg.norm(force - pressing[:, None] * normal, axis=1)
        assert comm.allreduce(int(slides.sum())) > 3
        np.testing.assert_allclose(friction, MU * pressing, rtol=0, atol=1e-6)
