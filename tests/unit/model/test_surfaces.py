"""Surfaces: nodes, oriented segments, areas and numbers."""

from dataclasses import replace

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import GhostMode, meshtags

import dolfinx_nts as nts
from dolfinx_nts.meshing.gmsh import read_mesh
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.model.surfaces import sharpest_corner
from helpers import scenes
from helpers.models import box_meshes
from helpers.models.boxed import Box
from helpers.scene import input_ids

# Round-off of sums over some hundred facets of lengths of about one.
ROUNDING = 1e3 * np.finfo(float).eps

cells_ = pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
ghosts_ = pytest.mark.parametrize("ghosts", [GhostMode.none, GhostMode.shared_facet])


def space(mesh, degree=1):
    return fem.functionspace(mesh, ("Lagrange", degree, (3,)))


def box_top(comm, cell, ghosts=GhostMode.none, **kwargs):
    """Top of a box of 3 x 4 x 2 hexahedra, size 1.2 x 1.0 x 0.5."""
    data = box_meshes.boxes([(3, 4, 2)], [(1.2, 1.0, 0.5)], cell)
    mesh, _, facets, tag = box_meshes.distribute(comm, data, ghosts=ghosts, **kwargs)
    return nts.Surface(space(mesh), facets, tag["top 0"]), data


def everywhere(surface, values):
    """Concatenated values of all ranks."""
    return np.concatenate(surface.V.mesh.comm.allgather(np.asarray(values)))


@cells_
@ghosts_
def test_nodes_and_segments_are_complete_and_counted_once(comm, cell, ghosts):
    surface, data = box_top(comm, cell, ghosts)
    nodes = everywhere(surface, surface.node_ids)
    np.testing.assert_array_equal(np.sort(nodes), np.sort(data.surfaces["top 0"]))
    owned = surface.V.dofmap.index_map.size_local
    assert comm.allreduce(np.count_nonzero(surface.nodes >= owned)) == 0
    assert comm.allreduce(np.count_nonzero(np.diff(surface.nodes) <= 0)) == 0
    ids = input_ids(surface.V)[surface.segments]
    ids = np.unique(np.sort(everywhere(surface, ids), axis=1), axis=0)
    number = 24 if cell == "tetrahedron" else 12
    assert len(ids) == number == comm.allreduce(len(surface.segments))
    assert np.isin(ids, data.surfaces["top 0"]).all()


@cells_
@ghosts_
def test_facets_of_degree_2_are_four_segments_on_all_their_nodes(comm, cell, ghosts):
    data = box_meshes.boxes([(3, 4, 2)], [(1.2, 1.0, 0.5)], cell)
    mesh, _, facets, tag = box_meshes.distribute(comm, data, ghosts=ghosts)
    surface = nts.Surface(space(mesh, 2), facets, tag["top 0"])
    # Nodes on a grid of half the width, diagonals of facets included.
    nodes = everywhere(surface, surface.V.tabulate_dof_coordinates()[surface.nodes])
    grid = np.unique((nodes / [0.2, 0.125, 0.5]).round(6), axis=0)
    assert len(nodes) == len(grid) == 7 * 9
    assert np.all(grid[:, 2] == 1) and np.all(grid == grid.round())
    number = 4 * (24 if cell == "tetrahedron" else 12)
    assert comm.allreduce(len(surface.segments)) == number
    assert sorted(everywhere(surface, surface.key)) == list(range(number))
    x = surface.V.tabulate_dof_coordinates()[surface.segments]
    sides = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    area = np.linalg.norm(np.cross(*sides), axis=1) / (2 if cell == "tetrahedron" else 1)
    np.testing.assert_allclose(area, 1.2 / number, rtol=ROUNDING)
    np.testing.assert_allclose(surface.size, np.hypot(0.2, 0.125), rtol=ROUNDING)
    assert sharpest_corner(surface) > 0.5


def test_ball_has_the_nodes_and_segments_of_its_outside(comm):
    mesh, _, facets, tag = read_mesh(scenes.BALL_PLATE, comm)
    V = space(mesh)
    ball, plate = (nts.Surface(V, facets, tag[n]) for n in ("ball_outer", "plate_top"))
    counts = [comm.allreduce(len(a)) for s in (ball, plate) for a in (s.nodes, s.segments)]
    assert counts == [218, 216, 121, 100]
    # Longest diagonal of a facet: 0.4 sqrt(2) on the plate.
    np.testing.assert_allclose(plate.size, 0.4 * np.sqrt(2), rtol=ROUNDING)


