"""Surfaces of whole bodies, and the pairs of a scene."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from dolfinx import fem, mesh
from dolfinx.mesh import GhostMode

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.meshing.gmsh import read_mesh
from helpers import scenes
from helpers.models import box_meshes
from helpers.once import once

RUBBER = nts.SaintVenantKirchhoff(E=1e5, nu=0.3, rho=1e3)


def row(comm, cells=(1, 2, 3), stiffness=None, *, rigid=False):
    """Unit cubes in a row, with different numbers of cells along an edge."""

    def build(model):
        for i, n in enumerate(cells):
            box = {"corner": (1.5 * i, 0, 0), "size": (1, 1, 1), "cells": (n, n, n)}
            parts.add_box(model, f"box {i}", **box)

    mesh, tags, facets, tag = read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    if rigid:
        of_boxes = [tag[f"box {i}"] for i in range(len(cells))]
        return [nts.RigidBody(V, tags, number, rho=1e3) for number in of_boxes], facets, tag
    materials = [RUBBER] * len(cells)
    if stiffness is not None:
        materials = [nts.NeoHookean(E, 0.3, 1e3) for E in stiffness]
    bodies = [nts.Body(V, tags, tag[f"box {i}"], m) for i, m in enumerate(materials)]
    return bodies, facets, tag


def ids(surface):
    """Nodes of a surface by number in the mesh, on all ranks."""
    return np.sort(np.concatenate(surface.V.mesh.comm.allgather(surface.node_ids)))


def num_segments(surface):
    return surface.V.mesh.comm.allreduce(len(surface.segments))


def test_boundary_agrees_with_the_body_alone(comm):
    bodies, _, _ = row(comm)
    for n, body in zip((1, 2, 3), bodies, strict=True):
        surface = nts.boundary_of(body)
        assert num_segments(surface) == 6 * n**2
        assert len(ids(surface)) == (n + 1) ** 3 - max(n - 1, 0) ** 3
        assert comm.allreduce(surface.area.sum()) == pytest.approx(6)
    both = nts.boundary_of(*bodies[1:])
    assert num_segments(both) == 6 * (4 + 9)


@pytest.mark.at_most_two_ranks
def test_part_of_a_boundary_and_place_are_the_tagged_surface(comm):
    bodies, facets, tag = row(comm)
    V = bodies[0].V
    tagged = nts.Surface(V, facets, tag["box 1_top"])
    part = nts.boundary_of(bodies[1], where=lambda x: x[2] > 0.99)
    place = nts.Surface.where(V, lambda x: (x[2] > 0.99) & (abs(x[0] - 2) < 0.6))
    for surface in (part, place):
        assert np.array_equal(surface.segments, tagged.segments)
        assert np.array_equal(surface.orientation, tagged.orientation)
        assert np.array_equal(ids(surface), ids(tagged))
    # Booleans of a list; an empty one, on a rank without facets, has no kind.
    listed = nts.Surface.where(
        V, lambda x: np.array([z > 0.99 and abs(y - 2) < 0.6 for y, _, z in x.T])
    )
    assert np.array_equal(listed.segments, tagged.segments)
    everything = nts.Surface.where(V, lambda x: x[0] > -1)
    assert num_segments(everything) == 6 * (1 + 4 + 9)


@pytest.mark.parametrize(
    "where", [lambda x: x[2] - 0.1, lambda x: np.nan * x[2], lambda x: (x[2] > 0.9).astype(int)]
)
def test_a_place_that_is_no_boolean_is_refused(comm, refused, where):
    bodies, _, _ = row(comm, (1,))
    with refused(TypeError, "expected a boolean for each position x.*given (float|int)64.*isclose"):
        nts.boundary_of(bodies[0], where=where)
    with refused(TypeError, "expected a boolean for each position x"):
        nts.Surface.where(bodies[0].V, where)


@pytest.mark.parametrize("ghosts", [GhostMode.none, GhostMode.shared_facet])
def test_facets_between_bodies_that_share_nodes_are_inside(comm, ghosts):
    V, bodies = halved(comm, ghosts)
    assert [num_segments(nts.boundary_of(body)) for body in bodies] == [32 - 6, 32 - 6]
    assert num_segments(nts.boundary_of(*bodies)) == 52
    assert (
        nts.all_pairs(bodies, enforcement=nts.LagrangeMultiplier(), method="node-to-segment") == []
    )
    assert num_segments(nts.Surface.where(V, lambda x: x[2] < 1e-9)) == 12


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("ghosts", [GhostMode.none, GhostMode.shared_facet])
@pytest.mark.parametrize(
    ("second", "number"), [((4.0, 3.0, 0.0), 3), ((4.0, 3.0, 2.0), 1), ((4.0, 0.0, 0.0), 12)]
)
def test_bodies_that_share_a_few_nodes_are_named(comm, caplog, ghosts, second, number):
    """Boxes of 4 x 3 x 2 unit cells that have an edge, a corner or a face in common."""
    data = box_meshes.boxes([(4, 3, 2)] * 2, [(4.0, 3.0, 2.0)] * 2)
    X = data.X + np.where(np.arange(len(data.X)) < len(data.X) // 2, 0.0, 1.0)[:, None] * second
    X, node = np.unique(X, axis=0, return_inverse=True)
    data = replace(data, X=X, cells=node.reshape(-1)[data.cells], numbers=np.arange(len(X)))
    mesh, cells, _, _ = box_meshes.distribute(comm, data, ghosts=ghosts)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    tags = sorted(set(np.concatenate(comm.allgather(cells.values))))
    bodies = [nts.Body(V, cells, int(t), RUBBER) for t in tags]
    with caplog.at_level(logging.INFO, "dolfinx_nts"):
        assert (
            nts.all_pairs(bodies, enforcement=nts.LagrangeMultiplier(), method="node-to-segment")
            == []
        )
    a, b = (body.name for body in bodies)
    if comm.rank:
        assert not caplog.messages
    elif number == 12:
        assert caplog.messages == [f"{a}, {b} share nodes and count as one body"]
    else:
        (message,) = caplog.messages
        assert message.startswith(f"{a} and {b} share {number} nodes, but no facet: ")
        assert "without fragment" in message and f"self_contact=[{a}]" in message


def halved(comm, ghosts):
    """Box of 4 x 3 x 2 cells of two materials that share nodes."""
    data = box_meshes.boxes([(4, 3, 2)], [(4.0, 3.0, 2.0)])
    middle = data.X[data.cells].mean(axis=1)
    data.body[:] = middle[:, 0] > 2
    mesh, cells, _, _ = box_meshes.distribute(comm, data, ghosts=ghosts)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    tags = sorted(set(np.concatenate(comm.allgather(cells.values))))
    return V, [nts.Body(V, cells, int(t), RUBBER) for t in tags]


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("count", [*map(once, [1, 2, 3, 5]), 6])
def test_any_two_bodies_meet_in_one_pair_finer_nodes_against_coarser_segments(comm, count):
    cells = (1, 3, 2, 2, 1, 4)[:count]
    bodies, _, _ = row(comm, cells)
    pairs = nts.all_pairs(bodies, enforcement=nts.LagrangeMultiplier(), method="node-to-segment")
    assert len(pairs) == count - 1
    surfaces = [set(ids(nts.boundary_of(body))) for body in bodies]
    met = np.zeros((count, count), dtype=int)
    for pair in pairs:
        nodes, segments = set(ids(pair.nodes)), set(ids(pair.segments))
        of_nodes = [i for i, s in enumerate(surfaces) if s <= nodes]
        of_segments = [i for i, s in enumerate(surfaces) if s <= segments]
        assert min(cells[i] for i in of_nodes) >= max(cells[i] for i in of_segments)
        for i in of_nodes:
            for j in of_segments:
                met[i, j] += 1
                met[j, i] += 1
    assert np.array_equal(met, 1 - np.eye(count, dtype=int))


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("cells", "stiffness", "first_gives_nodes"),
    [
        ((2, 2), (1e5, 1e7), True),
        once((2, 2), (1e7, 1e5), False),
        once((2, 3), (1e5, 1e7), True),  # a little finer does not count
        once((1, 4), (1e5, 1e7), False),  # much finer does
        once((1, 2), (1e5, 1e13), False),  # and however stiff it is
        once((3, 3), (0.0, 1e5), True),
    ],
)
def test_the_softer_of_similar_meshes_gives_the_nodes(comm, cells, stiffness, first_gives_nodes):
    bodies, _, _ = row(comm, cells, [max(E, 1e-6) for E in stiffness])
    (pair,) = nts.all_pairs(bodies, enforcement=nts.LagrangeMultiplier(), method="node-to-segment")
    expected = bodies[0 if first_gives_nodes else 1]
    assert np.array_equal(ids(pair.nodes), ids(nts.boundary_of(expected)))


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("stiff", [None, 1e9], ids=["rigid", "stiff"])
@pytest.mark.parametrize("pad_faces_the_other", [True, False])
def test_only_facing_bodies_of_connected_ones_determine_roles(comm, stiff, pad_faces_the_other):
    """A fine block, half of it a soft pad, faces a coarser block by its pad or its core."""
    first, _, _ = row(comm, (4, 3))
    V = first[0].V
    cells = V.mesh.topology.index_map(3)
    every = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    mid = mesh.compute_midpoints(V.mesh, 3, every)
    near = (mid[:, 0] > 0.5) & (mid[:, 0] < 1.2)
    values = np.where(mid[:, 0] > 1.2, 3, np.where(near == pad_faces_the_other, 1, 2))
    tags = mesh.meshtags(V.mesh, 3, every, values.astype(np.int32))
    if stiff is None:
        core = nts.RigidBody(V, tags, 2, rho=1e3)
    else:
        core = nts.Body(V, tags, 2, nts.NeoHookean(stiff, 0.3, 1e3))
    pad, other = nts.Body(V, tags, 1, RUBBER), nts.Body(V, tags, 3, RUBBER)
    expected = (pad, core) if pad_faces_the_other else (other,)
    for bodies in ([pad, core, other], [core, pad, other]):
        (pair,) = nts.all_pairs(bodies)
        assert np.array_equal(ids(pair.nodes), ids(nts.boundary_of(*expected)))
        has_rigid_nodes = stiff is None and pad_faces_the_other
        assert pair.method == ("node-to-segment" if has_rigid_nodes else "mortar")
        assert nts.EnergyMomentum(bodies, [pair], dt=0.1).pairs[0].method == pair.method


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("cells", [(1, 3), (3, 1), once((2, 1, 4)), once((2, 2))])
def test_the_finer_of_rigid_bodies_gives_the_nodes_in_node_to_segment_contact(comm, cells):
    bodies, _, _ = row(comm, cells, rigid=True)
    pairs = nts.all_pairs(bodies)
    ordered = sorted(zip(cells, bodies, strict=True), key=lambda each: -each[0])
    finest, *coarser = [body for _, body in ordered]
    assert np.array_equal(ids(pairs[0].nodes), ids(nts.boundary_of(finest)))
    assert np.array_equal(ids(pairs[0].segments), ids(nts.boundary_of(*coarser)))
    assert np.array_equal(ids(pairs[-1].segments), ids(nts.boundary_of(coarser[-1])))
    used = nts.EnergyMomentum(bodies, pairs, dt=0.1).pairs
    assert [pair.method for pair in pairs] == ["node-to-segment"] * (len(cells) - 1)
    assert [pair.method for pair in used] == [pair.method for pair in pairs]


@pytest.mark.at_most_two_ranks
def test_pairs_with_obstacles_have_the_laws_and_are_logged(comm, caplog):
    bodies, _, _ = row(comm)
    plane, friction = nts.RigidPlane((0, 0, -1), (0, 0, 1)), nts.Coulomb(0.3)
    penalty = nts.Penalty()
    with caplog.at_level(logging.INFO, "dolfinx_nts"):
        pairs = nts.all_pairs(
            bodies,
            obstacles=[plane],
            enforcement=penalty,
            friction=friction,
            method="node-to-segment",
        )
    assert all(p.enforcement is penalty and p.friction is friction for p in pairs)
    assert pairs[-1].segments is plane
    assert len(ids(pairs[-1].nodes)) == 8 + 26 + 56
    expected = [
        "pair 1: nodes of box 2 against the segments of box 0, box 1",
        "pair 2: nodes of box 1 against the segments of box 0",
        "pair 3: nodes of all bodies against RigidPlane",
    ]
    assert caplog.messages == (expected if comm.rank == 0 else [])


@pytest.mark.at_most_two_ranks
def test_bodies_that_may_touch_themselves_get_a_pair_with_their_own_boundary(comm, caplog):
    bodies, _, _ = row(comm)
    with caplog.at_level(logging.INFO, "dolfinx_nts"):
        *others, own = nts.all_pairs(
            bodies,
            self_contact=[bodies[1]],
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
    assert [pair.touches_itself for pair in others] == [False, False]
    assert own.touches_itself
    assert np.array_equal(ids(own.nodes), ids(nts.boundary_of(bodies[1])))
    expected = "pair 3: nodes of box 1 against their own segments"
    assert caplog.messages[2:] == ([expected] if comm.rank == 0 else [])
    (own,) = nts.all_pairs(
        bodies[:1],
        self_contact=bodies[:1],
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    assert own.touches_itself


@pytest.mark.at_most_two_ranks
def test_smooth_segments_are_those_between_bodies_whose_faces_meet(comm, caplog):
    bodies, _, _ = row(comm, (1, 2))
    plane = nts.RigidPlane((0, 0, -1), (0, 0, 1))
    with caplog.at_level(logging.INFO, "dolfinx_nts"):
        pairs = nts.all_pairs(
            bodies,
            obstacles=[plane],
            self_contact=bodies[:1],
            edges=True,
            smooth=True,
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
    kinds = [(pair.method, getattr(pair.segments, "smooth", False)) for pair in pairs]
    faces, edges = "node-to-segment", "edge-to-edge"
    assert kinds == [(faces, True), (edges, False), (faces, False), (faces, False)]
    nts.EnergyMomentum(bodies, pairs, dt=0.01)
    expected = "pair 1: nodes of box 1 against the smooth segments of box 0"
    assert caplog.messages[:1] == ([expected] if comm.rank == 0 else [])
    (pair,) = nts.all_pairs(
        bodies, method="mortar", smooth=True, enforcement=nts.LagrangeMultiplier()
    )
    assert isinstance(pair.segments, nts.Surface) and pair.segments.smooth and pair.nodes.smooth


def test_bodies_that_share_nodes_touch_each_other_as_one(comm):
    _, bodies = halved(comm, GhostMode.none)
    (own,) = nts.all_pairs(
        bodies,
        self_contact=[bodies[1]],
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    assert np.array_equal(ids(own.nodes), ids(nts.boundary_of(*bodies)))


def meeting(comm, order, **laws):
    """Two blocks that strike each other, both with contact nodes."""
    first = scenes.blocks(comm)
    bodies, (pair,) = first.stepper.bodies, first.stepper.pairs
    pairs = nts.two_half_passes(*(pair.nodes, pair.segments)[::order], **laws)
    stepper = nts.EnergyMomentum(bodies, pairs, dt=first.stepper.dt)
    stepper.v.x.array[:] = first.stepper.v.x.array
    return stepper


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("friction", [once(None, id="smooth"), nts.Coulomb(0.3)])
def test_two_half_passes_keep_energy_and_momenta_and_prefer_no_side(comm, friction):
    found = []
    for order in (1, -1):
        # So stiff that no penetrating node slides over a free edge.
        stepper = meeting(comm, order, enforcement=nts.Penalty(5e3), friction=friction)
        diagnostics = nts.Diagnostics(stepper)
        before, dissipated, most = diagnostics.balance(), 0.0, np.zeros(2)
        for _ in range(12):
            stepper.advance()
            dissipated += sum(comm.allreduce(p.history.dissipation.sum()) for p in stepper.pairs)
            active = [comm.allreduce(int(p.history.active.sum())) for p in stepper.pairs]
            most = np.maximum(most, active)
        after = diagnostics.balance()
        assert most.min() > 0
        assert after.total_energy + dissipated == pytest.approx(before.total_energy, rel=1e-11)
        for name in ("linear_momentum", "angular_momentum"):
            first, last = getattr(before, name), getattr(after, name)
            assert np.abs(last - first).max() < 1e-11 * np.abs(first).max(), name
        found.append(stepper.u.x.array.copy())
    assert np.abs(found[1] - found[0]).max() < 1e-11


@pytest.mark.at_most_two_ranks
def test_half_passes_share_the_stiffness_of_the_springs(comm):
    for given in (None, 5e3):
        halves = meeting(comm, 1, enforcement=nts.Penalty(given), friction=nts.Coulomb(0.3))
        whole = scenes.blocks(comm).stepper
        (pair,) = whole.pairs
        pair = nts.ContactPair(
            pair.nodes,
            pair.segments,
            nts.Penalty(given),
            nts.Coulomb(0.3),
            method="node-to-segment",
        )
        whole = nts.EnergyMomentum(whole.bodies, [pair], dt=whole.dt)
        halves.advance()
        whole.advance()
        assert np.allclose(halves.contacts[0].eps_N, whole.contacts[0].eps_N / 2)
        assert np.allclose(halves.contacts[0].eps_T, whole.contacts[0].eps_T / 2)


@pytest.mark.at_most_two_ranks
def test_stack_of_three_falls_and_keeps_its_balances(comm):
    bodies, _, _ = row(comm, (2, 2, 2))
    stepper = nts.EnergyMomentum(
        bodies,
        nts.all_pairs(bodies, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"),
        dt=0.01,
    )
    stepper.set_velocity(bodies[0], (10, 0, 0))
    stepper.set_velocity(bodies[2], (-10, 0, 0))
    before = nts.Diagnostics(stepper).balance()
    active = [report.num_active for report in stepper.run(0.12)]
    after = nts.Diagnostics(stepper).balance()
    assert max(active) == 18
    assert after.total_energy == pytest.approx(before.total_energy, rel=1e-10)
    scale = 1e4
    assert np.allclose(after.linear_momentum, 0, atol=1e-10 * scale)


@pytest.mark.at_most_two_ranks
def test_invalid_surfaces_and_pairs_are_refused(comm, refused):
    bodies, facets, _ = row(comm)
    other, _, _ = row(comm)
    with refused(ValueError, "at least one body, given none"):
        nts.boundary_of()
    with refused(ValueError, "at least one body, given none"):
        nts.all_pairs([], enforcement=nts.LagrangeMultiplier(), method="node-to-segment")
    with refused(TypeError, "expected a Body, given MeshTags"):
        nts.boundary_of(facets)
    with refused(ValueError, "one function space, given several"):
        nts.all_pairs(
            [bodies[0], other[1]], enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        )
    with refused(ValueError, "facets of the boundary, given none"):
        nts.boundary_of(bodies[0], where=lambda x: x[2] > 2)
    with refused(ValueError, "facets of the boundary, given none"):
        nts.Surface.where(bodies[0].V, lambda x: x[2] > 2)
    with refused(ValueError, "bodies of the scene as self_contact, given 1 other bodies"):
        nts.all_pairs(
            bodies[:2],
            self_contact=bodies[2:],
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
    sides = [nts.boundary_of(body) for body in bodies[:2]]
    with refused(TypeError, "both sides as contact nodes, given LagrangeMultiplier"):
        nts.two_half_passes(*sides, nts.LagrangeMultiplier())
    with refused(TypeError, "expected an Obstacle, given Body"):
        nts.all_pairs(
            bodies,
            obstacles=[bodies[0]],
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
