"""Loads and moving supports: motion and work against closed forms."""

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
import scenes
from boxed import CLOSED, RHO, RUBBER, SIZE, SOLVED, VOLUME, Box, Ledger, swirl
from dolfinx_nts.loads import BodyForce, Gravity, Pressure, Traction

EPS = np.finfo(float).eps

cells_ = pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
schemes = pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.Midpoint])


# --- loads -------------------------------------------------------------


@cells_
@schemes
def test_free_fall_gains_the_work_of_the_weight(comm, cell, scheme):
    box = Box(comm, cell)
    g, v_0 = np.array([0.5, -1.0, -9.81]), np.array([1.0, 0.0, 3.0])
    stepper = scheme([box.body], dt=0.05, loads=[Gravity([box.body], g)])
    stepper.set_velocity(box.body, v_0)
    X, ledger = box.positions(stepper), Ledger(stepper)
    ledger.run(8)
    fall = 0.4 * v_0 + 0.08 * g
    np.testing.assert_allclose(box.positions(stepper) - X, np.tile(fall, (len(X), 1)), atol=SOLVED)
    weight = RHO * VOLUME * g
    assert ledger.total("load_work") == pytest.approx(weight @ fall, rel=SOLVED)
    assert ledger.gained == pytest.approx(weight @ fall, rel=SOLVED)
    assert ledger.error <= CLOSED


def test_bodies_fall_alike_and_weigh_as_their_densities_say(comm):
    data = scenes.boxes([(1, 1, 1), (1, 1, 1)], [(1.0, 1.0, 1.0), (1.0, 1.0, 0.5)])
    mesh, cells, _, tag = scenes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    steel = nts.SaintVenantKirchhoff(1.0e5, 0.2, rho=70.0)
    bodies = [nts.Body(V, cells, tag[f"body {i}"], m) for i, m in enumerate((RUBBER, steel))]
    stepper = nts.EnergyMomentum(bodies, dt=0.1, loads=[Gravity(bodies, (0, 0, -10.0))])
    report = stepper.advance()
    np.testing.assert_allclose(stepper.u.x.array.reshape(-1, 3)[:, 2], -0.05, atol=SOLVED)
    assert report.load_work == pytest.approx((RHO * 1.0 + 70.0 * 0.5) * 10 * 0.05, rel=SOLVED)


@cells_
def test_impulse_of_a_body_force_is_its_time_integral(comm, cell):
    # Linear in time, for which the middle of the step is exact.
    box, b = Box(comm, cell), np.array([2.0, -1.0, 4.0])
    stepper = nts.EnergyMomentum(
        [box.body], dt=0.05, loads=[BodyForce(box.body, lambda t: b * t), BodyForce(box.body, -b)]
    )
    ledger = Ledger(stepper)
    ledger.run(6)
    p = ledger.diagnostics.linear_momentum()
    np.testing.assert_allclose(p, VOLUME * b * (0.3**2 / 2 - 0.3), atol=SOLVED)
    assert ledger.error <= CLOSED


@cells_
def test_body_force_by_an_expression_pushes_and_turns(comm, cell):
    # f = (Z, 0, 0): force and moment about y are integrals over the box.
    box = Box(comm, cell)
    X = ufl.SpatialCoordinate(box.mesh)
    force = BodyForce(box.body, ufl.as_vector([X[2], 0, 0]))
    stepper = nts.EnergyMomentum([box.body], dt=1e-4, loads=[force])
    stepper.advance()
    diagnostics, (a, b, c) = nts.Diagnostics(stepper), SIZE
    p, L = diagnostics.linear_momentum(), diagnostics.angular_momentum()
    np.testing.assert_allclose(p, [1e-4 * a * b * c**2 / 2, 0, 0], atol=1e-12)
    turn = [0, a * b * c**3 / 3, -a * b**2 * c**2 / 4]
    np.testing.assert_allclose(L, np.multiply(1e-4, turn), atol=1e-12)


