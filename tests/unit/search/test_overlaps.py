"""Overlaps of bodies against closed forms and against cells that contain points."""

from functools import partial

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import meshtags

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.search.overlap.overlaps import OverlapSearch
from helpers.once import once
from reference.bulk import rotation

RUBBER = nts.NeoHookean(E=1e5, nu=0.3, rho=1e3)
cells_ = pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
ROUNDING = 1e-12
# Six tetrahedra of a hexahedron in Basix order.
TETRAHEDRA = [(0, *middle, 7) for middle in ((1, 3), (1, 5), (4, 5), (2, 3), (2, 6), (4, 6))]


def box(corner, size, cells):
    return partial(parts.add_box, corner=corner, size=size, cells=cells)


def bodies_of(comm, *fill, cell="hexahedron", degree=1):
    """Bodies of a mesh of several parts."""

    def build(model):
        for number, add in enumerate(fill, start=1):
            add(model, f"body {number}", cell=cell)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    return [nts.Body(V, cells, tag[f"body {number}"], RUBBER) for number in range(1, len(fill) + 1)]


def overlaps(bodies, x=None, obstacles=()):
    x = bodies[0].V.tabulate_dof_coordinates() if x is None else x
    return OverlapSearch(bodies, obstacles).find(x)[0]


LOWER, UPPER = box((0, 0, 0), (1, 1, 1), (4, 4, 4)), box((0.2, 0.3, 0.9), (0.4, 0.4, 1), (2, 2, 5))


def turned(bodies, down):
    """Positions with the second body moved down, all of them turned and shifted."""
    x, Q = bodies[0].V.tabulate_dof_coordinates().copy(), rotation(np.array([1.0, 0.4, -2.0]), 0.8)
    x[bodies[1].nodes] -= [0.0, 0.0, down]
    return x @ Q.T + [3.0, 1.0, -2.0]


@pytest.mark.parametrize(
    # All pairs of the three parameters, in both orders.
    ("cell", "degree", "down"),
    [
        ("hexahedron", 1, 0.0),
        ("tetrahedron", 2, 0.0),
        ("hexahedron", 2, 0.03),
        ("tetrahedron", 1, 0.03),
    ],
)
def test_two_boxes_are_as_deep_in_each_other_as_they_were_pushed(comm, cell, degree, down):
    bodies = bodies_of(comm, LOWER, UPPER, cell=cell, degree=degree)
    (overlap,) = overlaps(bodies, turned(bodies, down))
    assert overlap.names == ("body 2", "body 1")
    np.testing.assert_allclose(overlap.depth, 0.1 + down, rtol=ROUNDING)


@pytest.mark.parametrize(("down", "cells"), [(0.0, 0), (0.03, 4 + 2)])
def test_nodes_and_centres_of_cells_inside_are_counted_once(comm, down, cells):
    bodies = bodies_of(comm, LOWER, UPPER)
    (overlap,) = overlaps(bodies, turned(bodies, down))
    # Nine nodes at the bottom of the upper body, and two on top of the lower one.
    assert (overlap.nodes, overlap.cells) == (9 + 2, cells)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("gap", [0.0, *map(once, [1e-9, 0.01, 3.0])])
def test_bodies_that_touch_or_are_apart_do_not_overlap(comm, gap):
    upper = box((0.0, 0.0, 1.0 + gap), (1, 1, 1), (3, 3, 3))
    bodies = bodies_of(comm, box((0, 0, 0), (1, 1, 1), (3, 3, 3)), upper)
    found, apart = OverlapSearch(bodies, []).find(bodies[0].V.tabulate_dof_coordinates())
    assert found == []
    np.testing.assert_allclose(apart, [[np.inf, gap], [gap, np.inf]], atol=ROUNDING)


def test_bodies_that_move_alike_come_no_nearer_to_each_other(comm):
    bodies = bodies_of(comm, LOWER, UPPER)
    rising = nts.Motion(lambda t: (0.0, 0.0, 3.0 * t))
    search = OverlapSearch(bodies, [nts.RigidPlane((0, 0, -1), (0, 0, 1)).moving(rising)])
    x = bodies[0].V.tabulate_dof_coordinates()
    search.find(x)
    travel = np.array([0.3, 0.0, -0.4])
    alike, alone = x + travel, x.copy()
    alone[bodies[1].nodes] += travel
    own = np.hypot(0.3, 0.7)  # with regard to the floor
    np.testing.assert_allclose(
        search.approach(alike, 0.1, x, 0.0), np.diag([own, own]), atol=ROUNDING
    )
    np.testing.assert_allclose(search.approach(alone, 0.1, x, 0.0), [[0.3, 0.5], [0.5, own]])


