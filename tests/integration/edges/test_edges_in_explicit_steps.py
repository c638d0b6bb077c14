"""Edges that cross in explicit steps: rigid and deformable cubes, and cubes that tumble."""

from functools import partial
from itertools import combinations

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models.box_meshes import boxes, distribute
from helpers.models.corners import corners
from helpers.models.crossing import crossed, deepest, tumbling
from helpers.scene import gathered
from helpers.separation import separation
from reference.bulk import rotation

SPRINGS = nts.Penalty(2.0e4)
# Compression of the spring [m] that stops two cubes of 10 kg, one of them at 1 m/s.
DEPTH = 1.0 * np.sqrt(10.0 / 2 / SPRINGS.eps_N)
explicit = partial(crossed, scheme=nts.CentralDifference, dt=1e-3)
rigid = partial(explicit, is_rigid=True, enforcement=SPRINGS)


def run(stepper, until, every=1):
    """Balances at start and end, energy change by contact [J], least separation of cubes [m]."""
    diagnostics, given = nts.Diagnostics(stepper), 0.0
    first, least = diagnostics.balance(), np.inf
    cubes = [corners(stepper, body) for body in stepper.bodies]
    for step in range(round(until / stepper.dt)):
        report = stepper.advance()
        given += report.load_work + sum(report.contact_work)
        if step % every == 0:
            x = stepper.x
            apart = (separation(x[a], x[b]) for a, b in combinations(cubes, 2))
            least = min(least, *apart)
    return first, diagnostics.balance(), given, least


def velocity(scene, name):
    """Velocities of the nodes of a body, shape ``(n, 3)`` [m/s]."""
    return scene.stepper.v.x.array.reshape(-1, 3)[scene.bodies[name].nodes]


def check_momenta(first, last):
    """Both momenta are conserved."""
    for name in ("linear_momentum", "angular_momentum"):
        before, after = getattr(first, name), getattr(last, name)
        assert np.linalg.norm(after - before) < 1e-11 * np.linalg.norm(before)


@pytest.mark.serial
def test_rigid_cubes_bounce_off_each_others_edges_and_pass_without(comm):
    scene = rigid(comm)
    first, last, _, least = run(scene.stepper, 0.2)
    check_momenta(first, last)
    # They rotate a little, so that the spring stores less than in a central collision.
    assert -DEPTH < least < -0.9 * DEPTH
    assert velocity(scene, "upper")[:, 2].mean() > -0.05
    *_, least = run(rigid(comm, edges=False).stepper, 0.2)
    assert least < -0.09


@pytest.mark.serial
def test_a_central_blow_exchanges_the_velocities(comm):
    # Equal cubes touch at the middle of their edges: elastic impact along the line of centres.
    scene = rigid(comm, place=np.array([0.0, 0.0, np.sqrt(2) + 0.02]), velocity=(0.0, 0.0, -1.0))
    first, last, given, least = run(scene.stepper, 0.2)
    assert abs(last.total_energy - first.total_energy - given) < 1e-11 * first.total_energy
    assert -least == pytest.approx(DEPTH, rel=5e-3)
    # Up to the second-order error of steps of 1/50 of the contact duration.
    assert np.abs(velocity(scene, "upper")).max() < 1e-3
    assert np.abs(velocity(scene, "lower") - [0, 0, -1]).max() < 1e-3


@pytest.mark.serial
@pytest.mark.parametrize("mu", [None, 0.1])  # at 0.3 the edges stick
def test_energy_error_falls_with_the_square_of_the_step(comm, mu):
    friction = None if mu is None else nts.Coulomb(mu)
    errors = []
    for dt in (1e-3, 2.5e-4):
        stepper = rigid(comm, friction=friction, dt=dt).stepper
        diagnostics, taken, worst = nts.Diagnostics(stepper), 0.0, 0.0
        first = diagnostics.balance()
        while stepper.t < 0.1:
            taken += stepper.advance().contact_work.friction
            now = diagnostics.balance()
            worst = max(worst, abs(now.total_energy - first.total_energy - taken))
        check_momenta(first, now)
        assert (taken < -1e-3 * first.total_energy) == (mu is not None)
        errors.append(worst)
    assert errors[0] < 2e-3 * first.total_energy
    assert errors[1] < errors[0] / 10


LAWS = {
    "hexahedra": {},
    "friction": {"friction": nts.Coulomb(0.3)},
    "tetrahedra": {"cell": "tetrahedron", "dt": 5e-4},
    "degree 2": {"degree": 2, "n": 1, "dt": 5e-4},
}


@pytest.mark.serial
@pytest.mark.parametrize("law", LAWS)
def test_deformable_cubes_keep_momenta_and_edges_outside(comm, law):
    stepper = explicit(comm, enforcement=nts.Penalty(), **LAWS[law]).stepper
    diagnostics, given, depth, touched = nts.Diagnostics(stepper), 0.0, 0.0, 0
    first = diagnostics.balance()
    for step in range(round(0.1 / stepper.dt)):
        given += sum(stepper.advance().contact_work)
        touched += int(stepper.contacts[-1].history.active.any())
        if step % 5 == 0:
            depth = max(depth, deepest(diagnostics))
    last = diagnostics.balance()
    check_momenta(first, last)
    assert abs(last.total_energy - last.contact_energy - first.total_energy - given) < (
        5e-3 * first.total_energy
    )
    assert stepper.contacts[-1].pair.method == "edge-to-edge" and touched > 0
    assert depth < 0.01