@cells_
@schemes
def test_dead_traction_keeps_its_direction_and_does_the_work_of_the_face(comm, cell, scheme):
    box, t = Box(comm, cell, shape=(2, 1, 2)), np.array([3.0, 5.0, -20.0])
    stepper = scheme([box.body], dt=0.02, loads=[Traction(box.surface("top 0"), t)])
    stepper.set_velocity(box.body, swirl)
    ledger, X = Ledger(stepper), box.positions(stepper)
    ledger.run(8)
    area = SIZE[0] * SIZE[1]
    gained = ledger.diagnostics.linear_momentum() - ledger.start.linear_momentum
    np.testing.assert_allclose(gained, t * area * 0.16, atol=SOLVED)
    assert ledger.error <= CLOSED
    if cell == "hexahedron":
        # Integral of a bilinear displacement: 1/8, 1/4, 1/8 along x.
        top = np.flatnonzero(np.isclose(X[:, 2], SIZE[2]))
        weights = np.where(np.isclose(X[top, 0], SIZE[0] / 2), 0.25, 0.125)
        moved = weights @ (box.positions(stepper) - X)[top]
        assert ledger.total("load_work") == pytest.approx(area * t @ moved, rel=SOLVED)


@cells_
@schemes
def test_work_of_pressure_in_a_cavity_is_pressure_times_volume(comm, cell, scheme):
    box, p = Box(comm, cell, hollow=True), 150.0
    stepper = scheme([box.body], dt=0.02, loads=[Pressure(box.surface("cavity"), p)])
    stepper.set_velocity(box.body, swirl)
    ledger, before = Ledger(stepper), box.cavity_volume(stepper)
    assert before == pytest.approx(VOLUME / 27)
    for _ in range(8):
        ledger.run(1)
        after = box.cavity_volume(stepper)
        # Cancellation in the difference of volumes.
        assert abs(ledger.reports[-1].load_work - p * (after - before)) <= 1e3 * EPS * p * after
        before = after
    assert after > 1.05 * VOLUME / 27
    assert ledger.error <= CLOSED
    momentum, spin = ledger.diagnostics.linear_momentum(), ledger.diagnostics.angular_momentum()
    np.testing.assert_allclose(momentum, ledger.start.linear_momentum, atol=SOLVED)
    # The mean of cof F gives up the moment, to second order of the step.
    np.testing.assert_allclose(spin, ledger.start.angular_momentum, atol=1e-3 * p * VOLUME / 27)


def test_pressure_follows_a_face_that_has_turned(comm):
    # A quarter turn about x takes the top (normal z) to normal -y.
    box, p = Box(comm), 7.0
    stepper = nts.EnergyMomentum([box.body], dt=1e-5, loads=[Pressure(box.surface("top 0"), p)])
    Q = scenes.rotation([1.0, 0.0, 0.0], np.pi / 2)
    stepper.set_displacement(box.body, lambda X: (Q - np.eye(3)) @ X)
    stepper.advance()
    momentum = nts.Diagnostics(stepper).linear_momentum()
    np.testing.assert_allclose(momentum, [0, p * SIZE[0] * SIZE[1] * 1e-5, 0], atol=1e-10)