@pytest.mark.at_most_two_ranks
@cells_
def test_a_ball_in_a_box_is_deep_as_its_deepest_node(comm, cell):
    ball = partial(
        parts.add_solid_ball, centre=(0.1, 0.0, 0.05), radius=0.25, cells_per_edge=2, layers=1
    )
    bodies = bodies_of(comm, box((-1, -1, -1), (2, 2, 2), (3, 3, 3)), ball, cell=cell)
    (overlap,) = overlaps(bodies)
    X, n = bodies[0].V.tabulate_dof_coordinates(), bodies[0].V.dofmap.index_map.size_local
    own = bodies[1].nodes[bodies[1].nodes < n]
    outer = own[np.linalg.norm(X[own] - [0.1, 0, 0.05], axis=1) > 0.25 - ROUNDING]
    deepest = comm.allreduce(float((1 - np.abs(X[outer])).min(axis=1).max(initial=0)), MPI.MAX)
    assert overlap.names == ("body 2", "body 1")
    np.testing.assert_allclose(overlap.depth, deepest, rtol=ROUNDING)
    assert overlap.nodes == comm.allreduce(len(outer))
    assert overlap.cells >= comm.allreduce(len(bodies[1].cells))


@pytest.mark.at_most_two_ranks
def test_a_body_in_the_hollow_of_a_bent_one_does_not_overlap(comm):
    bar = box((0, 0, 0), (4.5, 1, 0.2), (24, 2, 2))
    bodies = bodies_of(comm, bar, box((-0.2, 0.3, -0.2), (0.4, 0.4, 0.4), (2, 2, 2)))
    x = bodies[0].V.tabulate_dof_coordinates().copy()
    # A bar bent to three quarters of a circle around the small body.
    s, y, z = x[bodies[0].nodes].T
    x[bodies[0].nodes] = np.column_stack([(1 - z) * np.cos(s), y, (1 - z) * np.sin(s)])
    search = OverlapSearch(bodies, [])
    found, apart = search.find(x)
    assert found == []
    assert apart.min() == 0.0  # the boxes around them overlap
    x[bodies[1].nodes] += [-0.75, 0.0, 0.0]
    (overlap,), _ = search.find(x)
    # Depth of the inner side of the bar below the outer side of the small body.
    np.testing.assert_allclose(overlap.depth, 0.95 - 0.8, rtol=0.01)


@pytest.mark.at_most_two_ranks
def test_a_thin_body_through_another_is_found_by_its_edges(comm):
    plate = box((0, 0, 0), (1, 1, 0.1), (1, 1, 1))
    bodies = bodies_of(comm, plate, box((0.2, 0.2, -0.7), (0.2, 0.2, 2), (1, 1, 1)))
    (overlap,) = overlaps(bodies)
    assert overlap.names == ("body 2", "body 1")
    assert overlap.nodes == overlap.cells == 0
    np.testing.assert_allclose(overlap.depth, 0.05, rtol=ROUNDING)


@pytest.mark.at_most_two_ranks
def test_bodies_that_share_nodes_count_as_one(comm):
    bodies = bodies_of(comm, LOWER, UPPER)
    V = bodies[0].V
    mesh = V.mesh
    num_cells = mesh.topology.index_map(3).size_local + mesh.topology.index_map(3).num_ghosts
    tags = np.zeros(num_cells, dtype=np.int32)
    for tag, body in enumerate(bodies, start=1):
        tags[np.isin(V.dofmap.list[:, 0], body.nodes)] = tag
    centres = V.tabulate_dof_coordinates()[V.dofmap.list].mean(axis=1)
    tags[(tags == 1) & (centres[:, 0] > 0.5)] = 3
    three = meshtags(mesh, 3, np.arange(num_cells, dtype=np.int32), tags)
    (overlap,) = overlaps([nts.Body(V, three, tag, RUBBER) for tag in (1, 2, 3)])
    assert overlap.names == ("body 2", "body 1 and body 3")
    (as_two,) = overlaps(bodies)
    assert (overlap.depth, overlap.nodes) == (as_two.depth, as_two.nodes)


@pytest.mark.at_most_two_ranks
def test_flush_sides_neither_hide_an_overlap_nor_make_one(comm):
    neighbour = box((1, 0, 0), (1, 1, 1), (3, 3, 3))
    upper = box((0, 0, 0.99), (1, 1, 1), (3, 3, 3))
    (overlap,) = overlaps(bodies_of(comm, box((0, 0, 0), (1, 1, 1), (3, 3, 3)), upper, neighbour))
    assert set(overlap.names) == {"body 1", "body 2"}
    np.testing.assert_allclose(overlap.depth, 0.01, rtol=1e-10)
    assert (overlap.nodes, overlap.cells) == (8, 0)


def contains(points, x, cells):
    """Whether points are in tetrahedra, given by positions and vertices."""
    p = x[cells]
    edges = np.moveaxis(p[:, 1:] - p[:, :1], 1, 2)
    inverse = np.linalg.inv(edges)
    inside = np.zeros(len(points), dtype=bool)
    for origin, matrix in zip(p[:, 0], inverse, strict=True):
        s = (points - origin) @ matrix.T
        inside |= (s > 0).all(axis=1) & (s.sum(axis=1) < 1)
    return inside