@pytest.mark.at_most_two_ranks
def test_forces_on_the_edges_are_the_change_of_momentum(comm):
    scene = explicit(comm, enforcement=nts.Penalty(), friction=nts.Coulomb(0.3))
    stepper, edges = scene.stepper, scene.stepper.contacts[-1]
    first = np.isin(scene.bodies["upper"].nodes[:1], edges.nodes.nodes)
    upper_gives = comm.allreduce(bool(first.any()), MPI.LOR)
    own = scene.bodies["upper" if upper_gives else "lower"]
    n = len(stepper.node_ids)
    nodes, force, pushed = own.nodes[own.nodes < n], np.zeros(3), 0.0

    def total(values):
        return comm.allreduce(values.sum(axis=0))

    for _ in range(60):
        before, old = total(stepper.nodal_momentum()[nodes]), force
        stepper.advance()
        others = sum(np.abs(total(c.history.force)).sum() for c in stepper.contacts[:-1])
        assert others == 0
        force = total(edges.history.force)
        pushed = max(pushed, np.linalg.norm(force))
        change = total(stepper.nodal_momentum()[nodes]) - before
        assert np.abs(change - stepper.dt * (old + force) / 2).max() < 1e-12
    assert pushed > 10


@pytest.mark.at_most_two_ranks
def test_a_run_that_is_resumed_within_a_touch_is_the_whole_one_bit_for_bit(comm, tmp_path):
    path, laws = comm.bcast(tmp_path) / "run", {"friction": nts.Coulomb(0.3), "n": 2}
    whole, part, rest = (
        explicit(comm, enforcement=nts.Penalty(), **laws).stepper for _ in range(3)
    )
    for stepper, num_steps in ((part, 37), (rest, 60)):
        with nts.Recorder(
            path, stepper, checkpoint_every=1, resume=True, fields="xdmf"
        ) as recorder:
            for step in stepper.run(until=num_steps * stepper.dt):
                recorder.write(step)
        if stepper is part:
            assert comm.allreduce(int(stepper.contacts[-1].history.active.sum())) > 0
    for _ in whole.run(until=60 * whole.dt):
        pass
    assert np.array_equal(rest.x, whole.x)


@pytest.mark.several_ranks
def test_any_number_of_ranks_finds_the_same(comm):
    scenes = [
        explicit(each, enforcement=nts.Penalty(), friction=nts.Coulomb(0.3))
        for each in (comm, MPI.COMM_SELF)
    ]
    for scene in scenes:
        for _ in range(60):
            scene.stepper.advance()
    places = [gathered(s.stepper.u.function_space, s.stepper.x) for s in scenes]
    assert np.abs(places[0] - places[1]).max() < 1e-9


@pytest.mark.serial
def test_tumbling_cubes_do_not_enter_each_other_at_their_edges(comm):
    laws = {"enforcement": nts.Penalty(4.0e4), "scheme": nts.CentralDifference, "dt": 1e-3}
    depths = []
    for edges in (True, False):
        stepper = tumbling(comm, edges, **laws)
        first, last, given, least = run(stepper, 0.73, every=10)
        assert not edges or abs(last.total_energy - first.total_energy - given) < (
            5e-3 * last.total_energy
        )
        depths.append(-least)
    assert depths[0] < 0.02
    assert depths[1] > 0.08


@pytest.mark.serial
def test_an_edge_rotating_past_a_corner_is_not_active_deep_inside(comm):
    """A corner has penetrated a face by 1.2 cm; edges cross next to it, 6.7 cm deep."""
    places = np.array([[1.0045, 2.3308, 0.9978], [1.0628, 1.1682, 1.8426]])
    turns = np.array([[1.8565, -0.0354, 0.1804], [0.1393, -3.0984, -0.339]])
    velocities = np.array([[0.503, -0.535, 0.72], [0.074, -0.012, -1.593]])
    spins = np.array([[0.385, -2.691, 1.368], [-4.354, 5.382, 3.976]])
    data = boxes([(1, 1, 1)] * 2, [(1.0, 1.0, 1.0)] * 2)
    for body, (place, turn) in enumerate(zip(places, turns, strict=True)):
        some = np.unique(data.cells[data.body == body])
        X = data.X[some] - data.X[some].mean(axis=0)
        data.X[some] = X @ rotation(turn, np.linalg.norm(turn)).T + place
    mesh, cells, _, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bodies = [nts.RigidBody(V, cells, tag[f"body {i}"], 2.0) for i in range(2)]
    springs = nts.Penalty(4e4)
    pairs = nts.all_pairs(bodies, enforcement=springs, edges=True, method="node-to-segment")
    pairs += [
        nts.ContactPair(pair.segments, pair.nodes, springs, method="node-to-segment")
        for pair in pairs
        if pair.method != "edge-to-edge"
    ]
    stepper = nts.CentralDifference(bodies, pairs, dt=1e-3)
    for body, place, velocity, spin in zip(bodies, places, velocities, spins, strict=True):
        stepper.set_velocity(
            body, lambda X, a=place, v=velocity, w=spin: (v + np.cross(w, X.T - a)).T
        )
    first, last, _, least = run(stepper, 0.012)
    check_momenta(first, last)
    # A spring that became active there would add 90 J.
    assert last.total_energy < 1.01 * first.total_energy
    assert -0.02 < least < -0.01