@pytest.mark.at_most_two_ranks
def test_normals_of_the_ball_point_away_from_its_centre(comm):
    mesh, _, facets, tag = read_mesh(scenes.BALL_PLATE, comm)
    V = space(mesh)
    wrong = 0
    for name, sign in (("ball_outer", 1), ("ball_inner", -1)):
        surface = nts.Surface(V, facets, tag[name])
        x = V.tabulate_dof_coordinates()[surface.segments]
        normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) * surface.orientation[:, None]
        away = sign * np.einsum("ij,ij->i", normal, x.mean(axis=1) - [0, -0.5, 1.05])
        wrong += np.count_nonzero(away <= 0)
    assert comm.allreduce(wrong) == 0


@pytest.mark.parametrize(
    # All pairs of the three parameters, in both orders.
    ("cell", "ghosts", "degree"),
    [
        ("hexahedron", GhostMode.none, 1),
        ("tetrahedron", GhostMode.shared_facet, 1),
        ("hexahedron", GhostMode.shared_facet, 2),
        ("tetrahedron", GhostMode.none, 2),
    ],
)
def test_normals_of_a_renumbered_mesh_point_out_of_the_box(comm, cell, ghosts, degree, rng):
    # Renumbered cells are mirrored too, so that both orientations occur.
    data = box_meshes.boxes([(3, 4, 2)], [(1.2, 1.0, 0.5)], cell).permuted(rng)
    mesh, _, facets, tag = box_meshes.distribute(comm, data, ghosts=ghosts)
    V = space(mesh, degree)
    found = []
    for name, sign in (("top 0", 1), ("bottom 0", -1)):
        surface = nts.Surface(V, facets, tag[name])
        x = V.tabulate_dof_coordinates()[surface.segments]
        normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        found.append(everywhere(surface, np.sign(normal[:, 2]) * surface.orientation) * sign)
        assert set(everywhere(surface, surface.orientation)) == {-1.0, 1.0}
    assert np.all(np.concatenate(found) == 1)


@ghosts_
def test_vertices_of_quadrilaterals_are_in_tensor_order(comm, ghosts, rng):
    # x0 + x3 = x1 + x2 on a parallelogram, in no other order.
    data = box_meshes.boxes([(3, 4, 2)], [(1.2, 1.0, 0.5)]).permuted(rng)
    mesh, _, facets, tag = box_meshes.distribute(comm, data, ghosts=ghosts)
    surface = nts.Surface(space(mesh), facets, tag["top 0"])
    x = surface.V.tabulate_dof_coordinates()[surface.segments]
    defect = np.abs(x[:, 0] + x[:, 3] - x[:, 1] - x[:, 2]).max(initial=0)
    assert comm.allreduce(defect) <= ROUNDING


@cells_
@ghosts_
def test_areas_of_the_nodes_sum_to_the_area_of_the_surface(comm, cell, ghosts):
    surface, _ = box_top(comm, cell, ghosts)
    area = everywhere(surface, surface.area)
    np.testing.assert_allclose(area.sum(), 1.2 * 1.0, rtol=ROUNDING)
    if cell == "hexahedron":  # quarters of 0.4 x 0.25: corners 1, edges 2, inside 4
        parts = np.unique((area / (0.4 * 0.25 / 4)).round(9), return_counts=True)
        np.testing.assert_array_equal(parts, [[1, 2, 4], [4, 10, 6]])


@pytest.mark.at_most_two_ranks
def test_each_tag_has_its_own_area(comm):
    data = box_meshes.boxes([(3, 4, 2)], [(1.2, 1.0, 0.5)])
    mesh, _, facets, tag = box_meshes.distribute(comm, data)
    for name, area in (("top 0", 1.2), ("bottom 0", 1.2)):
        surface = nts.Surface(space(mesh), facets, tag[name])
        assert everywhere(surface, surface.area).sum() == pytest.approx(area, rel=1e-12)


