"""Fixed and moving supports: motion and work against closed forms."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.model.loads.body_loads import Gravity
from dolfinx_nts.model.loads.surface_loads import Pressure, Traction
from helpers.models import box_meshes
from helpers.models.boxed import CLOSED, RHO, RUBBER, SIZE, SOLVED, VOLUME, Box, Ledger, swirl
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

cells_ = pytest.mark.parametrize("cell", ["hexahedron", once("tetrahedron")])
schemes = pytest.mark.parametrize("scheme", [nts.EnergyMomentum, once(nts.Midpoint)])


def parabola(t):
    """Displacement of constant acceleration 2, -1, 0.5."""
    return np.array([2.0, -1.0, 0.5]) * t**2 / 2


@cells_
@schemes
def test_reactions_of_an_accelerated_block_do_the_work_of_its_kinetic_energy(comm, cell, scheme):
    # All nodes are given, so the block stays rigid.
    box = Box(comm, cell)
    g = fem.Constant(box.mesh, np.zeros(3))
    dofs = fem.locate_dofs_geometrical(box.V, lambda X: np.full(X.shape[1], True))
    times = []

    def move(t):
        times.append(t)
        g.value[:] = parabola(t)

    stepper = scheme([box.body], dt=0.05, bcs=[fem.dirichletbc(g, dofs, box.V)], update=move)
    ledger = Ledger(stepper)
    ledger.run(6)
    np.testing.assert_allclose(times, 0.05 * np.arange(1, 7))
    kinetic = RHO * VOLUME * (4 + 1 + 0.25) * 0.3**2 / 2
    assert ledger.gained == pytest.approx(kinetic, rel=SOLVED)
    assert ledger.total("support_work") == pytest.approx(kinetic, rel=SOLVED)


@cells_
@schemes
def test_energy_of_a_shaken_and_loaded_block_is_accounted_for(comm, cell, scheme):
    box = Box(comm, cell)
    face = fem.Function(box.V)
    bc = fem.dirichletbc(face, box.dofs(0))

    def shake(t):
        face.interpolate(lambda X: 0.2 * np.array([np.sin(20 * t) + 0 * X[0], t * X[2], t * X[1]]))

    loads = [
        Gravity([box.body], (0, 0, -9.81)),
        Pressure(box.surface("top 0"), lambda t: 100 * t),
        Traction(box.surface("bottom 0"), (1.0, 2.0, 3.0)),
    ]
    stepper = scheme([box.body], dt=0.02, bcs=[bc], loads=loads, update=shake)
    ledger = Ledger(stepper)
    ledger.run(8)
    assert abs(ledger.total("support_work")) > 0.1
    assert ledger.error <= CLOSED


@pytest.mark.serial
def test_support_at_rest_does_no_work(comm):
    box = Box(comm)
    bcs = [fem.dirichletbc(np.zeros(3), box.dofs(2), box.V)]
    stepper = nts.EnergyMomentum([box.body], dt=0.02, bcs=bcs)
    stepper.set_velocity(box.body, lambda X: X[2] * swirl(X))
    ledger = Ledger(stepper)
    ledger.run(5)
    assert ledger.total("support_work") == 0
    assert ledger.error <= CLOSED
    assert abs(ledger.gained) <= SOLVED


def test_work_of_a_support_that_strikes_a_body_equals_that_of_contact(comm):
    # The lower block is driven; its top nodes are prescribed and in contact.
    data = box_meshes.boxes([(2, 2, 1), (1, 1, 1)], [(1.0, 1.0, 0.5), (0.6, 0.7, 0.5)])
    data.X[data.cells[data.body == 1].ravel().min() :] += [0.15, 0.17, 0.52]
    mesh, cells, facets, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bodies = [nts.Body(V, cells, tag[f"body {i}"], RUBBER) for i in range(2)]
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["bottom 1"]),
        nts.Surface(V, facets, tag["top 0"]),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    g = fem.Constant(mesh, np.zeros(3))

    def lift(t):
        g.value[2] = 0.5 * t

    stepper = nts.EnergyMomentum(
        bodies, [pair], dt=0.01, bcs=[fem.dirichletbc(g, bodies[0].nodes, V)], update=lift
    )
    stepper.set_velocity(bodies[0], (0.0, 0.0, 0.5))
    stepper.set_velocity(bodies[1], (0.0, 0.0, -0.5))
    ledger = Ledger(stepper)
    ledger.run(10)
    assert max(report.num_active for report in ledger.reports) == 4
    assert ledger.total("support_work") > 0.1
    assert ledger.error <= CLOSED


@pytest.mark.serial
def test_bar_swings_with_its_period(comm):
    r"""Lowest mode of a clamped bar, whose exact period is 4 L / c.

    n linear cells of length l: w^2 = 6 (c/l)^2 (1 - cos k l)/(2 + cos k l),
    k = pi/(2 L); a step turns the mode by 2 atan(w dt/2).
    """
    n, length, E, dt = 12, 2.0, 900.0, 0.004
    box = Box(
        comm,
        material=nts.SaintVenantKirchhoff(E, 0.0, 1.0),
        shape=(n, 1, 1),
        size=(length, 0.1, 0.1),
    )
    bcs = [fem.dirichletbc(np.zeros(3), box.dofs(0), box.V)]
    stepper = nts.EnergyMomentum([box.body], dt=dt, bcs=bcs)
    k, cell, c, v = np.pi / (2 * length), length / n, np.sqrt(E), 1e-5
    stepper.set_velocity(box.body, lambda X: v * np.array([np.sin(k * X[0]), 0 * X[0], 0 * X[0]]))
    w = c / cell * np.sqrt(6 * (1 - np.cos(k * cell)) / (2 + np.cos(k * cell)))
    turn = 2 * np.arctan(w * dt / 2)
    X = box.positions(stepper)
    for step in range(1, 71):
        stepper.advance()
        if step % 10 == 0:
            tip = (box.positions(stepper) - X)[np.isclose(X[:, 0], length), 0]
            # Second order in the amplitude 1e-6 is left out.
            np.testing.assert_allclose(tip, v / w * np.sin(step * turn), atol=1e-5 * v / w)
    assert 2 * np.pi / turn * dt == pytest.approx(4 * length / c, rel=2e-3)


def test_failed_step_of_a_support_leaves_the_state_and_can_be_repeated(comm, refused, agree):
    box = Box(comm)
    g = fem.Constant(box.mesh, np.zeros(3))
    jump = [2.0]

    def push(t):
        g.value[0] = jump[0] * t

    bcs = [fem.dirichletbc(np.zeros(3), box.dofs(2), box.V)]
    top = fem.locate_dofs_geometrical(box.V, lambda X: np.isclose(X[2], SIZE[2]))
    bcs.append(fem.dirichletbc(g, top, box.V))
    stepper = nts.EnergyMomentum([box.body], dt=0.02, bcs=bcs, update=push)
    stepper.advance()
    before = stepper.u.x.array.copy(), stepper.v.x.array.copy()
    jump[0] = 1e6
    with refused(nts.ConvergenceError, "step 2 from t = 0.02 to 0.04 failed"):
        stepper.advance()
    assert agree(np.array_equal(stepper.u.x.array, before[0]))
    assert agree(np.array_equal(stepper.v.x.array, before[1]))
    assert (stepper.t, stepper.step) == (0.02, 1)
    jump[0] = 2.0
    assert stepper.advance().step == 2


def test_conflicting_conditions_are_named(comm, refused):
    box = Box(comm)
    g = fem.Constant(box.mesh, np.zeros(3))
    bcs = [
        fem.dirichletbc(np.zeros(3), box.dofs(0), box.V),
        fem.dirichletbc(np.zeros(3), box.dofs(1), box.V),
        fem.dirichletbc(g, box.dofs(2), box.V),
    ]

    def move(t):
        g.value[1] = t

    stepper = nts.EnergyMomentum([box.body], dt=0.5, bcs=bcs, update=move)
    message = (
        r"one displacement per dof, given 0 m by bcs\[\d\] and 0.5 m by bcs\[2\] in direction y"
    )
    with refused(ValueError, message):
        stepper.advance()
    assert stepper.t == 0
    g.value[1] = 1.0
    with refused(ValueError, r"given 0 m by bcs\[\d\] and 1 m by bcs\[2\] in direction y near"):
        nts.EnergyMomentum([box.body], dt=0.5, bcs=bcs)
    g.value[1] = np.nan
    with refused(ValueError, "expected finite displacements in bcs, given nan"):
        nts.EnergyMomentum([box.body], dt=0.5, bcs=bcs[2:])


def test_conditions_on_components_do_not_conflict(comm):
    box = Box(comm)
    x_dofs, z_dofs = (
        fem.locate_dofs_geometrical(
            (box.V.sub(i), box.V.sub(i).collapse()[0]), lambda X, i=i: np.isclose(X[i], 0)
        )
        for i in (0, 2)
    )
    zero = [fem.Function(box.V.sub(i).collapse()[0]) for i in (0, 2)]
    bcs = [
        fem.dirichletbc(zero[0], x_dofs, box.V.sub(0)),
        fem.dirichletbc(zero[1], z_dofs, box.V.sub(2)),
    ]
    stepper = nts.EnergyMomentum([box.body], dt=0.02, bcs=bcs)
    stepper.set_velocity(box.body, (0.0, 1.0, 0.0))
    stepper.advance()
    np.testing.assert_allclose(stepper.u.x.array.reshape(-1, 3)[:, 1], 0.02, atol=SOLVED)


def test_wrong_conditions_are_refused(comm, refused):
    box, other = Box(comm), Box(comm)
    with refused(TypeError, "expected a DirichletBC, given Constant"):
        nts.EnergyMomentum([box.body], dt=1.0, bcs=[fem.Constant(box.mesh, np.zeros(3))])
    bc = fem.dirichletbc(np.zeros(3), other.dofs(0), other.V)
    with refused(ValueError, r"given bcs\[0\] on another: pass the V of the bodies"):
        nts.EnergyMomentum([box.body], dt=1.0, bcs=[bc])


@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.CentralDifference])
def test_a_condition_without_dofs_is_reported(comm, scheme, caplog):
    box = Box(comm)
    nowhere = fem.locate_dofs_geometrical(box.V, lambda x: x[0] > 99.0)
    dofs = (box.dofs(0), nowhere)
    scheme([box.body], dt=1e-5, bcs=[fem.dirichletbc(np.zeros(3), d, box.V) for d in dofs])
    messages = [record.getMessage() for record in caplog.records]
    assert len(messages) == (comm.rank == 0)
    assert all(text.startswith("bcs[1] has no dof: harmless if") for text in messages)
