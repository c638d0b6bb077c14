"""Contact of edges that cross, of rigid and of deformable cubes."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.search.edges.edge_candidates import EdgeCandidates
from helpers.models.box_meshes import boxes, distribute
from helpers.models.corners import corners
from helpers.models.crossing import crossed, deepest
from helpers.once import once
from helpers.scene import Motion, gathered
from helpers.separation import separation
from reference.bulk import rotation


def run(scene, num_steps=40):
    """Balances at start and end, work of contact, deepest overlap, steps with edge contact."""
    stepper = scene.stepper
    diagnostics, given, depth, touched = nts.Diagnostics(stepper), 0.0, 0.0, 0
    first = diagnostics.balance()
    for _ in range(num_steps):
        report = stepper.advance()
        given += sum(report.contact_work)
        depth = max(depth, deepest(diagnostics))
        edges = [c for c in stepper.contacts if c.pair.method == "edge-to-edge"]
        active = sum(np.count_nonzero(c.history.active) for c in edges)
        touched += stepper.u.function_space.mesh.comm.allreduce(active) > 0
    return first, diagnostics.balance(), given, depth, touched


def check(first, last, given, tol=1e-11):
    """Energy without the contribution of contact, and both momenta, are conserved."""
    energy = last.total_energy - last.contact_energy
    assert abs(energy - first.total_energy - given) < tol * first.total_energy
    for name in ("linear_momentum", "angular_momentum"):
        before, after = getattr(first, name), getattr(last, name)
        assert np.linalg.norm(after - before) < tol * np.linalg.norm(before)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("is_rigid", [once(True, id="rigid"), False])
def test_cubes_bounce_off_each_others_edges_with_exact_energy_in_any_position(comm, is_rigid):
    motion = Motion.random(np.random.default_rng(7))
    dt = 0.01 if is_rigid else 0.004
    scene = crossed(comm, is_rigid=is_rigid, motion=motion, dt=dt)
    first, last, given, depth, touched = run(scene, 20 if is_rigid else 55)
    check(first, last, given)
    assert abs(given) < 1e-11 * first.total_energy
    assert touched > 0
    assert depth < 1e-3
    # They separate: neither reaches the other any more.
    edges = scene.stepper.contacts[-1]
    assert not np.any(edges.gap(scene.stepper.x) < 0.01)
    momentum = motion.Q.T @ (last.linear_momentum - first.linear_momentum)
    assert np.abs(momentum).max() < 1e-10


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
@pytest.mark.parametrize("law", [None, nts.Penalty(), nts.LagrangeMultiplier("plastic")])
def test_edges_of_soft_cubes_touch_by_default(comm, law, method):
    scene = crossed(comm, edges=None, enforcement=law, method=method)
    first, last, given, depth, _ = run(scene, 55)
    check(first, last, given)
    assert depth < 0.05 if law else depth < 5e-3
    *_, upper = nts.Diagnostics(scene.stepper).bodies().values()
    assert upper.velocity[2] > -0.6


@pytest.mark.serial
def test_edges_of_rigid_cubes_touch_by_default(comm):
    first, last, given, depth, _ = run(crossed(comm, is_rigid=True, edges=None, dt=0.01), 20)
    check(first, last, given)
    assert depth < 1.5e-2


@pytest.mark.serial
def test_cubes_penetrate_without_edge_contact(comm):
    _, _, _, depth, _ = run(crossed(comm, is_rigid=True, edges=False, dt=0.01), 20)
    assert depth > 0.09


LAWS = {
    "plastic": {"enforcement": nts.LagrangeMultiplier("plastic")},
    "springs": {"enforcement": nts.Penalty()},
    "friction": {"friction": nts.Coulomb(0.05)},  # otherwise the nodes stick
    "springs and friction": {"enforcement": nts.Penalty(), "friction": nts.Coulomb(0.3)},
    "tetrahedra": {"cell": "tetrahedron"},
    "degree 2": {"degree": 2, "n": 1},
    "rigid, plastic": {"is_rigid": True, "enforcement": nts.LagrangeMultiplier("plastic")},
    "rigid, springs": {"is_rigid": True, "enforcement": nts.Penalty(2.0e4)},
}


@pytest.mark.serial
@pytest.mark.parametrize("law", LAWS)
def test_ledger_closes_with_every_law(comm, law):
    first, last, given, depth, touched = run(crossed(comm, **LAWS[law]), 30)
    check(first, last, given)
    assert touched > 0
    assert depth < (0.04 if "springs" in law else 0.01)
    if "friction" in LAWS[law]:
        assert given < -1e-3 * first.total_energy


@pytest.mark.serial
def test_midpoint_keeps_momenta_and_nearly_the_energy(comm):
    first, last, _, depth, touched = run(crossed(comm, scheme=nts.Midpoint), 30)
    check(first, last, 0.0, tol=1e-4)
    assert touched > 0 and depth < 0.01


@pytest.mark.at_most_two_ranks
def test_a_run_that_is_resumed_within_a_touch_is_the_whole_one_bit_for_bit(comm, tmp_path):
    path, friction = comm.bcast(tmp_path) / "run", nts.Coulomb(0.3)
    whole, part, rest = (crossed(comm, friction=friction, n=2).stepper for _ in range(3))
    for stepper, num_steps in ((part, 7), (rest, 12)):
        with nts.Recorder(
            path, stepper, checkpoint_every=1, resume=True, fields="xdmf"
        ) as recorder:
            for step in stepper.run(until=num_steps * stepper.dt):
                recorder.write(step)
        assert comm.allreduce(int(stepper.contacts[-1].history.active.sum())) > 0
    for _ in whole.run(until=12 * whole.dt):
        pass
    assert np.array_equal(rest.x, whole.x)


@pytest.mark.several_ranks
def test_any_number_of_ranks_finds_the_same(comm):
    everywhere = crossed(comm, friction=nts.Coulomb(0.3))
    alone = crossed(MPI.COMM_SELF, friction=nts.Coulomb(0.3))
    for scene in (everywhere, alone):
        for _ in range(10):
            scene.stepper.advance()
    places = [gathered(s.stepper.u.function_space, s.stepper.x) for s in (everywhere, alone)]
    assert np.abs(places[0] - places[1]).max() < 1e-9


@pytest.mark.serial
def test_edges_out_of_reach_are_not_searched(comm, monkeypatch):
    scene = crossed(comm, is_rigid=True)
    scene.stepper.set_displacement(scene.bodies["upper"], (0.0, 0.0, 5.0))
    calls = []
    crossing = EdgeCandidates._crossing
    monkeypatch.setattr(
        EdgeCandidates, "_crossing", lambda *args: calls.append(1) or crossing(*args)
    )
    for _ in range(5):
        scene.stepper.advance()
    assert not calls
    assert scene.stepper.contacts[-1].search.num_searches == 1


@pytest.mark.serial
def test_edges_that_are_pressed_together_carry_the_force_in_equilibrium(comm):
    scene = crossed(comm, n=2)
    V = scene.stepper.u.function_space
    moved = fem.Function(V)

    def update(t):
        moved.interpolate(lambda x: np.array([0 * x[0], 0 * x[0], 0 * x[0] - t]))

    low, high = (
        fem.locate_dofs_geometrical(V, lambda x, side=side: side * (x[2] - 0.7) > 0.69)
        for side in (-1, 1)
    )
    bcs = [fem.dirichletbc(np.zeros(3), low, V), fem.dirichletbc(moved, high)]
    pairs = scene.stepper.pairs
    stepper = nts.QuasiStatic(scene.stepper.bodies, pairs, dt=0.02, bcs=bcs, update=update)
    for _ in range(3):
        stepper.advance()
    nodes, edges = stepper.contacts
    force = edges.history.force.sum(axis=0)
    assert force[2] * (1 if edges.nodes is scene.stepper.pairs[0].segments else -1) > 50
    assert not nodes.history.active.any()
    assert deepest(nts.Diagnostics(stepper)) < 1e-6


@pytest.mark.serial
@pytest.mark.parametrize("offset", [(0.6, 0.0), (0.0, 0.6)])
@pytest.mark.parametrize("enforcement", [None, nts.Penalty(2.0e4)])
def test_an_edge_passing_the_end_of_another_edge_has_no_contact(comm, enforcement, offset):
    # It crosses 0.1 m from the end of the other edge; faces touch at the same depth below it.
    laws = {"is_rigid": True, "n": 1, "enforcement": enforcement, "dt": 0.01}
    scene = crossed(comm, place=[*offset, np.sqrt(2) + 0.02], velocity=(0.0, 0.0, -1.0), **laws)
    x = scene.stepper.x.copy()
    for _ in range(8):
        scene.stepper.advance()
    moved = scene.stepper.x - x
    assert np.abs(moved[scene.bodies["upper"].nodes] - [0, 0, -0.08]).max() < 1e-12
    assert np.abs(moved[scene.bodies["lower"].nodes]).max() < 1e-12


@pytest.mark.serial
@pytest.mark.parametrize("slope", [0.3, 0.03, 0.003, 0.0])
def test_edges_nearly_flat_on_a_face_are_found(comm, slope):
    # A face of a cube lies nearly flat on the edge of the other cube. Undetected, it penetrates by
    # the slope times its length until a corner touches, and without limit if it is flat.
    scene = crossed(comm, is_rigid=True, n=1)
    edges, x = scene.stepper.contacts[-1], scene.stepper.x
    upper = scene.bodies["upper"].nodes
    low = x[upper][x[upper, 2].argmin()]
    turn = rotation([0, 1, 0], np.pi / 4 - slope)
    # Its edge is 1 mm below the other one, at its middle.
    x[upper] = (x[upper] - [low[0], 0, low[2]]) @ turn.T + [0, 0, np.sqrt(0.5) - 0.001]
    candidates, _ = edges.search.update(x, 0.1)
    points, none = edges.facets.points(x), np.full(len(edges.nodes.nodes), -1, dtype=np.int32)
    _, gap = candidates.pair(points, candidates.scatter.forward(x), none, 0.1)
    assert np.nanmin(gap) == pytest.approx(-0.001, rel=1e-9)


@pytest.mark.serial
def test_an_edge_that_is_pressed_flat_on_a_face_between_its_nodes_does_not_sink_in(comm):
    # The ridge of the lower block lies between two rows of nodes of the face above it.
    data = boxes([(1, 1, 1), (3, 1, 2)], [(1.0, 1.2, 1.0), (1.0, 1.0, 0.5)])
    ridge, upper = (np.unique(data.cells[data.body == body]) for body in (0, 1))
    data.X[ridge] -= data.X[ridge].mean(axis=0)
    data.X[ridge] = data.X[ridge] @ rotation([0, 1, 0], np.pi / 4).T
    data.X[upper] += -data.X[upper].mean(axis=0) + [0.02, 0.0, np.sqrt(0.5) + 0.251]
    mesh, cells, _, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    soft, stiff = (nts.NeoHookean(E, 0.3, 1.0) for E in (1.0e4, 1.0e6))
    bodies = [nts.Body(V, cells, tag["body 0"], stiff), nts.Body(V, cells, tag["body 1"], soft)]
    moved = fem.Function(V)

    def update(t):
        moved.interpolate(lambda x: np.array([0 * x[0], 0 * x[0], 0 * x[0] - t]))

    low = fem.locate_dofs_geometrical(V, lambda x: x[2] < 0.1)
    high = fem.locate_dofs_geometrical(V, lambda x: x[2] > np.sqrt(0.5) + 0.4)
    bcs = [fem.dirichletbc(np.zeros(3), low, V), fem.dirichletbc(moved, high)]
    pairs = nts.all_pairs(
        bodies, edges=True, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    stepper = nts.QuasiStatic(bodies, pairs, dt=0.02, bcs=bcs, update=update)
    for _ in range(3):
        report = stepper.advance()
    assert report.reactions[0].force[2] > 50
    assert deepest(nts.Diagnostics(stepper)) < 1e-3


@pytest.mark.serial
@pytest.mark.parametrize("degrees", [90.0, 10.0, 5.0, 2.0])
def test_cubes_do_not_pass_each_other_at_edges_of_any_angle(comm, degrees):
    # Elastic impact may keep half the approach of a step, 5 mm; without edges it is 46 mm.
    place, turn = [0.03, 0.02, np.sqrt(2) + 0.02], np.radians(degrees)
    laws = {"is_rigid": True, "n": 1, "dt": 0.01, "velocity": (0.0, 0.0, -1.0)}
    scene = crossed(comm, turn=turn, place=place, **laws)
    stepper = scene.stepper
    lower, upper = (corners(stepper, body) for body in scene.bodies.values())
    for _ in range(25):
        stepper.advance()
        assert separation(stepper.x[lower], stepper.x[upper]) > -5e-3
