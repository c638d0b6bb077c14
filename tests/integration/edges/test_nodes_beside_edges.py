"""A node that arrives sideways at a sharp edge is not inside the body below the edge."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.nodal_facets import NodalFacets
from helpers.models.box_meshes import boxes, distribute

pytestmark = pytest.mark.serial

DEPTH = 0.03  # of the node below the top of the block [m]
OFFSET = 0.14  # of the node from its edge, within 15 % of the length of the facet [m]


def corner_first():
    """Edges of a cube from its lowest corner, columns of a rotation; its diagonal leans to +y."""
    up, lean = np.array([0, 0, 1.0]), np.array([0, 1.0, 0])
    first = np.deg2rad(38.0) - np.arccos(1 / np.sqrt(3))
    edge = np.cos(first) * up + np.sin(first) * lean
    diagonal = np.cos(first) * lean - np.sin(first) * up
    across = np.array([1.0, 0, 0])
    return np.column_stack([(diagonal + across) / 2**0.5, (diagonal - across) / 2**0.5, edge])


def scene(offset, *, height=-DEPTH, x=0.5):
    """Space, bodies and lowest node of a cube above the edge of a block.

    The corner is next to the edge and below the top of the block; the cube leans over it, and
    none of its facets there faces the side of the block.
    """
    data = boxes([(1, 1, 1)] * 2, [(1.0, 1.0, 1.0)] * 2)
    block, cube = (np.unique(data.cells[data.body == i]) for i in range(2))
    data.X[block] -= data.X[block].min(axis=0) + np.array([0.0, 0.0, 1.0])
    unit = data.X[cube] - data.X[cube].min(axis=0)
    data.X[cube] = unit @ corner_first().T + [x, -offset, height]
    mesh, cells, _, tag = distribute(MPI.COMM_SELF, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bodies = [nts.RigidBody(V, cells, tag[f"body {i}"], 10.0) for i in range(2)]
    nodes = bodies[1].nodes
    X = V.tabulate_dof_coordinates()[nodes]
    return V, bodies, nodes[np.argmin(X[:, 2])]


def gap_of(offset, *, height=-DEPTH, x=0.5, before=None):
    """Gap of the corner, NaN without a segment; it was at a height before, if that is given."""
    V, (block, cube), corner = scene(offset, height=height, x=x)
    nodes, segments = nts.boundary_of(cube), nts.boundary_of(block)
    X = V.tabulate_dof_coordinates()
    candidates, _ = GlobalSearch(nodes, segments).update(X, np.inf)
    points = NodalFacets(nodes).points(X)
    current = np.full(len(nodes.nodes), -1, dtype=np.int32)
    if before is not None:
        above = X.copy()
        above[cube.nodes] += [0, 0, before - height]
        current, _ = candidates.pair(points, candidates.scatter.forward(above), current, np.inf)
    _, gap = candidates.pair(points, candidates.scatter.forward(X), current, np.inf)
    return gap[np.flatnonzero(nodes.nodes == corner)[0]]


@pytest.mark.parametrize("x", [0.3, 0.5])
def test_a_node_coming_from_beyond_a_sharp_edge_has_no_segment(x):
    assert np.isnan(gap_of(OFFSET, x=x))
    # It touches through the plane of the top, as bodies that slide over an edge do.
    assert gap_of(OFFSET, x=x, height=0.02) == pytest.approx(0.02)
    assert gap_of(OFFSET, x=x, before=0.02) == pytest.approx(-DEPTH)
    # The same holds if round-off or a bulge of a hundredth moves it next to the edge.
    assert gap_of(0.005, x=x) == pytest.approx(-DEPTH)


@pytest.mark.parametrize("scheme", [nts.CentralDifference, nts.EnergyMomentum])
def test_a_corner_next_to_a_block_has_no_contact(scheme):
    _, bodies, corner = scene(0.2)
    pairs = nts.all_pairs(
        bodies, enforcement=nts.Penalty(4.0e4), edges=True, method="node-to-segment"
    )
    pairs += [
        nts.ContactPair(p.segments, p.nodes, p.enforcement, method="node-to-segment")
        for p in pairs[:1]
    ]
    stepper = scheme(bodies, pairs, dt=1e-3)
    stepper.set_velocity(bodies[1], (0.0, 1.0, 0.0))
    for _ in range(80):
        stepper.advance()
    assert stepper.x[corner][1] == pytest.approx(-0.12)
    assert np.abs(stepper.v.x.array.reshape(-1, 3)[bodies[0].nodes]).max() < 1e-12
