"""Time integrators: free motion, order, ends of runs, state after failure."""

import logging
from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.solvers import newton
from helpers import scenes
from helpers.models import box_meshes
from helpers.models.swelling import swelling_box
from helpers.once import once
from helpers.scene import Scene, Totals

pytestmark = pytest.mark.at_most_two_ranks

# Tolerance of positions and velocities of order one, after Newton's tolerance.
SOLVED = 1e-9
ROUNDING = 1e3 * np.finfo(float).eps

schemes = pytest.mark.parametrize("scheme", [nts.EnergyMomentum, once(nts.Midpoint)])
cells_ = pytest.mark.parametrize("cell", ["hexahedron", once("tetrahedron")])

RUBBER = nts.SaintVenantKirchhoff(*scenes.BLOCK_RUBBER, one_point=())


def one_box(comm, scheme, *, cell="hexahedron", dt=0.02, clamp=False, material=RUBBER):
    """Return a scene of one box of 2 x 2 x 2 cells, size 1.0 x 0.8 x 0.6."""
    data = box_meshes.boxes([(2, 2, 2)], [(1.0, 0.8, 0.6)], cell)
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    body = nts.Body(V, cells, tag["body 0"], material)
    bcs = []
    if clamp:
        dofs = fem.locate_dofs_geometrical(V, lambda X: np.isclose(X[2], 0.0))
        bcs = [fem.dirichletbc(np.zeros(3), dofs, V)]
    stepper = scheme([body], dt=dt, bcs=bcs)
    return Scene(stepper, {"body 0": body}, scenes.BLOCK_RUBBER)


def swirl(X):
    """Velocity field that deforms the box."""
    x, y, z = X
    return 0.5 * np.array([np.sin(2 * y) + z, 0.5 * x * z - y, np.cos(x) - 0.3 * z])


def largest(scene, values):
    return scene.comm.allreduce(float(np.abs(values).max(initial=0)), op=scenes.MPI.MAX)


def state_of(stepper):
    """Copies of all state that an accepted step may change."""
    arrays = [stepper.u.x.array.copy(), stepper.v.x.array.copy()]
    for pair in stepper.pairs:
        arrays += [getattr(pair.history, f.name).copy() for f in fields(pair.history)]
    return stepper.t, stepper.step, stepper.dt, arrays


def equal_states(one, other):
    """Bitwise; NaN marks nodes without a segment."""
    same = all(np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
               for a, b in zip(one[3], other[3], strict=True))  # fmt: skip
    return same and one[:3] == other[:3]


# --- physics -----------------------------------------------------------


@schemes
@cells_
def test_box_without_forces_flies_straight_on(comm, scheme, cell):
    scene = one_box(comm, scheme, cell=cell)
    velocity = np.array([1.0, -2.0, 0.5])
    scene.stepper.set_velocity(scene.bodies["body 0"], velocity)
    scene.run(5)
    u, v = (f.x.array.reshape(-1, 3) for f in (scene.stepper.u, scene.stepper.v))
    assert largest(scene, u - 0.1 * velocity) <= SOLVED
    assert largest(scene, v - velocity) <= SOLVED


@schemes
def test_momenta_of_a_vibrating_box_are_conserved(comm, scheme):
    scene = one_box(comm, scheme)
    scene.stepper.set_velocity(scene.bodies["body 0"], swirl)
    history = scene.run(20)
    assert history.linear_drift <= SOLVED
    assert history.angular_drift <= SOLVED
    assert history.strain.max() > 0.05 * history.energy[0]
    if scheme is nts.EnergyMomentum:
        assert history.energy_error <= SOLVED


def neo_hookean(C, mu, lmbda):
    J2 = ufl.det(C)
    return mu / 2 * (ufl.tr(C) - 3 - ufl.ln(J2)) + lmbda / 8 * ufl.ln(J2) ** 2


@pytest.mark.serial
def test_energy_of_any_material_is_conserved(comm):
    material = nts.Hyperelastic(neo_hookean, rho=10.0, mu=400.0, lmbda=500.0)
    scene = one_box(comm, nts.EnergyMomentum, material=material)
    stepper = scene.stepper
    stepper.set_velocity(scene.bodies["body 0"], swirl)
    F = ufl.Identity(3) + ufl.grad(stepper.u)
    density = neo_hookean(F.T * F, 400.0, 500.0) + 5.0 * ufl.inner(stepper.v, stepper.v)
    form = fem.form(density * ufl.dx(metadata={"quadrature_degree": 2}))
    start = comm.allreduce(fem.assemble_scalar(form))
    for _ in range(15):
        stepper.advance()
        assert abs(comm.allreduce(fem.assemble_scalar(form)) / start - 1) <= SOLVED


