"""Nodes above edges and vertices of segments: results depend neither on numbering nor round-off."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.common.archive import Snapshot
from helpers import scenes
from helpers.models.box_meshes import boxes, distribute
from helpers.models.boxed import CLOSED, Ledger
from helpers.once import once
from reference.bulk import rotation

GAP, STEP, SHORT = 1e-3, 5e-3, 2e-3  # m, s, s in explicit steps
# Explicit steps, in which the blocks touch, slide and part [-].
LONG = 200
# Tolerance of velocities [m/s]: round-off and the tolerance of Newton's method, measured 8e-12.
SAME = 1e-9
# Change of the energy [J], relative to the kinetic energy at the start.
CONSERVED = 1e-9


def blocks(comm, seed=0, cell="hexahedron", owner=None):
    """Space, bodies and surfaces of two blocks, 3 on 3 cells, with nodes above vertices.

    ``seed`` permutes nodes, cells and the vertices of each cell, 0 does not. Collective.
    """
    data = boxes([(3, 3, 1), (3, 3, 1)], [(1.0, 1.0, 0.4), (1.0, 1.0, 0.4)], cell)
    data.X[np.unique(data.cells[data.body == 1])] += [0.0, 0.0, 0.4 + GAP]
    if seed:
        data = data.permuted(np.random.default_rng(seed))
    mesh, cells, facets, tag = distribute(comm, data, owner=owner)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    # Different stiffnesses, so that surfaces curve where they touch.
    bodies = [
        nts.Body(V, cells, tag[f"body {i}"], nts.NeoHookean(E, 0.3, 1e3))
        for i, E in enumerate((1e5, 4e5))
    ]
    return V, bodies, [nts.Surface(V, facets, tag[name]) for name in ("bottom 1", "top 0")]


def impact(V, bodies, pair, scheme=nts.EnergyMomentum, velocity=(0.0, 0.0, -1.0), steps=4):
    """Velocities after an impact of the second block, in the order of their nodes in space.

    Returns velocities of the owned nodes, ``(n, 3)`` [m/s], the same mirrored at the middle plane
    of x, how many nodes have several segments in each step, and the change of the energy, relative
    to the kinetic energy at the start. Collective.
    """
    stepper = scheme(bodies, [pair], dt=SHORT if scheme is nts.CentralDifference else STEP)
    stepper.set_velocity(bodies[1], velocity)
    before, shared = nts.Diagnostics(stepper).balance(), []
    for _ in range(steps):
        stepper.advance()
        shared.append(int(np.count_nonzero(pair.history.shared)))
    after, n = nts.Diagnostics(stepper).balance(), V.dofmap.index_map.size_local
    X, v = V.tabulate_dof_coordinates()[:n], stepper.v.x.array.reshape(-1, 3)[:n]
    # Nodes of the two blocks are 1 mm apart where they touch.
    order, mirrored = in_space(X), v[in_space(X * [-1, 1, 1])] * [-1, 1, 1]
    change = (after.total_energy - before.total_energy) / before.kinetic_energy
    return v[order], mirrored, shared, change


def ridge(fall, order=slice(None)):
    """Rigid surface of 3 on 3 facets with an edge at x = 1/3, from which it falls by a slope."""
    y, x = np.indices((4, 4)).reshape(2, 16) / 3
    points = np.stack([x, y, 0.4 - fall * np.abs(x - 1 / 3)], axis=1)
    number = np.arange(16).reshape(4, 4)
    facets = [number[j : j + 2, i : i + 2].ravel() for j in range(3) for i in range(3)]
    return nts.RigidSurface(points, np.array(facets)[order], outside=(0.5, 0.5, 9.0))


def in_space(X):
    """Order of points by their coordinates, independent of round-off."""
    return np.lexsort(np.round(X, 6).T)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("scheme", "law", "friction"),
    [
        (nts.EnergyMomentum, None, None),
        (nts.EnergyMomentum, None, nts.Coulomb(0.3)),
        (nts.EnergyMomentum, nts.Penalty(1e4), None),
        once(nts.Midpoint, None, None),
        once(nts.Midpoint, None, nts.Coulomb(0.3)),
    ],
)
def test_nodes_above_vertices_depend_neither_on_numbers_nor_on_round_off(scheme, law, friction):
    def velocities(seed):
        V, bodies, surfaces = blocks(MPI.COMM_SELF, seed)
        return impact(
            V, bodies, nts.ContactPair(*surfaces, law, friction, method="node-to-segment"), scheme
        )

    v, mirrored, shared, change = velocities(seed=0)
    assert max(shared) > 0
    np.testing.assert_allclose(mirrored, v, rtol=0, atol=SAME)
    renumbered = velocities(seed=1)
    np.testing.assert_allclose(renumbered[0], v, rtol=0, atol=SAME)
    np.testing.assert_allclose(renumbered[1], renumbered[0], rtol=0, atol=SAME)
    if scheme is nts.EnergyMomentum and friction is None:
        assert abs(change) < CONSERVED


@pytest.mark.serial
@pytest.mark.parametrize("friction", [None, nts.Coulomb(0.3)])
def test_explicit_steps_depend_neither_on_numbers_nor_on_round_off(friction):
    # Nodes slide over edges in the direction of y, along which the scene is not symmetric.
    def velocities(seed):
        V, bodies, surfaces = blocks(MPI.COMM_SELF, seed)
        pair = nts.ContactPair(*surfaces, nts.Penalty(), friction, method="node-to-segment")
        return impact(V, bodies, pair, nts.CentralDifference, (0.0, 0.3, -1.0), LONG)

    v, mirrored, shared, _ = velocities(seed=0)
    assert max(shared) > 0
    np.testing.assert_allclose(mirrored, v, rtol=0, atol=SAME)
    renumbered = velocities(seed=1)
    assert renumbered[2] == shared
    np.testing.assert_allclose(renumbered[0], v, rtol=0, atol=SAME)
    np.testing.assert_allclose(renumbered[1], renumbered[0], rtol=0, atol=SAME)


@pytest.mark.serial
@pytest.mark.parametrize("law", [nts.LagrangeMultiplier(), nts.Penalty(1e4)])
def test_energy_is_conserved_where_nodes_slide_off_vertices(law):
    V, bodies, surfaces = blocks(MPI.COMM_SELF, cell="tetrahedron")
    # Facets around a vertex are in different planes, so that gaps to them differ.
    x = V.mesh.geometry.x
    top = np.isclose(x[:, 2], 0.4)
    x[top, 2] -= 0.03 * np.random.default_rng(7).uniform(size=np.count_nonzero(top))
    pair = nts.ContactPair(*surfaces, law, method="node-to-segment")
    *_, shared, change = impact(V, bodies, pair, velocity=(0.3, 0.2, -1.0), steps=16)
    assert max(shared) > 0
    assert shared[-1] == 0
    assert abs(change) < CONSERVED


@pytest.mark.serial
@pytest.mark.parametrize("friction", [None, nts.Coulomb(0.3)])
def test_nodes_above_vertices_of_a_rigid_surface_do_not_depend_on_its_numbers(friction):
    def velocities(order):
        V, bodies, (nodes, _) = blocks(MPI.COMM_SELF)
        obstacle = ridge(0.02, order)
        return impact(
            V, bodies, nts.ContactPair(nodes, obstacle, None, friction, method="node-to-segment")
        )

    (v, _, shared, change), (renumbered, *_) = (velocities(np.arange(9)[::s]) for s in (1, -1))
    assert max(shared) > 0
    np.testing.assert_allclose(renumbered, v, rtol=0, atol=SAME)
    if friction is None:
        assert abs(change) < CONSERVED


@pytest.mark.several_ranks
@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.CentralDifference])
@pytest.mark.parametrize("friction", [None, nts.Coulomb(0.3)])
def test_nodes_share_segments_of_several_ranks(comm, friction, scheme):
    def owner(midpoints):
        return (midpoints[:, 0] + midpoints[:, 2] > 0.9).astype(np.int32) % comm.size

    explicit = scheme is nts.CentralDifference
    law, steps = (nts.Penalty(), 60) if explicit else (None, 4)
    V, bodies, surfaces = blocks(comm, owner=owner)
    pair = nts.ContactPair(*surfaces, law, friction, method="node-to-segment")
    v, _, shared, change = impact(V, bodies, pair, scheme, steps=steps)
    X = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]
    every = np.vstack(comm.allgather(np.hstack((X[in_space(X)], v))))
    V, bodies, surfaces = blocks(MPI.COMM_SELF)
    pair = nts.ContactPair(*surfaces, law, friction, method="node-to-segment")
    alone, *_ = impact(V, bodies, pair, scheme, steps=steps)
    np.testing.assert_allclose(every[in_space(every[:, :3]), 3:], alone, rtol=0, atol=SAME)
    assert comm.allreduce(max(shared)) > 0
    if friction is None and not explicit:
        assert abs(change) < CONSERVED


@pytest.mark.serial
def test_explicit_steps_between_facets_of_a_rigid_surface_do_not_depend_on_its_numbers():
    def velocities(order):
        V, bodies, (nodes, _) = blocks(MPI.COMM_SELF)
        obstacle = ridge(0.02, order)
        pair = nts.ContactPair(nodes, obstacle, nts.Penalty(), method="node-to-segment")
        return impact(V, bodies, pair, nts.CentralDifference, steps=60)

    (v, _, shared, _), (renumbered, *_) = (velocities(np.arange(9)[::s]) for s in (1, -1))
    assert max(shared) > 0
    np.testing.assert_allclose(renumbered, v, rtol=0, atol=SAME)


@pytest.mark.serial
@pytest.mark.parametrize("friction", [None, nts.Coulomb(0.3)])
def test_ledger_and_momenta_of_explicit_steps_close_where_nodes_slide_over_edges(friction):
    _, bodies, surfaces = blocks(MPI.COMM_SELF)
    pair = nts.ContactPair(*surfaces, nts.Penalty(), friction, method="node-to-segment")
    stepper = nts.CentralDifference(bodies, [pair], dt=SHORT)
    stepper.set_velocity(bodies[1], (0.0, 0.3, -1.0))
    ledger = Ledger(stepper)
    before = ledger.diagnostics.balance()
    shared = []
    for _ in range(40):
        ledger.run(1)
        shared.append(np.count_nonzero(pair.history.shared))
    after = ledger.diagnostics.balance()
    assert len(set(shared)) > 1
    assert ledger.error <= CLOSED
    for name in ("linear_momentum", "angular_momentum"):
        value = getattr(before, name)
        np.testing.assert_allclose(getattr(after, name), value, rtol=0, atol=1e-10)


@pytest.mark.serial
@pytest.mark.parametrize("friction", [None, nts.Coulomb(0.3)])
def test_explicit_steps_resume_with_all_segments_of_nodes(friction):
    def stepper():
        _, bodies, surfaces = blocks(MPI.COMM_SELF)
        pair = nts.ContactPair(*surfaces, nts.Penalty(), friction, method="node-to-segment")
        stepper = nts.CentralDifference(bodies, [pair], dt=SHORT)
        stepper.set_velocity(bodies[1], (0.0, 0.3, -1.0))
        return stepper

    # After the nodes have moved along their segments.
    first, archive, resumed = stepper(), Snapshot(), stepper()
    for _ in range(4):
        first.advance()
    assert first.contacts[0].history.shared.any()
    first.serialize(archive)
    resumed.serialize(archive.rewind())
    for _ in range(10):
        reports = [each.advance() for each in (first, resumed)]
        assert reports[0].contact_work == reports[1].contact_work
    np.testing.assert_array_equal(resumed.v.x.array, first.v.x.array)


@pytest.mark.serial
def test_forces_on_segments_are_symmetric_where_nodes_share_them():
    scene = scenes.ball_plate(MPI.COMM_SELF)
    scene.run(12)
    V = scene.stepper.u.function_space
    X = V.tabulate_dof_coordinates()
    order, mirrored = in_space(X), in_space(X * [-1, 1, 1])
    force = scene.stepper.contacts[0]._forces_on_segments(lambda history: history.force)
    assert np.abs(force).max() > 1
    np.testing.assert_allclose(force[mirrored] * [-1, 1, 1], force[order], rtol=0, atol=1e-7)


@pytest.mark.serial
@pytest.mark.parametrize("friction", [None, 0.3])
@pytest.mark.parametrize("law", [None, nts.Penalty(1e5)])
def test_a_ridge_that_moves_below_nodes_has_the_forces_of_one_at_rest(law, friction):
    """The relative motion is the same; each reaction is seen from the ridge."""

    def turn(t):
        return rotation((0.0, 0.0, 1.0), 0.05 * t)

    def shift(t):
        return np.array([0.02 * t, 0.01 * t, 0.02 * t])

    def reactions(moves):
        V, bodies, (nodes, _) = blocks(MPI.COMM_SELF)
        tool = ridge(0.05)
        if moves:
            centre = (1 / 3, 1 / 3, 0.4)
            tool = tool.moving(nts.Motion(shift, lambda t: (0, 0, 0.05 * t), centre))
        X, displacement = V.tabulate_dof_coordinates(), fem.Function(V)

        def update(t):
            R, c = np.eye(3) if moves else turn(t), np.array([1 / 3, 1 / 3, 0.4])
            to = (X - c - (0 if moves else shift(t))) @ R + c
            displacement.x.array[:] = (to - X).ravel()

        held = np.concatenate([bodies[0].nodes, bodies[1].nodes[X[bodies[1].nodes, 2] > 0.79]])
        pair = nts.ContactPair(nodes, tool, law, friction, method="node-to-segment")
        bcs = [fem.dirichletbc(displacement, held.astype(np.int32))]
        stepper = nts.QuasiStatic(bodies, [pair], dt=0.25, bcs=bcs, update=update)
        steps, shared = [], 0
        for step in stepper.run(until=1.0):
            (reaction,) = step.reactions
            steps.append(np.array(reaction.force) @ (turn(step.t) if moves else np.eye(3)))
            shared += np.count_nonzero(pair.history.shared)
        return np.array(steps), shared

    (moving, shared), (at_rest, same) = reactions(True), reactions(False)
    assert shared == same > 0
    np.testing.assert_allclose(moving, at_rest, rtol=0, atol=1e-7 * np.abs(at_rest).max())
    assert np.abs(at_rest[-1, 2]) > 100  # N
