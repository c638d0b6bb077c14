"""Unstable static equilibria: columns, strips and arches beyond buckling."""

from itertools import chain
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.integrators.statics.quasi_static import UnstableEquilibrium
from dolfinx_nts.solvers.linear.krylov import LinearSolver
from helpers.models.plane import blocks
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

LENGTH, HEIGHT, WIDTH, MODULUS = 1.0, 0.05, 0.1, 1e6  # m, m, m, Pa
TOLD = "the equilibrium is unstable"


def euler_load(dim: int, free_length: float) -> float:
    """Euler load of a column of this buckling length [N], in the plane for a width of 1 m."""
    inertia = HEIGHT**3 / 12 * (WIDTH if dim == 3 else 1.0)
    return float(np.pi**2 * MODULUS * inertia / free_length**2)


def column(
    dim: int, part: float, *, is_displaced: bool = False, nu: float = 0.0, pairs=None
) -> Any:
    """A column that is clamped at its left end, and pressed by a part of its Euler load.

    A dead force acts on its free right end; or a clamp there moves.
    """

    def build(model):
        if dim == 2:
            size = {"corner": (0, 0), "size": (LENGTH, HEIGHT), "cells": (20, 1)}
            parts.add_rectangle(model, "column", **size)
        else:
            size = {"corner": (0, 0, 0), "size": (LENGTH, HEIGHT, WIDTH), "cells": (20, 1, 1)}
            parts.add_box(model, "column", **size)

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 2, (dim,)))
    body = nts.Body(V, cells, tag["column"], nts.NeoHookean(MODULUS, nu, 1e3))
    ends = [
        fem.locate_dofs_topological(V, dim - 1, facets.find(tag[f"column_{side}"]))
        for side in ("left", "right")
    ]
    clamp = fem.dirichletbc(np.zeros(dim), ends[0], V)
    area = HEIGHT * (WIDTH if dim == 3 else 1.0)
    made = pairs(V, body, facets, tag) if pairs else []
    if is_displaced:
        travel = part * euler_load(dim, LENGTH / 2) * LENGTH / (MODULUS * area)
        drive = fem.dirichletbc(np.array([-travel, 0.0, 0.0][:dim]), ends[1], V)
        return nts.QuasiStatic([body], made, dt=1.0, bcs=[clamp, drive])
    pressure = part * euler_load(dim, 2 * LENGTH) / area
    load = nts.Traction(nts.Surface(V, facets, tag["column_right"]), (-pressure, 0.0, 0.0)[:dim])
    return nts.QuasiStatic([body], made, dt=1.0, bcs=[clamp], loads=[load])


def warnings_of(caplog: pytest.LogCaptureFixture) -> list[str]:
    """Warnings of an unstable equilibrium on any rank."""
    mine = [text for text in caplog.messages if TOLD in text]
    return list(chain(*MPI.COMM_WORLD.allgather(mine)))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("is_displaced", [once(False), True])
@pytest.mark.parametrize("part", [once(0.9), 1.1])
def test_a_column_is_unstable_beyond_its_euler_load(caplog, dim, is_displaced, part):
    """The column stays straight in both cases, as nothing pushes it sideways."""
    stepper = column(dim, part, is_displaced=is_displaced)
    stepper.advance()
    assert np.abs(stepper.u.x.array.reshape(-1, dim)[:, 1]).max(initial=0.0) < 1e-6 * HEIGHT
    warnings = warnings_of(caplog)
    assert len(warnings) == (part > 1)
    assert all("largest in column near" in text for text in warnings)


def test_a_strip_compressed_far_in_one_step_is_reported_once(caplog):
    stepper = column(2, 6.0, is_displaced=True)
    stepper.advance()
    stepper.advance()
    assert len(warnings_of(caplog)) == 1


def capped(part: float, *laws: Any) -> nts.QuasiStatic:
    """A column that is clamped at its left end, and pressed by a rigid cap that is free to slide.

    The cap is tied to its right end, and pushed by a part of the Euler load of two clamps.
    """

    def build(model):
        for name, left, length, cells in (("column", 0.0, LENGTH, 20), ("cap", LENGTH, HEIGHT, 1)):
            size = {"corner": (left, 0), "size": (length, HEIGHT), "cells": (cells, 1)}
            parts.add_rectangle(model, name, **size)

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    body = nts.Body(V, cells, tag["column"], nts.NeoHookean(MODULUS, 0.0, 1e3))
    cap = nts.RigidBody(V, cells, tag["cap"], 1e3, guide=nts.Guide(slides="x"))
    sides = [nts.Surface(V, facets, tag[name]) for name in ("column_right", "cap_left")]
    left = fem.locate_dofs_topological(V, 1, facets.find(tag["column_left"]))
    return nts.QuasiStatic(
        [body, cap],
        [nts.ContactPair(*sides, *laws)],
        dt=1.0,
        bcs=[fem.dirichletbc(np.zeros(2), left, V)],
        loads=[nts.Force(cap, (-part * euler_load(2, LENGTH / 2), 0.0))],
    )


@pytest.mark.parametrize(
    "laws",
    [(nts.Tied(),), once((nts.LagrangeMultiplier(), nts.Coulomb(1.0)))],
    ids=["tied", "pressed"],
)
@pytest.mark.parametrize("part", [0.9, 1.1])
def test_a_column_below_a_free_rigid_cap_is_unstable_beyond_its_euler_load(caplog, laws, part):
    """The signs of the pivots of the whole system decide."""
    stepper = capped(part, *laws)
    stepper.advance()
    assert np.abs(stepper.u.x.array.reshape(-1, 2)[:, 1]).max(initial=0.0) < 1e-6 * HEIGHT
    warnings = warnings_of(caplog)
    assert len(warnings) == (part > 1)
    assert all("largest in column near (0.5" in text for text in warnings)