@pytest.mark.serial
@schemes
def test_error_falls_with_the_square_of_the_step(comm, scheme):
    def result(dt):
        scene = one_box(comm, scheme, dt=dt)
        scene.stepper.set_velocity(scene.bodies["body 0"], swirl)
        for _ in scene.stepper.run(0.16):
            pass
        return scene.positions()

    x = [result(0.01 / 2**i) for i in range(4)]
    differences = [np.abs(b - a).max() for a, b in pairwise(x)]
    order = np.log2(differences[1] / differences[2])
    assert 1.8 < order < 2.3


@pytest.mark.serial
def test_run_backwards_in_time_returns_to_the_start(comm):
    # Both schemes are symmetric in time.
    scene = one_box(comm, nts.EnergyMomentum)
    stepper = scene.stepper
    stepper.set_velocity(scene.bodies["body 0"], swirl)
    start = stepper.v.x.array.copy()
    scene.run(6)
    assert largest(scene, stepper.u.x.array) > 1e-2
    stepper.v.x.array[:] *= -1
    scene.run(6)
    assert largest(scene, stepper.u.x.array) <= SOLVED
    assert largest(scene, stepper.v.x.array + start) <= 10 * SOLVED


@schemes
def test_given_displacements_stay(comm, scheme):
    scene = one_box(comm, scheme, clamp=True)
    scene.stepper.set_velocity(scene.bodies["body 0"], lambda X: swirl(X) * X[2])
    history = scene.run(10)
    low = scene.stepper.u.function_space.tabulate_dof_coordinates()[:, 2] < 1e-12
    assert largest(scene, scene.stepper.u.x.array.reshape(-1, 3)[low]) == 0
    assert largest(scene, scene.stepper.u.x.array) > 1e-2
    if scheme is nts.EnergyMomentum:
        assert history.energy_error <= SOLVED


# --- time and state ----------------------------------------------------


def test_run_ends_exactly_at_until_and_keeps_the_step(comm):
    scene = one_box(comm, nts.EnergyMomentum, dt=0.03)
    reports = list(scene.stepper.run(until=0.1))
    assert [report.step for report in reports] == [1, 2, 3, 4]
    assert reports[-1].t == scene.stepper.t == 0.1
    np.testing.assert_allclose([r.dt for r in reports], [0.03, 0.03, 0.03, 0.01], rtol=ROUNDING)
    np.testing.assert_allclose([r.t for r in reports], [0.03, 0.06, 0.09, 0.1], rtol=ROUNDING)
    assert scene.stepper.dt == 0.03


@pytest.mark.serial
def test_run_of_whole_steps_makes_no_tiny_last_step(comm):
    scene = one_box(comm, nts.EnergyMomentum, dt=0.01)
    reports = list(scene.stepper.run(until=0.07))  # 7 * 0.01 > 0.07 in floating point
    assert len(reports) == 7
    assert scene.stepper.t == 0.07
    reports = list(scene.stepper.run(until=0.1))
    assert len(reports) == 3
    assert scene.stepper.t == 0.1


@pytest.mark.serial
def test_run_to_an_earlier_time_warns_and_takes_no_step(comm, caplog):
    scene = one_box(comm, nts.EnergyMomentum)
    scene.stepper.advance()
    assert list(scene.stepper.run(until=0.02)) == []
    assert not caplog.records
    assert list(scene.stepper.run(until=0.0)) == []
    assert scene.stepper.t == 0.02
    assert ("no steps to take, as the time is 0.02: harmless if" in caplog.text) == (comm.rank == 0)


@pytest.mark.serial
def test_run_without_a_loop_is_reported(comm, caplog):
    stepper = one_box(comm, nts.EnergyMomentum).stepper
    stepper.run(until=0.1)
    assert ('write "for step in stepper.run(...)"' in caplog.text) == (comm.rank == 0)
    caplog.clear()
    for _ in stepper.run(until=0.1):
        break
    assert stepper.step == 1
    assert not caplog.records


def test_wrong_arguments_of_run_are_refused_at_once(comm, refused):
    stepper = one_box(comm, nts.EnergyMomentum).stepper
    with refused(ValueError, "until >= 0 for the end of a run, given -1"):
        stepper.run(until=-1)
    with refused(ValueError, "finite number for until, given nan"):
        stepper.run(until=np.nan)
    with refused(TypeError, r"expected a StepControl\(\) as control, given list"):
        stepper.run(until=0.1, control=[1])


