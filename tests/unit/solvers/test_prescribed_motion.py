"""Supports with large displacements in one static step, also near incompressibility."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.meshing import parts
from dolfinx_nts.solvers import substepped_motion
from dolfinx_nts.solvers.substepped_motion import boundary_increment, largest_strain
from helpers.once import once, once_except

# Of energies and forces, relative: displacements are known to the tolerance of Newton's method.
AGREEMENT = 1e-7


def press(comm, law, travel, *, nu=0.499, n=3, cell="hexahedron", degree=1, table=False):
    """Return a block with supported ends; the upper one moves down by a speed [m/s]."""

    def build(model):
        box = {"corner": (0.0, 0.0, 0.0), "size": (1.0, 1.0, 1.0), "cells": (n, n, n)}
        parts.add_box(model, "block", **box, cell=cell)
        if table:
            box = {"corner": (-0.3, -0.1, -0.5), "size": (1.5, 1.6, 0.5), "cells": (n, n, 2)}
            parts.add_box(model, "table", **box, cell=cell)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    names = ["block", "table"] if table else ["block"]
    bodies = [nts.Body(V, cells, tag[name], law(1e5, nu, 1e3)) for name in names]
    sides = [
        nts.Surface(V, facets, tag[side]) for side in ("block_bottom", "table_top")[: 2 * table]
    ]
    pairs = (
        [nts.ContactPair(*sides, enforcement=nts.LagrangeMultiplier(), method="node-to-segment")]
        if table
        else []
    )
    u = fem.Constant(mesh, (0.0, 0.0, 0.0))
    held = {
        side: fem.locate_dofs_topological(V, 2, facets.find(tag[side]))
        for side in ("block_top", "table_bottom" if table else "block_bottom")
    }
    lower = fem.dirichletbc(np.zeros(3), held.popitem()[1], V)
    upper = fem.dirichletbc(u, held["block_top"], V)

    def update(t):
        u.value[2] = -travel * t

    return nts.QuasiStatic(bodies, pairs, dt=1.0, bcs=[lower, upper], update=update)


def result(stepper, step):
    """Return the strain energy and the force of the upper end."""
    return [nts.Diagnostics(stepper).strain_energy(), *step.reactions[1].force]


CASES = {
    "neo-Hooke": (nts.NeoHookean, 0.25, {"n": 4}),
    "St. Venant-Kirchhoff": (nts.SaintVenantKirchhoff, 0.2, {}),
    "tetrahedra of degree 2": (
        *(nts.SaintVenantKirchhoff, 0.15),
        {"n": 2, "cell": "tetrahedron", "degree": 2},
    ),
    "contact": (nts.NeoHookean, 0.1, {"table": True}),
}


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("case", once_except(list(CASES), "tetrahedra of degree 2", "contact"))
def test_one_step_leads_where_many_lead(comm, case):
    law, travel, options = CASES[case]
    whole, parts_of_it = (press(comm, law, travel, **options) for _ in range(2))
    report = whole.advance()
    # With supports moved in one increment, 50 iterations from each start fail.
    assert report.newton_iterations <= 35
    for step in parts_of_it.run(until=1.0, control=nts.StepControl(times=np.arange(1, 9) / 8)):
        assert step.newton_iterations <= 20
    expected = result(parts_of_it, step)
    np.testing.assert_allclose(result(whole, report), expected, atol=AGREEMENT * max(expected))


def punch(comm, kind, depth):
    """Return a metal sheet on which a tool comes down that is above it at the start."""
    gap = 0.03

    def build(model):
        box = {"corner": (-0.25, -0.25, -0.1), "size": (0.5, 0.5, 0.1), "cells": (10, 10, 2)}
        parts.add_box(model, "sheet", **box)
        if kind != "obstacle":
            box = {"corner": (-0.1, -0.1, gap), "size": (0.2, 0.2, 0.1), "cells": (2, 2, 1)}
            parts.add_box(model, "punch", **box)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    metal = nts.J2Plasticity(70e9, 0.33, 2.7e3, yield_stress=2e8, hardening=5e8)
    bodies = [nts.Body(V, cells, tag["sheet"], metal)]
    X = V.tabulate_dof_coordinates()
    edge = np.isclose(np.abs(X[:, :2]), 0.25).any(axis=1) & (X[:, 2] < 1e-9)
    top = np.isclose(X[:, 2], gap + 0.1)
    own = V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts
    held, driven = (np.flatnonzero(flags[:own]).astype(np.int32) for flags in (edge, top))
    u = fem.Constant(mesh, (0.0, 0.0, 0.0))
    bcs = [fem.dirichletbc(np.zeros(3), held, V)]
    motion = nts.Motion(lambda t: (0.0, 0.0, -(depth + gap) * t))
    if kind == "obstacle":
        tool = nts.RigidSphere(centre=(0.0, 0.0, 0.3 + gap), radius=0.3).moving(motion)
    else:
        tool = nts.Surface(V, facets, tag["punch_bottom"])
    if kind == "guide":
        guide = nts.Guide(motion=motion)
        bodies.append(nts.RigidBody(V, cells, tag["punch"], 7e3, guide=guide))
    if kind == "supports":
        bodies.append(nts.Body(V, cells, tag["punch"], nts.NeoHookean(2e11, 0.3, 7e3)))
        bcs.append(fem.dirichletbc(u, driven, V))

    def update(t):
        u.value[2] = -(depth + gap) * t

    sheet = nts.Surface(V, facets, tag["sheet_top"])
    pair = nts.ContactPair(
        sheet,
        tool,
        friction=nts.Coulomb(0.1),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    return nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, update=update)


@pytest.mark.parametrize("kind", ["obstacle", "guide", "supports"])
@pytest.mark.parametrize("depth", [once(0.01), 0.02])
def test_tools_that_meet_a_sheet_within_the_increment(comm, kind, depth):
    # A guided body moved in one increment by a fifth of the sheet takes 68 iterations.
    stepper = punch(comm, kind, depth)
    assert stepper.advance().newton_iterations <= 20
    force = nts.Diagnostics(stepper).contact_force()
    assert force[2] < -1e6 and abs(force[:2]).max() < 1e-2 * -force[2]


@pytest.mark.serial
def test_forces_of_the_increment_equal_the_residual(comm, rng):
    stepper = press(comm, nts.NeoHookean, 0.05)
    bulk = stepper._bulk
    u = bulk.u.x.array
    u[:] = 0.01 * rng.normal(size=u.size)
    travel = boundary_increment(bulk)
    assert not np.any(np.delete(travel.ravel(), bulk.supports.fixed))
    expected, before, errors = bulk.action(travel, with_prescribed=True).ravel(), u.copy(), []
    for part in (1e-3, 5e-4):
        u[:] = before + part * travel.ravel()
        after = bulk.forces()
        u[:] = before - part * travel.ravel()
        change = (after - bulk.forces()) / (2 * part)
        change[bulk.is_prescribed] = 0
        errors.append(np.linalg.norm(change - expected))
    assert errors[1] == pytest.approx(errors[0] / 4, rel=0.1)
    u[:] = before
    u[:] = bulk.supports.applied(u)
    assert boundary_increment(bulk) is None


@pytest.mark.serial
def test_only_deformation_of_cells_counts_not_their_translation(comm):
    bulk = press(comm, nts.NeoHookean, 0.05, n=4)._bulk
    X = bulk.u.function_space.tabulate_dof_coordinates()
    assert largest_strain(bulk, np.full(X.size, 7.0)) == 0
    assert largest_strain(bulk, 0.3 * X.ravel()) == pytest.approx(0.3)


@pytest.mark.serial
def test_negligible_remainder_of_the_motion_is_applied_at_once(comm, monkeypatch):
    """Its forces are lost in the round-off of the residual, which never becomes smaller."""
    strains = []

    def measured(bulk, du):
        strains.append(largest_strain(bulk, du))
        return strains[-1]

    monkeypatch.setattr(substepped_motion, "largest_strain", measured)
    few = press(comm, nts.SaintVenantKirchhoff, 0.05, nu=0.3).advance().newton_iterations
    monkeypatch.setattr(substepped_motion, "_LARGEST_STRAIN", strains[0] * (1 - 1e-11))
    report = press(comm, nts.SaintVenantKirchhoff, 0.05, nu=0.3).advance()
    assert report.newton_iterations <= few + 1


@pytest.mark.parametrize("bonded", [False, True])
def test_prescribed_motion_continues_when_contact_supports_a_rigid_body(comm, bonded):
    # Rigidity forces balance the contact forces on its nodes, which do not vanish.
    def build(model):
        for name, corner, size, cells in (
            ("lower", (0.0, -0.5), (1.0, 0.5), (8, 4)),
            ("middle", (0.3, 0.0), (0.4, 0.2), (2, 1)),
            ("upper", (0.0, 0.2), (1.0, 0.5), (8, 4)),
        ):
            parts.add_rectangle(model, name, corner=corner, size=size, cells=cells)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    law = nts.NeoHookean(1e5, 0.3, 1e3)
    lower, upper = (nts.Body(V, cells, tag[name], law) for name in ("lower", "upper"))
    middle = nts.RigidBody(V, cells, tag["middle"], 1e3)
    sides = [nts.Surface(V, facets, tag[name]) for name in ("upper_bottom", "lower_top")]
    tie = nts.Tied() if bonded else None
    friction = None if bonded else nts.Coulomb(0.5)
    pairs = [
        nts.ContactPair(side, nts.boundary_of(middle), tie, friction, method="node-to-segment")
        for side in sides
    ]
    u = fem.Constant(mesh, (0.0, 0.0))
    ends = [
        fem.locate_dofs_topological(V, 1, facets.find(tag[side]))
        for side in ("lower_bottom", "upper_top")
    ]
    bcs = [fem.dirichletbc(np.zeros(2), ends[0], V), fem.dirichletbc(u, ends[1], V)]

    def update(t):
        u.value[1] = -0.15 * t

    stepper = nts.QuasiStatic([lower, middle, upper], pairs, dt=1.0, bcs=bcs, update=update)
    (step,) = stepper.run(until=1.0)
    force = [reaction.force[1] for reaction in step.reactions]
    assert force[0] > 1e3 and abs(sum(force)) < 1e-6 * force[0]


def test_body_moved_by_its_supports_delays_no_substep(comm):
    # The rotation is so large that it is applied in substeps, whose forces must not add up.
    def build(model):
        for name, corner in (("led", (0.0, 1.0)), ("loaded", (0.0, 0.0))):
            parts.add_rectangle(model, name, corner=corner, size=(0.9, 0.5), cells=(3, 2))

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    law = nts.NeoHookean(1e5, 0.3, 1e3)
    bodies = [nts.Body(V, cells, tag[name], law) for name in ("led", "loaded")]
    u = fem.Function(V)
    X = V.tabulate_dof_coordinates()[:, :2]
    driven = fem.locate_dofs_geometrical(V, lambda x: x[1] > 0.9)
    foot = fem.locate_dofs_geometrical(V, lambda x: x[1] < 0.1)
    angle = 0.25
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def update(t):
        u.x.array.reshape(-1, 2)[driven] = X[driven] @ (turn - np.eye(2)).T

    bcs = [fem.dirichletbc(np.zeros(2), foot, V), fem.dirichletbc(u, driven)]
    weight = nts.Gravity(bodies, (0.0, -9.81))
    stepper = nts.QuasiStatic(bodies, [], dt=1.0, bcs=bcs, loads=[weight], update=update)
    assert stepper.advance().newton_iterations <= 12
    given = (f.x.array.reshape(-1, 2)[driven] for f in (stepper.u, u))
    # Round-off of ghosts may differ between ranks.
    np.testing.assert_allclose(*given, rtol=0.0, atol=1e-15)


def test_a_resistance_lets_supports_reach_their_displacement(comm):
    """It takes more increments than Newton's method may take for what follows them."""
    law, travel, options = CASES["neo-Hooke"]
    usual, dragged = (press(comm, law, travel, **options) for _ in range(2))
    expected = result(usual, usual.advance())
    found = result(dragged, dragged._advance_to(1.0, 1.0, far=True))
    np.testing.assert_allclose(found, expected, atol=AGREEMENT * max(expected))