@pytest.mark.at_most_two_ranks
def test_area_of_the_ball_agrees_with_its_facets(comm):
    # Bilinear facets, |a1 x a2| integrated by a much higher rule.
    mesh, _, facets, tag = read_mesh(scenes.BALL_PLATE, comm)
    surface = nts.Surface(space(mesh), facets, tag["ball_outer"])
    x = surface.V.tabulate_dof_coordinates()[surface.segments]
    points, weights = np.polynomial.legendre.leggauss(8)
    expected = 0.0
    for r, wr in zip((1 + points) / 2, weights / 2, strict=True):
        for s, ws in zip((1 + points) / 2, weights / 2, strict=True):
            dphi = [[s - 1, 1 - s, -s, s], [r - 1, -r, 1 - r, r]]
            a, b = np.einsum("ak,nkc->anc", dphi, x)
            expected += wr * ws * np.linalg.norm(np.cross(a, b), axis=1).sum()
    expected, area = (comm.allreduce(v) for v in (expected, surface.area.sum()))
    # Quadrature of a root; facets of the sphere are nearly flat.
    np.testing.assert_allclose(area, expected, rtol=1e-6)


@pytest.mark.at_most_two_ranks
@cells_
def test_vectors_of_a_closed_surface_sum_to_zero_and_are_as_long_as_it_is_large(comm, cell):
    data = box_meshes.boxes([(4, 3, 2)], [(2.0, 1.5, 0.5)], cell)
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = space(mesh)
    rubber = nts.SaintVenantKirchhoff(E=1.0, nu=0.3, rho=1.0)
    surface = nts.boundary_of(nts.Body(V, cells, tag["body 0"], rubber))
    x = V.tabulate_dof_coordinates()[surface.segments]
    vectors = area_vectors(x, surface.orientation)
    outward = x.mean(axis=1) - [1.0, 0.75, 0.25]
    assert comm.allreduce(int(np.count_nonzero(np.sum(vectors * outward, axis=1) <= 0))) == 0
    assert np.allclose(comm.allreduce(vectors.sum(axis=0)), 0, atol=1e-14)
    area = comm.allreduce(np.linalg.norm(vectors, axis=1).sum())
    assert area == pytest.approx(2 * (2.0 * 1.5 + 2.0 * 0.5 + 1.5 * 0.5))
    # Cells of 0.5 x 0.5 x 0.25; tetrahedra are as high as the cells that they fill.
    height = 0.5 - 0.25 * (np.abs(vectors[:, 2]) > 1e-6)
    assert np.allclose(surface.thickness, height)


@cells_
@ghosts_
def test_keys_number_the_segments_independently_of_the_partition(comm, cell, ghosts):
    def numbers(on, **kwargs):
        surface, _ = box_top(on, cell, **kwargs)
        ids = np.sort(input_ids(surface.V)[surface.segments], axis=1)
        keys, ids = everywhere(surface, surface.key), everywhere(surface, ids)
        assert sorted(keys) == list(range(len(keys)))
        return {tuple(i): k for i, k in zip(ids.tolist(), keys, strict=True)}

    by_rank = numbers(comm, ghosts=ghosts)
    alone = comm.Split(comm.rank)
    assert numbers(alone) == by_rank
    alone.Free()


@cells_
def test_keys_do_not_depend_on_the_order_of_the_cells(comm, cell, rng):
    data = box_meshes.boxes([(3, 4, 2)], [(1.2, 1.0, 0.5)], cell)
    found = []
    for order in (np.arange(len(data.cells)), rng.permutation(len(data.cells))):
        shuffled = replace(data, cells=data.cells[order], body=data.body[order])
        mesh, _, facets, tag = box_meshes.distribute(comm, shuffled)
        surface = nts.Surface(space(mesh), facets, tag["top 0"])
        ids = np.sort(input_ids(surface.V)[surface.segments], axis=1)
        ids, keys = everywhere(surface, ids), everywhere(surface, surface.key)
        found.append(dict(zip(map(tuple, ids.tolist()), keys.tolist(), strict=True)))
    assert found[0] == found[1]


def test_surface_of_one_rank_is_empty_on_the_others(comm):
    # All cells of the upper half belong to the last rank.
    last = comm.size - 1

    def owner(middle):
        return np.where(middle[:, 2] > 0.25, last, np.arange(len(middle)) % max(last, 1))

    data = box_meshes.boxes([(3, 4, 2)], [(1.2, 1.0, 0.5)])
    mesh, _, facets, tag = box_meshes.distribute(comm, data, owner=owner)
    surface = nts.Surface(space(mesh), facets, tag["top 0"])
    segments = comm.allgather(len(surface.segments))
    assert segments == [0] * last + [12]
    assert comm.allgather(len(surface.area)) == [0] * last + [20]


