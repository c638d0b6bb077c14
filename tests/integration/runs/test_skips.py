"""Unneeded work of a scene is skipped, and the steps are the same."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.friction.interface import Friction
from dolfinx_nts.contact.implicit.normal.multiplier import MultiplierContact
from dolfinx_nts.integrators.implicit import sleeping
from dolfinx_nts.search.mortar.mortar_points import MortarPoints
from dolfinx_nts.solvers.linear import krylov
from helpers import scenes
from helpers.models import box_meshes
from helpers.once import once, once_except

pytestmark = pytest.mark.at_most_two_ranks

LAWS = {
    "elastic": nts.LagrangeMultiplier(),
    "plastic": nts.LagrangeMultiplier("plastic"),
    "penalty": nts.Penalty(),
}
laws = pytest.mark.parametrize("law", once_except(list(LAWS), "plastic"))


def ball_plate(comm, law, monkeypatch=None):
    """Return the scene; with ``monkeypatch`` no body is left out."""
    scene = scenes.ball_plate(comm, enforcement=LAWS[law], shift=scenes.NO_TIES)
    if monkeypatch:
        monkeypatch.setattr(scene.stepper._sleeping, "find", lambda *_: None)
    return scene


def num_cells(scene):
    """Number of cells in a residual, on all ranks."""
    return scene.comm.allreduce(scene.stepper.statistics.solver.num_cells)


@laws
def test_plate_is_left_out_until_the_ball_comes(comm, law, monkeypatch):
    scene, reference = ball_plate(comm, law), ball_plate(comm, law, monkeypatch)
    resting, active = [], []
    for _ in range(9):
        before = num_cells(scene)
        report, other = scene.stepper.advance(), reference.stepper.advance()
        assert other.num_sleeping == 0
        if report.num_sleeping:
            # 432 cells of the ball, 100 of the plate.
            assert num_cells(scene) == 432 and before in (432, 532)
        resting.append(report.num_sleeping)
        active.append(report.num_active)
        np.testing.assert_allclose(scene.positions(), reference.positions(), rtol=0, atol=1e-13)
    assert resting[:3] == [1, 1, 1] and sum(resting) < 9 and max(active) > 0
    assert num_cells(scene) == 532
    assert all(not rests for rests, n in zip(resting, active, strict=True) if n)


@pytest.mark.parametrize("num_bodies", [2, 3])
def test_one_message_distributes_pairs_that_can_wake_a_body(comm, agree, monkeypatch, num_bodies):
    stepper = scenes.blocks(comm, num_bodies=num_bodies).stepper
    messages, join = [], sleeping.joined
    for name in ("anywhere", "everywhere", "total"):
        monkeypatch.setattr(sleeping.reductions, name, lambda *_: messages.append("reduction"))
    monkeypatch.setattr(sleeping, "joined", lambda *args: messages.append("rows") or join(*args))
    pairs = stepper._sleeping._pairs_of_groups()
    assert messages == ["rows"]
    touch = [[0], [0, 1], [1]] if num_bodies == 3 else [[0], [0]]  # a tower
    expected = [[stepper.contacts[i] for i in some] for some in touch]
    assert agree([pairs[(body,)] for body in stepper.bodies] == expected)


@pytest.mark.serial
def test_unpredicted_contact_wakes_the_body(comm, monkeypatch):
    scene, reference = ball_plate(comm, "plastic"), ball_plate(comm, "plastic")
    init = ContactStep.__init__

    def blind(self, *args):
        init(self, *args)
        self.may_touch = False

    for _ in range(8):
        expected = reference.stepper.advance()
    monkeypatch.setattr(ContactStep, "__init__", blind)
    for _ in range(8):
        report = scene.stepper.advance()
    assert expected.num_active == report.num_active > 0
    assert report.num_sleeping == 0
    np.testing.assert_allclose(scene.positions(), reference.positions(), rtol=0, atol=1e-13)


def box_in_room(comm):
    """Stepper of a box that falls, and flies to a wall that is out of its reach at first."""

    def build(model):
        shape = {"corner": (0.0, 0.0, 0.0), "size": (1.0, 1.0, 1.0), "cells": (2, 2, 2)}
        parts.add_box(model, "box", **shape)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = scenes.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    box = nts.Body(V, cells, tag["box"], nts.NeoHookean(1e5, 0.3, 1e3))
    floor = nts.RigidPlane((0.0, 0.0, -0.02), (0.0, 0.0, 1.0))
    wall = nts.RigidPlane((1.7, 0.0, 0.0), (-1.0, 0.0, 0.0))
    stepper = nts.EnergyMomentum(
        [box],
        nts.all_pairs(
            [box],
            obstacles=[floor, wall],
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        ),
        dt=0.02,
    )
    stepper.set_velocity(box, (2.0, 0.0, -0.5))
    return stepper


def test_obstacles_out_of_reach_cost_no_attempt(comm, monkeypatch):
    stepper, reference = box_in_room(comm), box_in_room(comm)
    attempts, init = [], ContactStep.__init__
    monkeypatch.setattr(
        ContactStep, "__init__", lambda *args: attempts.append(args[1]) or init(*args)
    )
    counts, active = [], []
    for _ in range(20):
        attempts.clear()
        report = stepper.advance()
        counts.append(attempts.count(stepper.contacts[1]))
        active.append(report.num_active)
        with monkeypatch.context() as patch:
            patch.setattr("dolfinx_nts.integrators.implicit.step_solver.may_face", lambda *_: True)
            assert reference.advance().num_active == report.num_active
        assert np.array_equal(stepper.u.x.array, reference.u.x.array)
    assert counts[:4] == [0, 0, 0, 0] and counts[-1] > 0 and max(active) > 8
    same = zip(stepper.contacts, reference.contacts, strict=True)
    for one, other in same:
        for name, value in vars(one.history).items():
            np.testing.assert_array_equal(value, getattr(other.history, name), err_msg=name)


@pytest.mark.parametrize(
    "reason", once_except(["nothing", "gravity", "traction", "velocity", "support"], "support")
)
def test_any_action_on_a_body_wakes_it(comm, reason):
    scene = scenes.ball_plate(comm)
    stepper, plate = scene.stepper, scene.bodies["plate"]
    V = stepper.u.function_space
    top = stepper.pairs[0].segments
    loads, bcs, update = [], [], None
    if reason == "gravity":
        loads = [nts.Gravity([plate], (0.0, 0.0, -10.0))]
    elif reason == "traction":
        loads = [nts.Traction(top, (0.0, 0.0, -1.0))]
    elif reason == "support":
        value = scenes.fem.Constant(V.mesh, np.zeros(3))
        dofs = scenes.fem.locate_dofs_geometrical(V, lambda x: x[2] < -0.399)
        bcs = [scenes.fem.dirichletbc(value, dofs, V)]

        def update(t):
            value.value[:] = 0.0, 0.0, 1e-3 * t

    stepper = nts.EnergyMomentum(
        list(scene.bodies.values()), stepper.pairs, dt=0.01, loads=loads, bcs=bcs, update=update
    )
    if reason == "velocity":
        stepper.set_velocity(plate, (0.0, 0.0, 1e-12))
    stepper.set_velocity(scene.bodies["ball"], (0.0, 1.0, -1.0))
    assert stepper.advance().num_sleeping == (1 if reason == "nothing" else 0)


def test_acceleration_after_velocities_are_set_includes_bodies_that_slept(comm):
    """A plate that has slept keeps the velocity that it gets, as one that has not."""
    accelerations = []
    for steps in (0, 2):
        bodies = scenes.ball_plate(comm).bodies
        stepper, plate = nts.GeneralizedAlpha([*bodies.values()], dt=0.01), bodies["plate"]
        for _ in range(steps):
            assert stepper.advance().num_sleeping == 2
        stepper.set_velocity(plate, (0.0, 0.0, -1.0))
        stepper.advance()
        accelerations.append(comm.allreduce(np.abs(stepper.a.x.array).max(initial=0.0)))
    assert np.max(accelerations) < 1e-9


@pytest.mark.parametrize("struck", ["elastic", once("rigid")])
def test_bodies_that_share_nodes_sleep_together(comm, struck):
    data = box_meshes.boxes([(2, 2, 4), (1, 1, 1)], [(1.0, 1.0, 1.2), (0.5, 0.4, 0.3)])
    falling = np.unique(data.cells[data.body == 1])
    data.X[falling] += [0.27, 0.36, 1.21]
    data.body[data.X[data.cells].mean(axis=1)[:, 2] < 0.6] = 2
    mesh, cells, facets, tag = box_meshes.distribute(comm, data)
    V = scenes.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.NeoHookean(1e3, 0.3, 10.0)
    block, base = (nts.Body(V, cells, tag[f"body {i}"], rubber) for i in (1, 2))
    if struck == "rigid":
        top = nts.RigidBody(V, cells, tag["body 0"], 10.0)
    else:
        top = nts.Body(V, cells, tag["body 0"], rubber)
    surfaces = (nts.Surface(V, facets, tag[name]) for name in ("bottom 1", "top 0"))
    stepper = nts.EnergyMomentum(
        [block, top, base],
        [
            nts.ContactPair(
                *surfaces, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
            )
        ],
        dt=0.005,
    )
    stepper.set_velocity(block, (0.3, 0.1, -1.0))
    diagnostics, sleeping, active = nts.Diagnostics(stepper), [], []
    start = diagnostics.balance()
    for step in stepper.run(until=0.04):
        now = diagnostics.balance()
        np.testing.assert_allclose(now.linear_momentum, start.linear_momentum, atol=1e-12)
        np.testing.assert_allclose(now.angular_momentum, start.angular_momentum, atol=1e-12)
        assert now.total_energy == pytest.approx(start.total_energy, rel=1e-11)
        sleeping.append(step.num_sleeping)
        active.append(step.num_active)
    # The whole column, or none of it.
    assert sleeping[0] == (0 if struck == "rigid" else 2) and set(sleeping) <= {0, 2}
    assert max(active) > 0


def test_body_out_of_equilibrium_does_not_sleep(comm):
    scene = scenes.ball_plate(comm)
    stepper, plate = scene.stepper, scene.bodies["plate"]
    stepper.set_displacement(plate, lambda X: 1e-9 * X)
    assert stepper.advance().num_sleeping == 0


def test_body_that_is_strained_while_it_rests_wakes(comm):
    scene = scenes.ball_plate(comm)
    stepper, plate = scene.stepper, scene.bodies["plate"]
    assert stepper.advance().num_sleeping == 1
    stepper.set_displacement(plate, lambda X: 1e-3 * X)
    before = plate_motion(scene)
    assert stepper.advance().num_sleeping == 0
    assert plate_motion(scene) > before == 0


def plate_motion(scene):
    """Largest velocity of the plate on any rank."""
    v = scene.stepper.v.x.array.reshape(-1, 3)[scene.bodies["plate"].nodes]
    return scene.comm.allreduce(np.abs(v).max(initial=0.0), op=scenes.MPI.MAX)


def test_body_moved_without_strain_still_rests(comm):
    scene = scenes.ball_plate(comm)
    stepper, plate = scene.stepper, scene.bodies["plate"]
    stepper.set_displacement(plate, (0.0, 0.0, -0.25))
    assert stepper.advance().num_sleeping == 1


@pytest.mark.serial
@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.CentralDifference])
def test_bodies_far_apart_are_not_projected(comm, scheme):
    law = nts.Penalty() if scheme is nts.CentralDifference else nts.LagrangeMultiplier()
    counts = []
    for height in (0.0, 2.0):
        dt = 1e-3
        scene = scenes.ball_plate(comm, scheme, law, shift=(0.0, 0.0, height), dt=dt)
        counts.append([scene.stepper.advance().num_segments for _ in range(3)])
    assert min(counts[0]) > 0 and counts[1] == [0, 0, 0]


@pytest.mark.serial
def test_no_elimination_without_active_nodes(comm):
    scene = scenes.ball_plate(comm)
    solver = scene.stepper._solver
    for _ in range(3):
        assert scene.stepper.advance().num_active == 0
    assert solver._operator.elimination.empty
    assert solver._contacts.num_builds == 0


@pytest.mark.serial
def test_points_of_the_same_nodes_are_selected_once(comm, monkeypatch):
    """97 times in 126 evaluations, and 314 times if only the points of one set are kept."""
    mesh, cells, facets, tag = nts.read_mesh(nts.examples.ball_plate(), comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(1e5, 0.4, 1e3)
    bodies = [nts.Body(V, cells, tag[name], rubber) for name in ("ball", "plate")]
    sides = (nts.Surface(V, facets, tag[name]) for name in ("ball_outer", "plate_top"))
    stepper = nts.EnergyMomentum(bodies, [nts.ContactPair(*sides)], dt=0.01)
    stepper.set_velocity(bodies[0], (0.0, 1.0, -1.0))
    selections, take = 0, MortarPoints.take

    def counted(points, nodes):
        nonlocal selections
        selections += 1
        return take(points, nodes)

    monkeypatch.setattr(MortarPoints, "take", counted)
    evaluations = sum(step.newton_iterations + 1 for step in stepper.run(until=0.3))
    assert 0 < selections <= evaluations


@pytest.mark.serial
def test_without_friction_there_is_no_slip(comm, monkeypatch):
    def refuse(*_):
        raise AssertionError("slip evaluated")

    scene = scenes.ball_plate(comm)
    monkeypatch.setattr("dolfinx_nts.search.segment_candidates.SegmentCandidates.slip", refuse)
    assert any(scene.stepper.advance().num_active for _ in range(8))


@pytest.mark.serial
def test_dimension_is_not_computed_in_iterations(comm, monkeypatch):
    """It takes the space of a function, its map of dofs, and a microsecond or two."""
    scene = scenes.ball_plate(comm)
    scene.stepper.advance()
    asked, dofmap = [], scenes.fem.FunctionSpace.dofmap.fget
    monkeypatch.setattr(
        scenes.fem.FunctionSpace, "dofmap", property(lambda V: asked.append(V) or dofmap(V))
    )
    for _ in range(8):
        asked.clear()
        report = scene.stepper.advance()
    assert len(asked) <= 4  # once in a step here and there
    assert report.newton_iterations > 2 and report.num_active > 0


@pytest.mark.serial
def test_deformable_bodies_have_pairs_of_multipliers_made_once_in_an_iteration(comm, monkeypatch):
    """Only in small systems all states are determined together, which needs the pairs, too."""
    scene = scenes.ball_plate(comm, friction=nts.Coulomb(0.3))
    made, make = [], krylov.active_pairs
    monkeypatch.setattr(krylov, "active_pairs", lambda *args: made.append(args) or make(*args))
    reports = list(scene.stepper.run(12 * scene.stepper.dt))
    assert max(report.num_active for report in reports) > 0
    assert len(made) == sum(report.newton_iterations for report in reports)


@pytest.mark.serial
def test_without_friction_nodes_are_balanced_again_only_where_some_change(comm, monkeypatch):
    scene = scenes.ball_plate(comm)
    balances, looks = [], []
    balance, update = Friction.balance, MultiplierContact.update
    monkeypatch.setattr(Friction, "balance", lambda *args: balances.append(args) or balance(*args))

    def counted(*args):
        balances.clear()
        changes = update(*args)
        looks.append((bool(changes), len(balances)))
        return changes

    monkeypatch.setattr(MultiplierContact, "update", counted)
    reports = list(scene.stepper.run(12 * scene.stepper.dt))
    assert max(report.num_active for report in reports) > 0
    assert set(looks) == {(False, 1), (True, 2)}


@pytest.mark.serial
def test_nodes_out_of_reach_are_searched_once_per_step(comm, monkeypatch):
    scene, reference = ball_plate(comm, "elastic"), ball_plate(comm, "elastic")
    for each in (scene, reference):
        each.stepper.set_velocity(each.bodies["ball"], spinning)
    calls, looks = [], []
    for name in ("evaluate", "_kinematics"):
        call = getattr(ContactStep, name)

        def counted(self, *args, name=name, call=call):
            calls.append((name, self.may_touch))
            return call(self, *args)

        monkeypatch.setattr(ContactStep, name, counted)
    for _ in range(8):
        calls.clear()
        scene.stepper.advance()
        (may_touch,) = {touches for _, touches in calls}
        names = [name for name, _ in calls]
        looks.append((may_touch, names.count("evaluate"), names.count("_kinematics")))
    assert {may_touch for may_touch, *_ in looks} == {True, False}
    assert all(n > 1 and m == (n if may_touch else 1) for may_touch, n, m in looks)
    ignored = property(lambda _: None, lambda *_: None)
    monkeypatch.setattr(ContactStep, "_idle", ignored, raising=False)
    for _ in range(8):
        reference.stepper.advance()
    np.testing.assert_array_equal(scene.positions(), reference.positions())


def spinning(X):
    """Velocity of a ball that turns, so that a step takes several iterations."""
    return np.stack([-3 * X[1], 1 + 3 * X[0], -1 + 0 * X[2]])
