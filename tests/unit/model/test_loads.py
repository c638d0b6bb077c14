"""Loads: motion and work against closed forms."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import GhostMode

import dolfinx_nts as nts
from dolfinx_nts.model.loads.body_loads import BodyForce, Gravity
from dolfinx_nts.model.loads.surface_loads import Pressure, Traction
from helpers import scenes
from helpers.models import box_meshes
from helpers.models.boxed import CLOSED, RHO, RUBBER, SIZE, SOLVED, VOLUME, Box, Ledger, swirl
from helpers.once import once
from helpers.scene import input_ids

pytestmark = pytest.mark.at_most_two_ranks

EPS = np.finfo(float).eps

cells_ = pytest.mark.parametrize("cell", ["hexahedron", once("tetrahedron")])
schemes = pytest.mark.parametrize("scheme", [nts.EnergyMomentum, once(nts.Midpoint)])


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
    data = box_meshes.boxes([(1, 1, 1), (1, 1, 1)], [(1.0, 1.0, 1.0), (1.0, 1.0, 0.5)])
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
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
    # The mean of cof F conserves the moment to second order of the step only.
    np.testing.assert_allclose(spin, ledger.start.angular_momentum, atol=1e-3 * p * VOLUME / 27)


@pytest.mark.serial
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
    nodes = input_ids(box.V)
    direction = rng.normal(size=(64, 3))[nodes]
    direction[dofs] = 0
    start, h, owned = u.x.array.copy(), 1e-6, bulk.num_owned
    residuals = []
    for sign in (1, -1):
        u.x.array[:] = start + sign * h * direction.ravel()
        residuals.append(bulk.forces())
        residuals[-1][bulk.is_prescribed] = 0
    u.x.array[:] = start
    expected = (residuals[0] - residuals[1]) / (2 * h)
    action = bulk.action(direction[: owned // 3]).ravel()
    stepper._tangent.assemble_exact()
    K = stepper._tangent.matrix(scalar=False)
    x, y = K.createVecs()
    x.array[:] = direction.ravel()[:owned]
    K.mult(x, y)
    size = comm.allreduce(np.abs(expected).max(), op=scenes.MPI.MAX)
    # Rounding of the residual over h; the tangent itself is checked to more.
    np.testing.assert_allclose(action, expected, atol=1e-8 * size)
    np.testing.assert_allclose(y.array, action, atol=1e3 * EPS * size)


# --- bodies of a load, and its printed form --------------------


@cells_
@pytest.mark.parametrize("ghosts", [GhostMode.none, GhostMode.shared_facet])
def test_loads_say_on_all_ranks_which_bodies_they_act_on(comm, agree, cell, ghosts):
    # The lower halves of the boxes belong to rank 0, the upper ones to the last.
    def owner(middle):
        return np.where(middle[:, 2] > 0.5, comm.size - 1, 0)

    data = box_meshes.boxes([(1, 1, 2), (1, 1, 2)], [(1.0, 1.0, 1.0), (1.0, 1.0, 1.0)], cell)
    where = {"owner": owner} if ghosts is GhostMode.none else {"ghosts": ghosts}
    mesh, cells, facets, tag = box_meshes.distribute(comm, data, **where)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bodies = [nts.Body(V, cells, tag[f"body {i}"], RUBBER) for i in range(2)]
    top = nts.Surface(V, facets, tag["top 1"])
    eta = ufl.TestFunction(V)
    acting = {
        Traction(top, (0, 0, 1)): [False, True],
        Pressure(top, 1.0): [False, True],
        BodyForce(bodies[0], (0, 0, 1)): [True, False],
        Gravity(bodies[1:], (0, 0, 1)): [False, True],
        Gravity(bodies, (0, 0, 1)): [True, True],
        nts.FormLoad(V, eta[0] * ufl.dx): [True, True],
    }
    for load, expected in acting.items():
        assert agree([load.acts_on(body) for body in bodies] == expected)


@pytest.mark.serial
def test_a_load_of_the_users_own_may_act_on_every_body(comm):
    class Own(nts.Load):
        def update(self, t):
            """Nothing changes."""

        def form(self, u_n, u):
            """No work."""

    assert Own().acts_on(Box(comm).body) is True


@pytest.mark.serial
def test_printed_load_and_body_have_their_arguments_in_one_line(comm):
    def rising(t):
        return (0.0, 0.0, t)

    box = Box(comm)
    body, top = box.body, box.surface("top 0")
    material = "SaintVenantKirchhoff(E=1000, nu=0.3, rho=10)"
    assert repr(body) == f"Body(tag=0, name={body.name!r}, material={material}, owned_cells=8)"
    surface = f"Surface(tag=2, name={top.name!r}, owned_nodes=9, owned_segments=4)"
    X = ufl.SpatialCoordinate(box.mesh)
    eta = ufl.TestFunction(box.V)
    printed = {
        BodyForce(body, (0, -0.5, 2e9)): f"BodyForce(body={body!r}, value=(0, -0.5, 2000000000))",
        BodyForce(body, rising): f"BodyForce(body={body!r}, value=rising)",
        BodyForce(body, X): f"BodyForce(body={body!r}, value=SpatialCoordinate)",
        Gravity(body, (0, 0, -9.81)): "Gravity(num_bodies=1, g=(0, 0, -9.81))",
        Gravity([body], [0, 0, -9.81]): "Gravity(num_bodies=1, g=(0, 0, -9.81))",
        Traction(top, fem.Constant(box.mesh, np.ones(3))): (
            f"Traction(surface={surface}, value=(1, 1, 1))"
        ),
        Pressure(top, 3): f"Pressure(surface={surface}, value=3)",
        nts.FormLoad(box.V, eta[0] * ufl.dx): "FormLoad(work=Form)",
        nts.FormLoad(box.V, lambda u, v, t: t * v[0] * ufl.dx): "FormLoad(work=<lambda>)",
    }
    for load, text in printed.items():
        assert repr(load) == text


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


def test_wrong_loads_are_refused(comm, refused):
    box, other = Box(comm), Box(comm)
    body, top = box.body, box.surface("top 0")
    with refused(ValueError, r"one of the tags \[1, 2\] of facets, given 9"):
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


def test_load_that_becomes_nan_leaves_the_state_unchanged(comm, refused):
    box = Box(comm)
    load = BodyForce(box.body, lambda t: (0, 0, 1.0 if t < 0.1 else np.inf))
    stepper = nts.EnergyMomentum([box.body], dt=0.08, loads=[load])
    stepper.advance()
    with refused(ValueError, "a finite BodyForce, given"):
        stepper.advance()
    assert (stepper.t, stepper.step) == (0.08, 1)