@pytest.mark.parametrize("control", [None, nts.StepControl()])
def test_step_length_can_be_changed_within_a_run(comm, control):
    scene = one_box(comm, nts.EnergyMomentum)
    stepper, diagnostics = scene.stepper, nts.Diagnostics(scene.stepper)
    stepper.set_velocity(scene.bodies["body 0"], lambda X: np.array([X[2], -X[0], 2 * X[1]]))
    energy, ends = diagnostics.balance().total_energy, []
    for step in stepper.run(0.1, control):
        ends.append(step.t)
        stepper.dt = 0.01 if step.step < 4 else 0.03
        assert diagnostics.balance().total_energy == pytest.approx(energy, rel=1e-12)
    np.testing.assert_allclose(
        ends, [0.02, 0.03, 0.04, 0.05, *((0.08,) if control is None else (0.075,)), 0.1]
    )
    assert stepper.t == 0.1


def test_step_length_cannot_be_changed_within_a_step(comm, refused):
    scene = one_box(comm, nts.EnergyMomentum)
    bodies = list(scene.bodies.values())

    def update(t):
        stepper.dt = 0.01

    stepper = nts.EnergyMomentum(bodies, dt=0.02, update=update)
    with refused(ValueError, "dt to be set between two steps, given 0.01 within a step of 0.02"):
        stepper.advance()
    assert (stepper.dt, stepper.t) == (0.02, 0.0)


def test_statics_refuse_a_velocity(comm, refused):
    scene = one_box(comm, nts.EnergyMomentum)
    (body,) = bodies = list(scene.bodies.values())
    stepper = nts.QuasiStatic(bodies, dt=1.0)
    stepper.set_velocity(body, (0.0, 0.0, -2.0))
    with refused(ValueError, "no velocity in QuasiStatic, given one of up to 2: .*EnergyMomentum"):
        stepper.advance()


def test_values_that_are_no_real_numbers_are_refused(comm, refused):
    scene = one_box(comm, nts.EnergyMomentum)
    stepper, body = scene.stepper, scene.bodies["body 0"]
    with refused(TypeError, r"real numbers for a velocity, given \(0, 0, 1j\)"):
        stepper.set_velocity(body, (0, 0, 1j))
    with refused(TypeError, r"real numbers for a velocity, given array\(\[\[.*j"):
        stepper.set_velocity(body, lambda X: X * 1j)
    with refused(TypeError, "real numbers for a displacement, given 'far'"):
        stepper.set_displacement(body, "far")
    with refused(
        TypeError, r"one of the bodies given to the stepper \(.*\), the Body itself .* given 'ball'"
    ):
        stepper.set_velocity("ball", (0, 0, 1))
    assert largest(scene, stepper.v.x.array) == 0


def test_run_left_early_restores_the_step(comm):
    scene = one_box(comm, nts.EnergyMomentum, dt=0.03)
    for _ in scene.stepper.run(until=0.05):
        break
    assert scene.stepper.step == 1
    assert scene.stepper.dt == 0.03


def test_step_length_can_be_changed_between_steps(comm):
    # Straight flight is exact for any steps.
    scene = one_box(comm, nts.EnergyMomentum)
    scene.stepper.set_velocity(scene.bodies["body 0"], (1.0, 0.0, 0.0))
    for dt in (0.02, 0.005, 0.04):
        scene.stepper.dt = dt
        assert scene.stepper.advance().dt == dt
    np.testing.assert_allclose(scene.stepper.t, 0.065, rtol=ROUNDING)
    assert largest(scene, scene.stepper.u.x.array.reshape(-1, 3)[:, 0] - 0.065) <= SOLVED


@pytest.mark.serial
@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan, np.inf])
def test_impossible_steps_are_refused(comm, dt, refused):
    scene = one_box(comm, nts.EnergyMomentum)
    with refused(ValueError, f"expected a step dt > 0, given {dt}"):
        scene.stepper.dt = dt
    assert scene.stepper.dt == 0.02
    with refused(ValueError, f"expected a step dt > 0, given {dt}"):
        nts.Midpoint(list(scene.bodies.values()), dt=dt)
    with refused(ValueError, "finite number for until, given nan"):
        list(scene.stepper.run(until=np.nan))


@pytest.mark.serial
def test_velocity_and_displacement_may_be_functions_of_the_position(comm):
    scene = scenes.blocks(comm)
    stepper, body = scene.stepper, scene.bodies["body 1"]
    for function, put in ((stepper.u, stepper.set_displacement), (stepper.v, stepper.set_velocity)):
        before = function.x.array.reshape(-1, 3).copy()
        put(body, lambda X: np.array([X[2], 2 * X[0], -X[1]]))
        X = stepper.u.function_space.tabulate_dof_coordinates()
        expected = np.column_stack([X[:, 2], 2 * X[:, 0], -X[:, 1]])
        after = function.x.array.reshape(-1, 3)
        assert largest(scene, (after - expected)[body.nodes]) == 0
        others = np.setdiff1d(np.arange(len(X)), body.nodes)
        assert largest(scene, (after - before)[others]) == 0