@cells_
def test_tangent_of_pressure_is_the_derivative_of_its_force(comm, cell, rng):
    box = Box(comm, cell, hollow=True)
    dofs = box.dofs(0)
    stepper = nts.EnergyMomentum(
        [box.body],
        dt=0.1,
        loads=[Pressure(box.surface("cavity"), 1e3), Gravity([box.body], (0, 0, -1.0))],
        bcs=[fem.dirichletbc(np.zeros(3), dofs, box.V)],
    )
    bulk, u = stepper._bulk, stepper.u
    u.interpolate(lambda X: 0.05 * swirl(X))
    nodes = scenes.input_ids(box.V)
    direction = rng.normal(size=(64, 3))[nodes]
    direction[dofs] = 0
    start, h, owned = u.x.array.copy(), 1e-6, bulk.num_owned
    residuals = []
    for sign in (1, -1):
        u.x.array[:] = start + sign * h * direction.ravel()
        residuals.append(bulk.residual())
    u.x.array[:] = start
    expected = (residuals[0] - residuals[1]) / (2 * h)
    action = bulk.action(direction[: owned // 3]).ravel()
    x, y = bulk.tangent().createVecs()
    x.array[:] = direction.ravel()[:owned]
    bulk.tangent().mult(x, y)
    size = comm.allreduce(np.abs(expected).max(), op=scenes.MPI.MAX)
    # Rounding of the residual over h; the tangent itself is checked to more.
    np.testing.assert_allclose(action, expected, atol=1e-8 * size)
    np.testing.assert_allclose(y.array, action, atol=1e3 * EPS * size)


# --- supports ----------------------------------------------------------


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


def test_support_that_strikes_a_body_gives_what_contact_takes(comm):
    # The lower block is driven; its top nodes are given and in contact.
    data = scenes.boxes([(2, 2, 1), (1, 1, 1)], [(1.0, 1.0, 0.5), (0.6, 0.7, 0.5)])
    data.X[data.cells[data.body == 1].ravel().min() :] += [0.15, 0.17, 0.52]
    mesh, cells, facets, tag = scenes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bodies = [nts.Body(V, cells, tag[f"body {i}"], RUBBER) for i in range(2)]
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["bottom 1"]), nts.Surface(V, facets, tag["top 0"])
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


# --- state and bad input -----------------------------------------------


def test_initial_state_may_be_a_function(comm, agree):
    box = Box(comm)
    stepper = nts.EnergyMomentum([box.body], dt=0.02)
    field = fem.Function(box.V)
    field.interpolate(swirl)
    stepper.set_velocity(box.body, field)
    stepper.set_displacement(box.body, field)
    assert agree(np.array_equal(stepper.v.x.array, field.x.array))
    assert agree(np.array_equal(stepper.u.x.array, field.x.array))


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


def test_wrong_loads_and_conditions_are_refused(comm, refused):
    box, other = Box(comm), Box(comm)
    body, top = box.body, box.surface("top 0")
    with refused(ValueError, r"tag out of \[1, 2\] in facets, given 9"):
        Pressure(nts.Surface(box.V, box.facets, 9), 1.0)
    with refused(TypeError, "expected a Body, given Surface"):
        BodyForce(top, (0, 0, 1))
    with refused(TypeError, "expected a Surface, given Body"):
        Traction(body, (0, 0, 1))
    with refused(ValueError, "expected at least one Body, given none"):
        Gravity([], (0, 0, 1))
    with refused(ValueError, r"a Gravity of shape \(3,\), given shape \(\)"):
        Gravity([body], -9.81)
    with refused(ValueError, r"a Pressure of shape \(\), given shape \(3,\)"):
        Pressure(top, lambda t: (0, 0, t))
    with refused(ValueError, r"a Traction of shape \(3,\), given shape \(\)"):
        Traction(top, ufl.SpatialCoordinate(box.mesh)[0])
    with refused(ValueError, "a finite Pressure, given nan"):
        Pressure(top, np.nan)
    with refused(TypeError, "expected a Load, given tuple"):
        nts.EnergyMomentum([body], dt=1.0, loads=[(0, 0, 1)])
    with refused(ValueError, "bodies and loads in one function space, given two"):
        nts.EnergyMomentum([body], dt=1.0, loads=[BodyForce(other.body, (0, 0, 1))])
    with refused(TypeError, "expected a DirichletBC, given Constant"):
        nts.EnergyMomentum([body], dt=1.0, bcs=[fem.Constant(box.mesh, np.zeros(3))])
    bc = fem.dirichletbc(np.zeros(3), other.dofs(0), other.V)
    with refused(ValueError, r"on the space of the bodies, but not bcs\[0\]"):
        nts.EnergyMomentum([body], dt=1.0, bcs=[bc])


def test_load_that_is_no_number_later_leaves_the_state(comm, refused):
    box = Box(comm)
    load = BodyForce(box.body, lambda t: (0, 0, 1.0 if t < 0.1 else np.inf))
    stepper = nts.EnergyMomentum([box.body], dt=0.08, loads=[load])
    stepper.advance()
    with refused(ValueError, "a finite BodyForce, given"):
        stepper.advance()
    assert (stepper.t, stepper.step) == (0.08, 1)