@pytest.mark.serial
@pytest.mark.parametrize("seed", range(3))
@cells_
def test_nodes_and_cells_inside_are_in_cells_of_the_other(comm, cell, seed):
    rng = np.random.default_rng(seed)
    bodies = bodies_of(
        comm,
        box((0, 0, 0), (1, 1, 1), (3, 3, 3)),
        box((0.4, 0.3, 0.5), (1, 0.8, 0.9), (4, 3, 3)),
        box((-0.3, 0.5, -0.2), (0.9, 0.6, 0.6), (3, 2, 2)),
        cell=cell,
    )
    V = bodies[0].V
    x = V.tabulate_dof_coordinates().copy()
    for body in bodies:
        x[body.nodes] = x[body.nodes] @ (np.eye(3) + rng.uniform(-0.25, 0.25, (3, 3)))
        if cell == "tetrahedron":  # whose faces stay plane
            x[body.nodes] += rng.uniform(-0.03, 0.03, (len(body.nodes), 3))
    counted = {}
    for i, one in enumerate(bodies):
        for j, other in enumerate(bodies):
            cells = V.dofmap.list[other.cells]
            if cell == "hexahedron":
                cells = np.concatenate([cells[:, t] for t in TETRAHEDRA])
            tops = surface_nodes(one)
            at_nodes = contains(x[tops], x, cells)
            centres = contains(x[V.dofmap.list[one.cells]].mean(axis=1), x, cells)
            if i != j and (at_nodes.any() or centres.any()):
                key = frozenset((f"body {i + 1}", f"body {j + 1}"))
                counts = np.array([at_nodes.sum(), centres.sum()])
                counted[key] = counted.get(key, 0) + counts
    found = {frozenset(o.names): [o.nodes, o.cells] for o in overlaps(bodies, x) if o.nodes}
    assert counted
    assert {key: list(values) for key, values in counted.items()} == found


def surface_nodes(body):
    """Nodes on the boundary of a body."""
    return nts.boundary_of(body).nodes


@pytest.mark.at_most_two_ranks
def test_depth_in_obstacles_is_the_negative_gap(comm):
    bodies = bodies_of(comm, LOWER, box((3, 0, 0), (1, 1, 1), (2, 2, 2)))
    floor = nts.RigidPlane((0, 0, 0.3), (0, 0, 1))
    ball = nts.RigidSphere((3.5, 0.5, 1.2), 0.3)
    again = nts.RigidPlane((0, 0, -1), (0, 0, 1))
    points = np.array([[-9.0, -9, 0.1], [9, -9, 0.1], [-9, 9, 0.1], [9, 9, 0.1]])
    facets = nts.RigidSurface(points, [[0, 1, 2, 3]], outside=(0, 0, 9))
    found = overlaps(bodies, obstacles=[floor, ball, again, facets])
    by_names = {o.names: (round(o.depth, 12), o.nodes) for o in found}
    assert by_names == {
        ("body 1", "RigidPlane 1"): (0.3, 25 + 16),
        ("body 2", "RigidPlane 1"): (0.3, 9),
        ("body 2", "RigidSphere"): (0.1, 1),
        ("body 1", "RigidSurface"): (0.1, 25),
        ("body 2", "RigidSurface"): (0.1, 9),
    }


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("depth", [-0.05, 0.05, 0.3])
def test_a_vertex_of_a_moving_obstacle_between_nodes_is_inside(comm, depth):
    """A tip above the middle of a facet of 0.25 m, which turned by a right angle about y."""
    bodies = bodies_of(comm, LOWER, box((3, 0, 0), (1, 1, 1), (2, 2, 2)))
    width, height = 0.1, 0.4
    corners = [[0, 0, 0], *([height, y, z] for y, z in ((1, 1), (-1, 1), (-1, -1), (1, -1)))]
    points = np.array(corners, dtype=float) * [1, width, width]
    sides = [[0, i, i % 4 + 1] for i in range(1, 5)]
    outside = 2 * points[np.array(sides)].mean(axis=1) - [height / 2, 0, 0]
    top = bodies[0].V.tabulate_dof_coordinates()[bodies[0].nodes, 2].max(initial=-np.inf)
    top = comm.allreduce(top, op=MPI.MAX)
    motion = nts.Motion(
        translation=lambda t: (0.375, 0.375, top - depth * t),
        rotation=lambda t: (0, -np.pi / 2 * t, 0),
    )
    tip = nts.RigidSurface(points, sides, outside).moving(motion)
    search = OverlapSearch(bodies, [tip])
    x = bodies[0].V.tabulate_dof_coordinates()
    found, _ = search.find(x, 0.0, 1.0)
    if depth < 0:
        assert not found
    else:
        (overlap,) = found
        assert overlap.names == ("RigidSurface", "body 1")
        assert overlap.depth == pytest.approx(min(depth, 0.375), abs=1e-12)
        assert overlap.nodes == 1
