"""Edges of bodies that cross edges of a rigid faceted obstacle, at rest or moving."""

from functools import partial

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_nts as nts
from helpers.models.corners import corners
from helpers.models.ridge import box_corners, over_ridge
from helpers.once import once
from helpers.scene import Motion, gathered
from helpers.separation import separation

explicit = partial(over_ridge, scheme=nts.CentralDifference, dt=1e-3, enforcement=nts.Penalty())
TURNING = nts.Motion(
    translation=lambda t: (0.0, 0.0, t), rotation=lambda t: (0.0, 0.3 * t, 2.0 * t)
)


def run(scene, until):
    """Balances at start and end, works of contact by cause [J], impulse, its moment, contacts."""
    stepper = scene.stepper
    comm = stepper.u.function_space.mesh.comm
    diagnostics, works, given = nts.Diagnostics(stepper), np.zeros(8), np.zeros((2, 3))
    first, touched = diagnostics.balance(), 0
    for _ in range(round(until / stepper.dt)):
        works += stepper.advance().contact_work
        (on_obstacle,) = diagnostics.obstacles().values()
        given -= stepper.dt * np.array([on_obstacle.force, on_obstacle.torque])
        edges = [c for c in stepper.contacts if c.pair.method == "edge-to-edge"]
        touched += comm.allreduce(sum(int(c.history.active.sum()) for c in edges))
    return first, diagnostics.balance(), works, given, touched


def check_ledger(first, last, works, tol=1e-11):
    """The change of energy is the sum of the works of contact."""
    change = last.total_energy - last.contact_energy - first.total_energy
    assert abs(change - works.sum()) < tol * max(first.total_energy, last.total_energy)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("e", [0.0, once(0.5), once(1.0)])
def test_central_blow_on_a_ridge_returns_e_times_the_speed(comm, e):
    motion = Motion.random(np.random.default_rng(5))
    law = nts.LagrangeMultiplier("restitution", e=e)
    blow = {"place": (0.0, 0.0, np.sqrt(2) + 0.02), "velocity": (0.3, 0.0, -1.0), "dt": 0.01}
    scene = over_ridge(comm, is_rigid=True, enforcement=law, motion=motion, n=3, **blow)
    first, last, works, given, touched = run(scene, 0.06)
    assert touched > 0
    check_ledger(first, last, works)
    momentum = motion.Q.T @ last.linear_momentum
    assert np.abs(momentum - 10.0 * np.array([0.3, 0, e])).max() < 1e-10
    assert np.abs(last.linear_momentum - first.linear_momentum - given[0]).max() < 1e-10
    assert works.sum() == pytest.approx(-5.0 * (1 - e**2), abs=1e-10)


@pytest.mark.serial
def test_a_cube_stops_outside_of_the_box_and_goes_into_it_without_edges(comm):
    for laws, deepest in (
        ({"dt": 0.01}, 5e-3),
        ({"dt": 0.01, "edges": None}, 1.5e-2),
        ({"dt": 0.01, "edges": False}, None),
        ({"scheme": nts.CentralDifference, "enforcement": nts.Penalty(2e4), "dt": 1e-3}, 0.0226),
    ):
        scene, least = over_ridge(comm, is_rigid=True, n=1, **laws), 0.0
        x = corners(scene.stepper, scene.bodies["cube"])
        while scene.stepper.t < 0.12:
            scene.stepper.advance()
            least = min(least, separation(scene.stepper.x[x], box_corners()))
        assert least < -0.05 if deepest is None else least > -deepest


LAWS = {
    "elastic": {},
    "plastic": {"enforcement": nts.LagrangeMultiplier("plastic")},
    "springs": {"enforcement": nts.Penalty()},
    "friction": {"friction": nts.Coulomb(0.05)},
    "springs and friction": {"enforcement": nts.Penalty(), "friction": nts.Coulomb(0.3)},
}


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("moving", [once(None), TURNING], ids=["at rest", "turning"])
@pytest.mark.parametrize("law", [once(law) for law in LAWS if law != "friction"] + ["friction"])
def test_ledger_and_momentum_balance_with_every_law(comm, law, moving):
    velocity = (0.1, -0.05, -1.0) if moving is None else (0.0, 0.0, 0.0)
    scene = over_ridge(comm, velocity=velocity, moving=moving, **LAWS[law])
    first, last, works, given, touched = run(scene, 0.1)
    assert touched > 0
    check_ledger(first, last, works)
    assert np.abs(last.linear_momentum - first.linear_momentum - given[0]).max() < 1e-10
    if moving is None:
        assert works[5] == 0.0
        moment = last.angular_momentum - first.angular_momentum
        assert np.abs(moment - given[1]).max() < 1e-9
    if law == "elastic":
        assert works[:5] == pytest.approx(np.zeros(5), abs=1e-11 * last.total_energy)