@cells_
@pytest.mark.parametrize("cut", [False, True], ids=["inside a rank", "between ranks"])
def test_facets_between_two_cells_are_refused(comm, cell, cut, refused):
    data = box_meshes.boxes([(3, 4, 2)], [(1.2, 1.0, 0.5)], cell)
    data.surfaces["middle"] = np.flatnonzero(data.X[:, 2] == 0.25)

    def owner(middle):
        above = middle[:, 2] > 0.25
        return np.where(above, comm.size - 1, 0) if cut else np.zeros(len(middle))

    mesh, _, facets, tag = box_meshes.distribute(comm, data, owner=owner)
    number = 24 if cell == "tetrahedron" else 12
    message = f"on the boundary, given tag {tag['middle']} with {number} between two cells"
    with refused(ValueError, message):
        nts.Surface(space(mesh), facets, tag["middle"])


@pytest.mark.at_most_two_ranks
def test_surface_refuses_wrong_arguments(comm, refused):
    data = box_meshes.boxes([(3, 4, 2)], [(1.2, 1.0, 0.5)])
    mesh, cells, facets, tag = box_meshes.distribute(comm, data)
    V = space(mesh)
    with refused(ValueError, r"one of the tags \[1, 2\] of facets, given 9"):
        nts.Surface(V, facets, 9)
    with refused(ValueError, "facets of dimension 2, given tags of dimension 3"):
        nts.Surface(V, cells, tag["body 0"])
    with refused(TypeError, "integer tag, given None"):
        nts.Surface(V, facets, None)
    with refused(TypeError, "integer tag, given True"):
        nts.Surface(V, facets, True)
    with refused(TypeError, "MeshTags as facets, given list"):
        nts.Surface(V, [1, 2], 1)
    none = meshtags(mesh, 2, np.empty(0, dtype=np.int32), np.empty(0, dtype=np.int32))
    with refused(ValueError, r"one of the tags \[\] of facets, given 1"):
        nts.Surface(V, none, 1)
    with refused(ValueError, "expected the space functionspace"):
        nts.Surface(space(mesh, 3), facets, 1)


@pytest.mark.serial
@pytest.mark.parametrize("side", ["top", "bottom"])  # of either orientation
@pytest.mark.parametrize("collapsed", [(0, 1), (1, 3), (3, 2), (2, 0)])
def test_facets_with_an_edge_without_length_still_point_outwards(comm, collapsed, side):
    box = {"corner": (0, 0, 0), "size": (3, 3, 1), "cells": (3, 3, 1)}
    data = nts.read_mesh(lambda model: nts.parts.add_box(model, "box", **box), comm)
    x, up = data.mesh.geometry.x, 1 if side == "top" else -1
    corners = np.array([[1, 1, 1], [2, 1, 1], [1, 2, 1], [2, 2, 1]])  # of the facet in the middle
    corners[:, 2] = up > 0
    moves, to = corners[list(collapsed)]
    x[np.all(np.abs(x - moves) < 1e-9, axis=1)] = to
    V = fem.functionspace(data.mesh, ("Lagrange", 1, (3,)))
    surface = nts.Surface(V, data.facets, data.tag[f"box_{side}"])
    X = V.tabulate_dof_coordinates()[surface.segments]
    outwards = up * area_vectors(X, surface.orientation)[:, 2]
    assert np.all(outwards > 0.1)
    assert comm.allreduce(outwards.sum()) == pytest.approx(9)


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("degree", [1, 2])
def test_areas_of_some_nodes_are_those_of_all(comm, cell, degree):
    box = Box(comm, cell)
    V = fem.functionspace(box.mesh, ("Lagrange", degree, (3,)))
    whole = nts.Surface(V, box.facets, box.tag["bottom 0"])
    areas = {name: getattr(whole, name) for name in ("area", "positive_area")}
    assert np.all(areas["positive_area"] > 0)
    np.testing.assert_allclose(areas["positive_area"], areas["area"], atol=1e-3)
    flags = whole.nodes % 2 == 0
    some = whole.with_nodes(flags)
    for name, values in areas.items():
        np.testing.assert_allclose(getattr(some, name), values[flags], atol=1e-16)
