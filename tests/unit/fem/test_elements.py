"""Elements of degree 1 and 2: their pieces, and the numbers of their nodes."""

import basix
import numpy as np
import pytest
from dolfinx import fem

from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import input_ids, listed
from helpers.models import box_meshes

pytestmark = pytest.mark.at_most_two_ranks

ROUNDING = 1e-12

cells_ = pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
degrees = pytest.mark.parametrize("degree", [1, 2])


def volume(x):
    """Volumes of cells of degree 1 by vertices in Basix order, with sign."""
    if x.shape[1] == 4:
        return np.linalg.det(x[:, 1:] - x[:, :1]) / 6
    return np.linalg.det(x[:, [1, 2, 4]] - x[:, :1])  # of parallelepipeds


@cells_
@degrees
def test_pieces_fill_the_cell(cell, degree):
    element = Element(cell, degree)
    volumes = volume(element.points[element.pieces])
    expected = (1 / 6 if cell == "tetrahedron" else 1) / len(volumes)
    np.testing.assert_allclose(volumes, expected, rtol=ROUNDING)
    assert len(volumes) == 8 ** (degree - 1)
    assert set(element.pieces.ravel()) == set(range(len(element.points)))


@cells_
@degrees
def test_sides_fill_the_facets_and_belong_to_their_pieces(cell, degree):
    element = Element(cell, degree)
    kind = basix.CellType[cell]
    corners = basix.geometry(kind)
    closures = element.basix.entity_closure_dofs[2]
    facets = basix.topology(kind)[2]
    for facet, closure, (sides, pieces) in zip(facets, closures, element.sides, strict=True):
        x = element.points[sides]
        area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
        edges = corners[facet][1:3] - corners[facet][0]
        np.testing.assert_allclose(area, np.linalg.norm(np.cross(*edges)) / len(sides))
        assert len(sides) == 4 ** (degree - 1)
        assert set(sides.ravel()) == set(closure)
        assert all(set(side) <= set(piece) for side, piece in zip(sides, pieces, strict=True))


@cells_
def test_every_node_is_in_the_middle_of_its_diagonals(cell):
    element = Element(cell, 2)
    corners = basix.geometry(basix.CellType[cell])
    for point, pairs in zip(element.points, element.diagonals, strict=True):
        assert len(pairs)
        np.testing.assert_allclose(corners[pairs].mean(axis=1) - point, 0, atol=ROUNDING)


@cells_
@degrees
def test_numbers_of_nodes_are_unique_in_any_partition(comm, cell, degree):
    data = box_meshes.boxes([(3, 4, 2)], [(1.2, 1.0, 0.5)], cell)

    def positions(on):
        mesh, *_ = box_meshes.distribute(on, data)
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        n = V.dofmap.index_map.size_local
        parts = on.allgather((input_ids(V)[:n], V.tabulate_dof_coordinates()[:n]))
        ids, X = (np.concatenate(part) for part in zip(*parts, strict=True))
        assert len(np.unique(ids)) == len(ids)
        return X[np.argsort(ids)], np.sort(ids)

    alone = comm.Split(comm.rank)
    (X, ids), (X_alone, ids_alone) = positions(comm), positions(alone)
    alone.Free()
    np.testing.assert_array_equal(ids, ids_alone)
    np.testing.assert_allclose(X, X_alone, rtol=0, atol=ROUNDING)
    # Vertices come first, by their numbers as read.
    np.testing.assert_array_equal(ids[: len(data.X)], np.arange(len(data.X)))


def test_nodes_are_called_by_the_vertices_around_them():
    middle = ((12 + 1) << 31) + 15
    assert listed(np.array([3, middle])) == "3, 12-15"
    assert listed(np.arange(7)) == "0, 1, 2, 3, 4, ..."


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
@degrees
def test_pieces_and_sides_fill_cells_of_the_plane_and_their_edges(cell, degree):
    element = Element(cell, degree)
    x = element.points[element.pieces]
    area = np.linalg.det(x[:, 1:3] - x[:, :1])
    np.testing.assert_allclose(area, 1 / 4 ** (degree - 1), rtol=ROUNDING)
    assert set(element.pieces.ravel()) == set(range(len(element.points)))
    kind = basix.CellType[cell]
    corners, closures = basix.geometry(kind), element.basix.entity_closure_dofs[1]
    for edge, closure, (sides, pieces) in zip(
        basix.topology(kind)[1], closures, element.sides, strict=True
    ):
        travel = element.points[sides[:, 1]] - element.points[sides[:, 0]]
        expected = np.linalg.norm(corners[edge[1]] - corners[edge[0]]) / degree
        np.testing.assert_allclose(np.linalg.norm(travel, axis=1), expected, rtol=ROUNDING)
        assert set(sides.ravel()) == set(closure) and len(sides) == degree
        assert all(set(side) <= set(piece) for side, piece in zip(sides, pieces, strict=True))
