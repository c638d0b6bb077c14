"""Nodes and their candidates within a step, ``local_search.py``."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.meshing import parts

pytestmark = pytest.mark.serial

# Start next to the plate, over it, and deep inside it [m].
OFFSET, OVER, DEEP = (1.3, 0.1), (0.8, 0.05), (0.8, -0.9)


@pytest.fixture
def scene(comm):
    """A plate with its top at z = 0, and a box next to it: candidates of the box's nodes.

    Returns the search of a step, a function of x and z of the first of the nodes that makes
    positions, and that node's position among those of the surface.
    """

    def build(model):
        parts.add_box(model, "plate", corner=(0, 0, -1), size=(1, 1, 1), cells=(1, 1, 1))
        parts.add_box(model, "box", corner=(1.3, 0.4, 0.1), size=(0.2, 0.2, 0.2), cells=(1, 1, 1))

    mesh, _, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    top, bottom = (nts.Surface(V, facets, tag[name]) for name in ("plate_top", "box_bottom"))
    state, X = (
        PairState(
            nts.ContactPair(
                bottom, top, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
            )
        ),
        V.tabulate_dof_coordinates(),
    )
    node = int(np.argmin(X[bottom.nodes] @ [1, 1, 0]))

    def at(place):
        shift = np.array([place[0] - OFFSET[0], 0.0, place[1] - OFFSET[1]])
        moved = X.copy()
        moved[bottom.nodes] += shift
        return moved

    state.search.begin(0.0, 0.0)
    return LocalSearch(state, at(OFFSET), at(OVER)), at, np.array([node], dtype=np.int32)


def iterate(search, at, node):
    """Two iterates between which the node has and loses its segment again."""
    for number, place in enumerate((OVER, DEEP), 1):
        search.find(search.candidates.scatter.forward(at(place)), node, number)
    assert search.unsettled[node].all()
    assert search.segment[node] == -1


def equilibrium(scene, place, held=False):
    """Number of nodes that change in equilibrium at a position, and the segment of the node."""
    search, at, node = scene
    iterate(*scene)
    x = search.candidates.scatter.forward(at(place))
    moved, _ = search.reproject(x, node, np.array([held]), converged=True)
    return moved, int(search.segment[node][0])


@pytest.mark.parametrize("depth", [0.1, 1e-6])
def test_node_lost_during_iterations_is_not_left_inside(scene, depth):
    moved, segment = equilibrium(scene, (0.8, -depth))
    assert moved == 1
    assert segment >= 0


def test_node_outside_in_equilibrium_keeps_its_segment(scene):
    assert equilibrium(scene, OVER) == (0, -1)


def test_active_node_keeps_its_segment(scene):
    assert equilibrium(scene, (0.8, -0.1), held=True) == (0, -1)


def test_gap_of_a_node_that_stays_follows_the_node(scene):
    search, at, node = scene
    places = [OVER, DEEP, OVER, (0.8, 0.02), (0.8, -0.1)]
    search.find(search.candidates.scatter.forward(at(OVER)), node, 0)
    for number, place in enumerate(places[1:], 1):
        segment, _ = search.find(search.candidates.scatter.forward(at(place)), node, number)
        if number > 1:
            assert segment >= 0
            assert search.gap[node] == pytest.approx(place[1], abs=1e-12)
    assert search.unsettled[node].all()
