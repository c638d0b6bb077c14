"""Sharp edges of surfaces."""

from dataclasses import replace

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.search.edges.sharp_edges import SharpEdges
from helpers.models.box_meshes import boxes, distribute


def body(comm, data, degree=1):
    """A body of a mesh."""
    mesh, cells, _, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    return nts.Body(V, cells, tag["body 0"], nts.NeoHookean(1.0e3, 0.3, 1.0))


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_a_box_has_its_twelve_edges_once_on_any_number_of_ranks(comm, cell):
    box = body(comm, boxes([(2, 3, 1)], [(1.0, 1.0, 1.0)], cell))
    surface = nts.boundary_of(box)
    edges = SharpEdges.of(surface)
    assert edges is SharpEdges.of(surface)
    assert edges.total == 4 * (2 + 3 + 1)
    everywhere = np.concatenate(comm.allgather(edges.key))
    assert np.array_equal(np.sort(everywhere), np.arange(edges.total))
    # Both ends lie on two sides of the box, the middle on exactly these.
    X = edges.ends(surface.V.tabulate_dof_coordinates()).mean(axis=0)
    at_side = np.isclose(X, 0) | np.isclose(X, 1)
    assert (at_side.sum(axis=1) == 2).all()
    # Facets face outward.
    ids, owners = edges.offer
    assert ids.shape == owners.shape == (len(X), 2 + 2 * edges.facets.shape[2])
    assert (edges.thickness > 0).all()


@pytest.mark.serial
def test_concave_blunt_and_free_edges_are_not_sharp(comm):
    data = boxes([(2, 2, 1)], [(1.0, 1.0, 1.0)])
    whole = body(comm, data)
    assert SharpEdges.of(nts.boundary_of(whole)).total == 20
    # One quarter is left out: a concave edge between its two walls.
    corner = (data.X[data.cells].mean(axis=1)[:, :2] > 0.5).all(axis=1)
    notched = replace(data, cells=data.cells[~corner], body=data.body[~corner])
    assert SharpEdges.of(nts.boundary_of(body(comm, notched))).total == 8 + 8 + 5
    top = nts.boundary_of(whole, where=lambda x: x[2] > 0.99)
    assert SharpEdges.of(top).total == 0
    # A prism of sixteen sides turns by less than 30 degrees at each of them.
    round_box = boxes([(4, 4, 1)], [(2.0, 2.0, 1.0)])
    round_box.X[:, :2] -= 1
    radius = np.abs(round_box.X[:, :2]).max(axis=1)
    length = np.linalg.norm(round_box.X[:, :2], axis=1)
    round_box.X[:, :2] *= (radius / np.where(length > 0, length, 1.0))[:, None]
    assert SharpEdges.of(nts.boundary_of(body(comm, round_box))).total == 2 * 16