def test_report_describes_the_step(comm):
    scene = scenes.blocks(comm)
    (pair,) = scene.stepper.pairs
    for number in range(1, 5):
        report = scene.stepper.advance()
        assert (report.step, report.dt) == (number, scenes.BLOCK_STEP)
        assert report.t == scene.stepper.t
        assert report.num_active == comm.allreduce(int(pair.history.active.sum()))
        assert len(report.residual_norms) == report.newton_iterations + 1
        assert report.residual_norms[-1] < 1e-6 * max(report.residual_norms)
    assert report.num_active >= 3
    assert report.active_set_changes >= 1


def test_steps_are_logged_on_one_rank(comm, caplog):
    scene = one_box(comm, nts.EnergyMomentum)
    with caplog.at_level(logging.INFO, "dolfinx_nts"):
        scene.stepper.advance()
    logged = any("step 1" in message for message in caplog.messages)
    assert comm.allgather(logged) == [True] + [False] * (comm.size - 1)


# --- failure -----------------------------------------------------------


@schemes
def test_failed_step_leaves_the_last_accepted_state(comm, scheme, monkeypatch, agree, refused):
    scene = scenes.blocks(comm, scheme)
    reference = scenes.blocks(comm, scheme)
    scene.run(4)
    reference.run(4)
    before = state_of(scene.stepper)
    assert comm.allreduce(int(scene.stepper.pairs[0].history.active.sum())) >= 3
    with monkeypatch.context() as patch:
        patch.setattr(newton, "_MAX_ITERATIONS", 1)
        with refused(nts.ConvergenceError, "no convergence in 1 iterations"):
            scene.stepper.advance()
    assert agree(equal_states(state_of(scene.stepper), before))
    # And the run continues unchanged.
    scene.run(3)
    reference.run(3)
    difference = np.abs(scene.positions() - reference.positions()).max()
    assert difference <= SOLVED


def test_error_names_step_time_and_residuals(comm, monkeypatch, refused):
    scene = scenes.blocks(comm)
    scene.run(2)
    monkeypatch.setattr(newton, "_MAX_ITERATIONS", 1)
    number = r"\d\.\d+e[+-]\d+"
    message = rf"(?s)step 3 from t = 0\.04 to 0\.06 .*smaller dt.*\|R\| .*{number}, {number} N"
    with refused(nts.ConvergenceError, message):
        scene.stepper.advance()
    with pytest.raises(nts.ConvergenceError) as caught:
        scene.stepper.advance()
    assert len(caught.value.reports) >= 1
    assert all(not report.converged for report in caught.value.reports)
    assert all(len(report.residual_norms) == 2 for report in caught.value.reports)


def test_far_too_long_step_fails_or_conserves(comm, agree):
    scene = scenes.blocks(comm, dt=1.0)
    before, totals = state_of(scene.stepper), Totals(scene)
    row = totals.row()
    try:
        scene.stepper.advance()
    except nts.ConvergenceError:
        assert agree(equal_states(state_of(scene.stepper), before))
    else:
        assert abs(totals.row()[1:3].sum() / row[1:3].sum() - 1) <= SOLVED


def test_stepper_refuses_wrong_arguments(comm, refused):
    scene = scenes.blocks(comm)
    bodies, stepper = list(scene.bodies.values()), scene.stepper
    other = one_box(comm, nts.EnergyMomentum)
    (stranger,) = other.bodies.values()
    with refused(TypeError, "expected a ContactPair, given Surface"):
        nts.EnergyMomentum(bodies, [stepper.pairs[0].nodes], dt=0.1)
    with refused(TypeError, "a function of the time as update, given 3"):
        nts.EnergyMomentum(bodies, dt=0.1, update=3)
    with refused(ValueError, "at least one body, given none"):
        nts.EnergyMomentum([], dt=0.1)
    with refused(ValueError, "bodies and pairs in one function space, given two"):
        nts.EnergyMomentum([stranger], stepper.pairs, dt=0.1)
    with refused(ValueError, "in none and 0 in several"):
        nts.EnergyMomentum(bodies[:1], dt=0.1)
    with refused(ValueError, r"a body of this stepper \(.*\), given"):
        stepper.set_velocity(stranger, (0, 0, 1))
    with refused(ValueError, r"expected a velocity of shape \(3,\) or"):
        # The number of nodes differs from rank to rank: any wrong one will do.
        one = comm.allreduce(len(bodies[0].nodes), op=scenes.MPI.MIN)
        try:
            stepper.set_velocity(bodies[0], (0, 1))
        except ValueError as error:
            raise ValueError(str(error).split(" or")[0] + f" or {one > 0}") from error


