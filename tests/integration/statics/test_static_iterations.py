"""Newton iterations of statics where contact, stick and slip change at many nodes in one step."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.laws import NODAL
from helpers.models.belt import ANGLE, MU, PULL, RADIUS, THICKNESS, belt
from helpers.models.plane import blocks
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks


def pressed_and_drawn(**laws) -> nts.QuasiStatic:
    """A block that is pressed 0.05 m into another one until t = 1, and then pulled along it."""
    scene = blocks(width=12, material=nts.NeoHookean(1e5, 0.3, 1e3))
    V, u = scene.V, fem.Function(scene.V)
    low = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], -0.5))
    top = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 1.02))

    def update(t):
        u.x.array.reshape(-1, 2)[top] = 0.1 * max(t - 1, 0), -0.07 * min(t, 1)

    pair = nts.ContactPair(scene.nodes, scene.segments, **(NODAL | laws))
    bcs = [fem.dirichletbc(u, dofs) for dofs in (low, top)]
    bodies = [scene.lower, scene.upper]
    return nts.QuasiStatic(bodies, [pair], dt=0.25, bcs=bcs, update=update)


@pytest.mark.parametrize(("mu", "most"), [once(0.0, 40), (0.3, 55)])
def test_mortar_points_are_renewed_before_equilibrium(mu, most):
    """Equilibrium on points that will not stay need not be found to the last digit."""
    friction = nts.Coulomb(mu) if mu else None
    stepper = pressed_and_drawn(friction=friction, method="mortar")
    assert sum(step.newton_iterations for step in stepper.run(until=2.0)) <= most


@pytest.mark.serial
@pytest.mark.parametrize(("dt", "most", "longest"), [(0.1, 75, 10), (1.0, 16, 8)])
def test_a_belt_begins_to_slide_with_few_iterations(dt, most, longest):
    """All states are determined together: one by one they take 103 iterations, and 43."""
    iterations = []
    for step in belt(dt).stepper.run(until=max(1.4, 2 * dt)):
        iterations.append(step.newton_iterations)
        (reaction,) = step.reactions
    assert max(iterations) <= longest
    assert sum(iterations) <= most
    ratio = np.exp(MU * ANGLE * RADIUS / (RADIUS + THICKNESS / 2))
    assert reaction.force[0] / PULL == pytest.approx(ratio, rel=1e-2)


def test_a_strip_begins_to_slide_with_few_iterations(comm):
    """Its top is pressed and drawn, so that slip spreads inwards; one by one nodes take up to 7."""

    def build(model):
        size = {"corner": (0, 0), "size": (6, 0.5), "cells": (60, 4)}
        nts.parts.add_rectangle(model, "strip", **size)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    strip = nts.Body(V, cells, tag["strip"], nts.NeoHookean(E=1e6, nu=0.3, rho=1e3))
    driven = fem.Constant(mesh, np.zeros(2))
    top = fem.locate_dofs_topological(V, 1, facets.find(tag["strip_top"]))

    def update(t):
        driven.value[:] = 0.05 * max(t - 0.1, 0), -0.01 * min(t / 0.1, 1)

    bottom = nts.Surface(V, facets, tag["strip_bottom"])
    pair = nts.ContactPair(
        bottom,
        nts.RigidPlane((0, 0), (0, 1)),
        friction=nts.Coulomb(0.3),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    bcs = [fem.dirichletbc(driven, top, V)]
    stepper = nts.QuasiStatic([strip], [pair], dt=0.1, bcs=bcs, update=update)
    assert max(step.newton_iterations for step in stepper.run(until=0.6)) <= 5


@pytest.mark.serial
@pytest.mark.parametrize("load", [150.0, 1500.0])
def test_a_pin_finds_its_place_in_a_hole_with_few_iterations(comm, load):
    """Contact alone holds it: where nodes are decided one by one it goes to and fro 446 times."""
    radius, hole, plate = 0.1, 0.1002, 0.25

    def build(model):
        pin, whole, inner = (model.occ.addDisk(0, 0, 0, r, r) for r in (radius, plate, hole))
        model.occ.cut([(2, whole)], [(2, inner)])
        model.occ.synchronize()
        for tag, name in ((pin, "pin"), (whole, "plate")):
            model.addPhysicalGroup(2, [tag], name=name)
            model.mesh.setRecombine(2, tag)
        model.mesh.setSize(model.getEntities(0), 0.02)
        model.mesh.generate(2)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    rubber = nts.NeoHookean(1e6, 0.3, 1e3)
    bodies = [nts.Body(V, cells, tag[name], rubber) for name in ("pin", "plate")]
    pair = nts.ContactPair(
        *map(nts.boundary_of, bodies),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    rim = fem.locate_dofs_geometrical(V, lambda x: np.hypot(x[0], x[1]) > 0.999 * plate)
    weight = nts.Gravity(bodies[:1], (0.0, -load / (1e3 * np.pi * radius**2)))
    bcs = [fem.dirichletbc(np.zeros(2), rim, V)]
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, loads=[weight])
    step = stepper.advance()
    # At the start vertices of both polygons are exactly above each other; then they slide apart.
    assert step.newton_iterations <= 20
    (reaction,) = step.reactions
    # Both hole and pin are polygons, which reduces the weight of the pin.
    assert reaction.force[1] == pytest.approx(load, rel=0.03)


@pytest.mark.serial
def test_springs_hold_a_belt_with_few_iterations():
    """Gaps that are left where it turns and goes around, times stiffness, decide on nothing."""
    stepper = belt(0.1, nts.Penalty()).stepper
    iterations = []
    for step in stepper.run(until=1.4):
        iterations.append(step.newton_iterations)
        (reaction,) = step.reactions
    # Laid on, tensioned, and moved until it slides everywhere. A step without change of contact
    # takes 4 iterations, and no step fails.
    assert max(iterations[1:10]) <= 6
    assert sum(iterations) <= 200
    ratio = np.exp(MU * ANGLE * RADIUS / (RADIUS + THICKNESS / 2))
    assert reaction.force[0] / PULL == pytest.approx(ratio, rel=1e-2)


@pytest.mark.serial
def test_a_disc_indents_a_nearly_incompressible_block_with_few_iterations(comm):
    """The extrapolated start is left after one long increment, before it wanders for 57 others."""

    def build(model):
        size = {"corner": (-0.03, -0.02), "size": (0.06, 0.02), "cells": (48, 16)}
        nts.parts.add_rectangle(model, "block", **size)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    rubber = nts.NeoHookean(7.0e6, 0.4995, 1e3)
    disc = nts.RigidSphere(centre=(0.0, 0.01), radius=0.01)
    down = nts.Motion(translation=lambda t: (0.0, -0.005 * t))
    low = fem.locate_dofs_topological(V, 1, facets.find(tag["block_bottom"]))
    stepper = nts.QuasiStatic(
        [nts.Body(V, cells, tag["block"], rubber)],
        [
            nts.ContactPair(
                nts.Surface(V, facets, tag["block_top"]),
                disc.moving(down),
                enforcement=nts.LagrangeMultiplier(),
                method="node-to-segment",
            )
        ],
        dt=0.1,
        bcs=[fem.dirichletbc(np.zeros(2), low, V)],
    )
    iterations = [step.newton_iterations for step in stepper.run(until=0.5)]
    assert max(iterations) <= 16
    assert sum(iterations) <= 70
    solver = stepper.statistics.solver
    assert solver.num_builds + solver.num_direct <= 25


@pytest.mark.serial
def test_a_strip_of_metal_bends_around_a_circle_with_few_iterations(comm):
    """Few points stop to flow, late on increments that chords cut to a twentieth."""

    def build(model):
        size = {"corner": (-0.03, 0), "size": (0.06, 0.001), "cells": (80, 4)}
        nts.parts.add_rectangle(model, "strip", **size)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    metal = nts.J2Plasticity(70e9, 0.3, 2700, yield_stress=150e6, hardening=300e6)
    W = V.sub(0)
    middle, _ = fem.locate_dofs_geometrical((W, W.collapse()[0]), lambda x: np.isclose(x[0], 0))
    down = nts.Motion(translation=lambda t: (0.0, -0.025 * t))
    rollers = [nts.RigidSphere((x, 0.006), 0.005).moving(down) for x in (-0.0213, 0.0213)]
    obstacles = {"bottom": [nts.RigidSphere((0.0, -0.015), 0.015)], "top": rollers}
    stepper = nts.QuasiStatic(
        [nts.Body(V, cells, tag["strip"], metal)],
        [
            nts.ContactPair(
                nts.Surface(V, facets, tag[f"strip_{side}"]),
                obstacle,
                enforcement=nts.LagrangeMultiplier("plastic"),
                friction=nts.Coulomb(0.1),
                method="node-to-segment",
            )
            for side, each in obstacles.items()
            for obstacle in each
        ],
        dt=0.025,
        bcs=[fem.dirichletbc(np.float64(0), middle, W)],
    )
    # The first step finds contact.
    _, *later = (step.newton_iterations for step in stepper.run(until=0.25))
    assert max(later) <= 18
    assert sum(later) <= 105


@pytest.mark.serial
def test_reversed_motion_takes_no_more_iterations_than_its_start():
    """Nodes do not move as in the last step where their supports do not."""
    scene = blocks(width=12, material=nts.NeoHookean(1e5, 0.49, 1e3))
    u = fem.Function(scene.V)
    low, top = (
        fem.locate_dofs_geometrical(scene.V, lambda x, y=y: np.isclose(x[1], y))
        for y in (-0.5, 1.02)
    )

    def update(t):
        """Press down until t = 1, draw sideways until t = 2, wait until t = 3, and go back."""
        travel = 0.2 * min(max(t - 1, 0), 1, 4 - t), -0.2 * min(t, 1, 4 - t)
        u.x.array.reshape(-1, 2)[top] = travel

    pair = nts.ContactPair(
        scene.nodes,
        scene.segments,
        friction=nts.Coulomb(1.0),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    bcs = [fem.dirichletbc(u, dofs) for dofs in (low, top)]
    bodies = [scene.lower, scene.upper]
    stepper = nts.QuasiStatic(bodies, [pair], dt=0.25, bcs=bcs, update=update)
    iterations = [step.newton_iterations for step in stepper.run(until=3.5)]
    assert max(iterations) <= 8
    assert sum(iterations[8:12]) == 0


@pytest.mark.serial
def test_a_first_step_that_fails_is_not_tried_twice_from_the_same_state():
    """There is no last step whose motion might continue."""
    scene = blocks(material=nts.NeoHookean(1e5, 0.3, 1e3))
    low = fem.locate_dofs_geometrical(scene.V, lambda x: np.isclose(x[1], -0.5))
    top = nts.Surface.where(scene.V, lambda x: np.isclose(x[1], 1.02))
    stepper = nts.QuasiStatic(
        [scene.lower, scene.upper],
        [
            nts.ContactPair(
                scene.nodes,
                scene.segments,
                friction=nts.Coulomb(0.3),
                enforcement=nts.LagrangeMultiplier(),
                method="node-to-segment",
            )
        ],
        dt=1.0,
        bcs=[fem.dirichletbc(np.zeros(2), low, scene.V)],
        loads=[nts.Traction(top, (0, -1e7))],
    )
    with pytest.raises(nts.ConvergenceError) as error:
        stepper.advance()
    assert "from the last state" in str(error.value)
    assert "extrapolated" not in str(error.value)


@pytest.mark.serial
@pytest.mark.parametrize("dt", [0.5, once(0.25)])
def test_a_rigid_roller_bends_a_thin_strip_with_few_iterations(comm, dt):
    """Line contact of a few nodes on a strip that is far softer than they are, by a guided tool."""
    length, width, thickness, at, E = 20.0, 4.0, 0.8, 15.0, 1000.0  # mm, MPa

    def fill(model):
        occ = model.occ
        strip = occ.addBox(0, 0, -thickness, length, width, thickness)
        roll = occ.addCylinder(at, -1, 1.5, 0, width + 2, 0, 1.5)
        occ.synchronize()
        for name, volume, size in (("strip", strip, 0.9), ("roll", roll, 0.6)):
            model.addPhysicalGroup(3, [volume], name=name)
            model.mesh.setSize(model.getBoundary([(3, volume)], recursive=True), size)
        model.mesh.generate(3)
        model.mesh.setOrder(2)

    mesh, cells, _, tag = nts.read_mesh(fill, comm)
    V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    strip = nts.Body(V, cells, tag["strip"], nts.SaintVenantKirchhoff(E=E, nu=0, rho=1e-9))
    down = nts.Guide(motion=nts.Motion(translation=lambda t: (0, 0, -t)))
    roll = nts.RigidBody(V, cells, tag["roll"], rho=1e-9, guide=down)
    clamp = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0))
    bcs = [fem.dirichletbc(np.zeros(3), clamp, V)]
    stepper = nts.QuasiStatic([strip, roll], nts.all_pairs([strip, roll]), dt=dt, bcs=bcs)
    steps = list(stepper.run(until=1.0))
    assert len(steps) == round(1 / dt)
    assert max(step.newton_iterations for step in steps) <= 18
    of_beam = 3 * E * width * thickness**3 / 12 / at**3  # N, for a deflection of 1 mm
    assert steps[-1].reactions[0].force[2] == pytest.approx(of_beam, rel=0.02)