@pytest.mark.serial
@pytest.mark.parametrize("make", [partial(over_ridge, dt=0.004), explicit])
def test_result_is_the_same_if_the_obstacle_moves_instead_of_the_cube(comm, make):
    friction = nts.Coulomb(0.3)
    falls = make(comm, friction=friction, velocity=(0.0, 0.0, -1.0))
    rising = nts.Motion(translation=lambda t: (0.0, 0.0, t))
    rises = make(comm, friction=friction, velocity=(0.0, 0.0, 0.0), moving=rising)
    pressed = 0.0
    for _ in range(round(0.08 / falls.stepper.dt)):
        for scene in (falls, rises):
            scene.stepper.advance()
        pressed = max(pressed, np.abs(falls.stepper.contacts[-1].history.force).max())
    moved = rises.stepper.x - falls.stepper.x
    assert np.abs(moved - [0, 0, falls.stepper.t]).max() < 1e-10
    assert pressed > 1


@pytest.mark.at_most_two_ranks
def test_explicit_steps_balance_momenta_with_an_obstacle_that_turns(comm):
    scene = explicit(comm, friction=nts.Coulomb(0.3), velocity=(0, 0, 0), moving=TURNING)
    first, last, works, given, touched = run(scene, 0.08)
    assert touched > 0
    # The last force has acted for half a step only.
    (now,) = nts.Diagnostics(scene.stepper).obstacles().values()
    rest = scene.stepper.dt * np.asarray(now.force) / 2
    assert np.abs(last.linear_momentum - first.linear_momentum - given[0] - rest).max() < 1e-11
    check_ledger(first, last, works, tol=5e-3)


@pytest.mark.serial
def test_facets_with_vertices_of_their_own_have_the_same_edges(comm):
    ends = []
    for is_soup in (False, True):
        scene = over_ridge(comm, is_rigid=True, n=1, dt=0.01, is_soup=is_soup)
        assert [pair.method for pair in scene.stepper.pairs] == ["node-to-segment", "edge-to-edge"]
        for _ in range(6):
            scene.stepper.advance()
        ends.append(scene.stepper.x)
    assert np.array_equal(*ends)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("make", [once(over_ridge, id="implicit"), explicit])
def test_a_run_that_is_resumed_within_a_touch_is_the_whole_one_bit_for_bit(comm, tmp_path, make):
    path = comm.bcast(tmp_path) / "run"
    laws = {"friction": nts.Coulomb(0.3), "velocity": (0, 0, 0), "moving": TURNING}
    whole, part, rest = (make(comm, **laws).stepper for _ in range(3))
    for stepper, until in ((part, 0.032), (rest, 0.06)):
        with nts.Recorder(
            path, stepper, checkpoint_every=1, resume=True, fields="xdmf"
        ) as recorder:
            for step in stepper.run(until=until):
                recorder.write(step)
    for _ in whole.run(until=0.06):
        pass
    assert np.array_equal(rest.x, whole.x)
    assert comm.allreduce(int(whole.contacts[-1].history.active.sum())) > 0


@pytest.mark.several_ranks
@pytest.mark.parametrize("make", [over_ridge, explicit])
def test_any_number_of_ranks_finds_the_same(comm, make):
    laws = {"friction": nts.Coulomb(0.3), "velocity": (0, 0, 0), "moving": TURNING}
    scenes = [make(each, **laws) for each in (comm, MPI.COMM_SELF)]
    for scene in scenes:
        for _ in range(round(0.05 / scene.stepper.dt)):
            scene.stepper.advance()
    places = [gathered(s.stepper.u.function_space, s.stepper.x) for s in scenes]
    assert np.abs(places[0] - places[1]).max() < 1e-9