def test_block_squashed_by_supports_in_statics_needs_few_iterations(comm):
    # Only reactions give a force scale: with round-off as the target Newton's method stalls where
    # cells are crushed.
    data = box_meshes.boxes([(4, 4, 4)], [(1.0, 1.0, 1.0)])
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    body = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(1e5, 0.3, 1e3))
    given = fem.Function(V)
    top, bottom = (
        fem.locate_dofs_geometrical(V, lambda X, z=z: np.isclose(X[2], z)) for z in (1.0, 0.0)
    )

    def update(t):
        given.x.array.reshape(-1, 3)[top, 2] = -0.8 * t

    bcs = [fem.dirichletbc(given, dofs) for dofs in (top, bottom)]
    stepper = nts.QuasiStatic([body], dt=0.05, bcs=bcs, update=update)
    assert all(step.newton_iterations < 15 for step in stepper.run(1.0))


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("kind", ["constant", "function", "form"])
@pytest.mark.parametrize(
    "scheme", [nts.EnergyMomentum, once(nts.Midpoint), nts.GeneralizedAlpha, once(nts.QuasiStatic)]
)
def test_a_load_that_update_sets_acts_as_a_function_of_time_does(comm, scheme, kind):
    """Supports get the values at the end of the step, loads those at the time of the scheme."""

    def tip(dt, kind):
        scene = one_box(comm, scheme)
        V, (body,) = scene.stepper.u.function_space, scene.stepper.bodies
        top = nts.boundary_of(body, where=lambda x: x[2] > 0.59)
        eta, along = ufl.TestFunction(V), ufl.as_vector((1.0, 0.0, 0.0))
        pull, end = fem.Constant(V.mesh, 0.0), fem.Constant(V.mesh, np.zeros(3))
        space = fem.functionspace(V.mesh, ("DG", 0))
        spread = fem.Function(space)
        loads = {
            "time": lambda: nts.Traction(top, lambda t: (10 * np.sin(5 * t), 0.0, 0.0)),
            "constant": lambda: nts.Traction(top, pull * along),
            "function": lambda: nts.Traction(top, spread * along),
            "form": lambda: nts.FormLoad(V, pull * eta[0] * top.measure(2)),
        }
        dofs = fem.locate_dofs_geometrical(V, lambda X: np.isclose(X[2], 0.0))
        asked = []

        def update(t):
            pull.value = 10 * np.sin(5 * t)
            spread.x.array[:] = pull.value
            end.value[1] = 1e-3 * np.sin(5 * t)
            asked.append(t)

        stepper = scheme(
            [body],
            dt=dt,
            bcs=[fem.dirichletbc(end, dofs, V)],
            loads=[loads[kind]()],
            update=update,
        )
        for step in stepper.run(until=0.2):
            assert asked[-1] == pytest.approx(step.t)
            owned = dofs[dofs < V.dofmap.index_map.size_local]
            moved = stepper.u.x.array.reshape(-1, 3)[owned, 1]
            np.testing.assert_allclose(moved, 1e-3 * np.sin(5 * step.t), rtol=1e-12)
        if kind == "time":
            assert len(asked) == stepper.step  # once in a step without other requests
        return comm.allreduce(float(stepper.u.x.array.sum()))

    assert tip(0.05, kind) == pytest.approx(tip(0.05, "time"), rel=1e-8)
    if kind == "constant" and scheme is nts.EnergyMomentum:
        coarse, fine, finest = (tip(dt, kind) for dt in (0.02, 0.01, 0.005))
        assert abs(coarse - fine) > 3 * abs(fine - finest)


def test_first_step_of_a_heated_body_converges_though_no_force_acted_before(comm):
    block, stretch = swelling_box(comm, 0.01, 3)
    V = block.V
    Q, _ = V.sub(2).collapse()
    top = fem.locate_dofs_geometrical((V.sub(2), Q), lambda x: x[2] > 0.01 - 1e-9)
    hold = fem.dirichletbc(fem.Function(Q), top, V.sub(2))

    def heat(t):
        stretch.value = 1 + 5 * t

    stepper = nts.EnergyMomentum([block], [], dt=5e-4, bcs=[hold], update=heat)
    assert stepper.advance().newton_iterations <= 8