def walls(V, body, facets, tag):
    """Two frictionless walls that touch the column along its whole length."""
    sides = {"bottom": (0.0, 1.0), "top": (HEIGHT, -1.0)}
    return [
        nts.ContactPair(
            nts.Surface(V, facets, tag[f"column_{side}"]),
            nts.RigidPlane((0, y), (0, normal)),
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
        for side, (y, normal) in sides.items()
    ]


def test_walls_keep_a_column_stable(caplog):
    """Beyond its Euler load it cannot go sideways; motions into contact do not count."""
    stepper = column(2, 2.0, is_displaced=True, nu=0.3, pairs=walls)
    assert stepper.advance().num_active > 0
    assert not warnings_of(caplog)


def test_a_shallow_arch_is_unstable_beyond_its_limit_load(caplog):
    """In the flat state it is stable with a prescribed displacement, but not under its weight."""
    span, rise, thick = 2.0, 0.06, 0.04

    def build(model):
        size = {"corner": (-span / 2, 0), "size": (span, thick), "cells": (20, 2)}
        parts.add_rectangle(model, "arch", **size)

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    x = mesh.geometry.x
    x[:, 1] += rise * (1 + np.cos(2 * np.pi * x[:, 0] / span)) / 2
    V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    body = nts.Body(V, cells, tag["arch"], nts.NeoHookean(MODULUS, 0.0, 1e3))
    sides = [facets.find(tag[f"arch_{side}"]) for side in ("left", "right")]
    ends = fem.locate_dofs_topological(V, 1, np.concatenate(sides))
    clamps = fem.dirichletbc(np.zeros(2), ends, V)

    def is_middle(x):
        return np.isclose(x[0], 0) & np.isclose(x[1], rise + thick / 2)

    W = V.sub(1)
    middle, _ = fem.locate_dofs_geometrical((W, W.collapse()[0]), is_middle)
    down = fem.Constant(mesh, 0.0)
    drive = fem.dirichletbc(down, middle, W)

    def update(t):
        down.value = -rise * t

    def made(weight, *bcs):
        """Statics with gravity [m/s^2]."""
        load = nts.Gravity([body], (0.0, -weight))
        return nts.QuasiStatic([body], dt=0.25, bcs=[clamps, *bcs], loads=[load], update=update)

    def driven(weight):
        """Move the top down; return the reaction force and the last state."""
        stepper = made(weight, drive)
        *_, last = stepper.run(1.0)
        return last.reactions[1].force[1], stepper

    # Weight with zero reaction there, by secants.
    weights, forces = [0.0, 0.2], [driven(0.0)[0], driven(0.2)[0]]
    while abs(forces[-1]) > 1e-9 * abs(forces[0]):
        (a, b), (f, g) = weights[-2:], forces[-2:]
        weights.append(b - g * (b - a) / (g - f))
        force, stepper = driven(weights[-1])
        forces.append(force)
    assert not warnings_of(caplog)
    free = made(1.0001 * weights[-1])
    free.set_displacement(body, stepper.u)
    free.advance()
    assert free.u.x.array == pytest.approx(stepper.u.x.array, abs=1e-2 * rise)
    assert len(warnings_of(caplog)) == 1


def pressed_and_drawn() -> nts.QuasiStatic:
    """A block that is pressed into another one with friction, and then pulled along it."""
    scene = blocks(width=12, material=nts.NeoHookean(1e5, 0.3, 1e3))
    V, u = scene.V, fem.Function(scene.V)
    low, top = (
        fem.locate_dofs_geometrical(V, lambda x, y=y: np.isclose(x[1], y)) for y in (-0.5, 1.02)
    )

    def update(t):
        u.x.array.reshape(-1, 2)[top] = 0.1 * max(t - 1, 0), -0.07 * min(t, 1)

    pair = nts.ContactPair(
        scene.nodes,
        scene.segments,
        friction=nts.Coulomb(0.3),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    bcs = [fem.dirichletbc(u, dofs) for dofs in (low, top)]
    return nts.QuasiStatic([scene.lower, scene.upper], [pair], dt=0.25, bcs=bcs, update=update)


def test_the_search_takes_few_products_and_nothing_else(caplog, monkeypatch):
    """A scene without instability is unchanged, to the last digit."""

    def run():
        stepper = pressed_and_drawn()
        for _ in stepper.run(until=2.0):
            pass
        return stepper, stepper._solver.statistics

    searched, some = run()
    assert not warnings_of(caplog)
    monkeypatch.setattr(LinearSolver, "negative_curvature_direction", lambda *arguments: None)
    usual, none = run()
    np.testing.assert_array_equal(searched.u.x.array, usual.u.x.array)
    for name in ("builds", "schwarz_builds", "direct", "tangents", "residuals", "iterations"):
        assert getattr(some, f"num_{name}") == getattr(none, f"num_{name}")
    steps = searched.step
    assert 0 < some.num_actions - none.num_actions <= 6 * steps
    assert some.num_actions <= 1.2 * none.num_actions


@pytest.mark.parametrize("has_friction", [False, True])
def test_friction_may_oppose_a_motion_that_is_reported(caplog, has_friction):
    found = UnstableEquilibrium(MPI.COMM_SELF, (), has_friction=has_friction)
    found.check(np.array([[1.0, 0.0]]), np.zeros((1, 3)), t=0.5)
    assert TOLD in caplog.text
    assert ("only more friction against this motion can prevent it" in caplog.text) == has_friction
