"""Nodes touch what faces them: not the sides of bodies next to them."""

import time

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.nodal_facets import NodalFacets
from helpers import box_meshes

cells = pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
GAP = 0.01


class Two:
    """Two blocks, ``(lower corner, upper corner, cells)`` each, with their whole boundaries."""

    def __init__(self, comm, *blocks, cell="hexahedron"):
        """Make the bodies."""
        corners = [np.array(block[:2], dtype=float) for block in blocks]
        data = box_meshes.boxes([b[2] for b in blocks], [c[1] - c[0] for c in corners], cell=cell)
        first = 0
        for (low, _), block in zip(corners, blocks, strict=True):
            count = np.prod(np.array(block[2]) + 1)
            X = data.X[first : first + count]
            X += low - X.min(axis=0)
            first += count
        mesh, tags, _, _ = box_meshes.distribute(comm, data)
        self.V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        stone = nts.NeoHookean(1e5, 0.3, 1e3)
        self.bodies = [nts.Body(self.V, tags, value, stone) for value in range(len(blocks))]

    def search(self):
        """Make a search for what the nodes of the second body face."""
        return GlobalSearch(*(nts.boundary_of(body) for body in reversed(self.bodies)))

    def look(self, x, search=None):
        """Return a function of the reach that finds segments and gaps of all second nodes."""
        nodes = nts.boundary_of(self.bodies[1])
        candidates, _ = (search or self.search()).update(x, np.inf)
        none = np.full(len(nodes.nodes), -1, dtype=np.int32)
        points, x = NodalFacets(nodes).points(x), candidates.scatter.forward(x).copy()
        return lambda reach: candidates.pair(points, x, none, reach)

    def gaps(self, shift):
        """Reference positions of the second body's nodes, and gaps when it is shifted."""
        nodes, segments = (nts.boundary_of(body) for body in reversed(self.bodies))
        x = self.V.tabulate_dof_coordinates().copy()
        x[self.bodies[1].nodes] += shift
        candidates, _ = GlobalSearch(nodes, segments).update(x, 1.0)
        none = np.full(len(nodes.nodes), -1, dtype=np.int32)
        points = NodalFacets(nodes).points(x)
        _, gap = candidates.pair(points, candidates.scatter.forward(x), none, 1.0)
        return self.V.tabulate_dof_coordinates()[nodes.nodes], gap


@cells
def test_rims_of_flush_blocks_face_the_top_and_not_the_sides(comm, agree, cell):
    low, high = ((0, 0, 0), (1, 1, 1), (2, 2, 2)), ((0, 0, 1.0), (1, 1, 2), (3, 3, 3))
    two = Two(comm, low, high, cell=cell)
    for shift in (GAP, -GAP):
        X, gap = two.gaps((0, 0, shift))
        bottom = np.isclose(X[:, 2], 1)
        assert agree(np.allclose(gap[bottom], shift, atol=1e-12))
        assert agree(np.isnan(gap[~bottom]).all())


def test_block_beside_another_faces_its_side(comm, agree):
    two = Two(comm, ((0, 0, 0), (1, 1, 1), (2, 2, 2)), ((1, 0, 0), (2, 1, 1), (2, 2, 2)))
    X, gap = two.gaps((GAP, 0, 0))
    assert agree(np.allclose(gap[np.isclose(X[:, 0], 1)], GAP, atol=1e-12))


def test_edge_of_a_turned_block_faces_what_it_presses_on(comm, agree):
    # A thin fin that stands on its narrow side, and one that lies on its broad side.
    floor = ((-2, -2, -1), (2, 2, 0), (4, 4, 1))
    for fin in (((0, 0, 0), (0.02, 1, 1), (1, 3, 3)), ((0, 0, 0), (1, 1, 0.02), (3, 3, 1))):
        X, gap = Two(comm, floor, fin).gaps((0.01, 0.013, GAP))
        assert agree(np.allclose(gap[np.isclose(X[:, 2], 0)], GAP, atol=1e-12))


def test_node_below_a_thin_plate_is_not_taken_for_one_deep_inside(comm, agree):
    plate = ((-1, -1, -0.05), (1, 1, 0), (2, 2, 1))
    two = Two(comm, plate, ((-0.4, -0.4, 0), (0.4, 0.4, 0.8), (2, 2, 2)))
    # Its bottom faces the top of the plate, but lies below the plate.
    X, gap = two.gaps((0.01, 0.013, -0.2))
    assert agree(np.isnan(gap[np.isclose(X[:, 2], 0)]).all())
    X, gap = two.gaps((0.01, 0.013, -0.03))
    assert agree(np.allclose(gap[np.isclose(X[:, 2], 0)], -0.03, atol=1e-12))


def test_side_of_a_block_hides_what_lies_behind_its_rim(comm, agree):
    # A slanted block stands before the end of a beam of one long cell. Its lower edge looks away
    # from the end, and up to the under side, behind whose plane it is: beyond the end, not inside.
    beam = ((0, -1, 0), (4, 1, 0.5), (1, 1, 1))
    two = Two(comm, beam, ((-0.4, -0.3, 0.2), (-0.1, 0.3, 0.8), (1, 1, 1)))
    _, gap = two.gaps((0, 0, 0))
    assert agree(not (gap < 0).any())


@cells
def test_looks_at_any_distance_find_what_a_look_far_enough_finds(comm, agree, cell):
    floor, stone = ((0, 0, 0), (4, 4, 1), (5, 5, 2)), ((0, 0, 0), (1, 1, 1), (4, 4, 4))
    two, rng = Two(comm, floor, stone, cell=cell), np.random.default_rng(7)
    X, found, search = two.V.tabulate_dof_coordinates(), 0, two.search()
    for _ in range(30):
        # Both are warped, and the stone lies anywhere. The search knows what it found before.
        bend = rng.uniform(-0.5, 0.5, (3, 3))
        x = X + np.sin(2 * X @ bend) * rng.uniform(0, 0.6)
        x[two.bodies[1].nodes] += rng.uniform(-2, 4, 3)
        look = two.look(x)
        anywhere, far, again = look(np.inf), look(1e3), two.look(x, search)(np.inf)
        for found_there in (anywhere, again):
            pairs = zip(found_there, far, strict=True)
            assert agree(all(np.array_equal(*pair, equal_nan=True) for pair in pairs))
        found += np.count_nonzero(far[0] >= 0)
    assert comm.allreduce(found) > 0  # a rank may have no node of the stone


@pytest.mark.serial
def test_nodes_that_face_nothing_do_not_look_at_all_segments():
    n, m = 40, 200
    grid = np.arange((n + 1) ** 2, dtype=np.int32).reshape(n + 1, n + 1)
    corners = (grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:])
    floor = np.stack(corners, axis=-1).reshape(-1, 4)
    x = np.zeros((grid.size, 3))
    x[:, :2] = np.stack(np.divmod(grid.ravel(), n + 1), axis=-1) / n
    kernel = _kernels.Segments(floor, np.ones(len(floor)), np.arange(len(floor)))
    # A triangle around each node, which looks down or up.
    numbers, ones = np.arange(m, dtype=np.int32), np.ones(m)
    own = np.arange(3 * m, dtype=np.int32).reshape(m, 3)
    nodes = np.column_stack([np.random.default_rng(1).uniform(0, 1, (m, 2)), 0.3 * ones])
    triangles = nodes[:, None] + np.array([[0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0]])
    seconds, found = {}, {}
    for side in (-1.0, 1.0):
        facets = _kernels.NodeFacets(
            own, side * ones, np.arange(m + 1, dtype=np.int32), numbers, 0 * numbers, ones
        )
        around = facets, triangles.reshape(-1, 3), numbers, np.ones(len(floor))
        times = []
        for _ in range(5):
            start = time.process_time()
            found[side] = kernel.pair(nodes, np.full(m, -1, np.int32), 0.0, np.inf, x, *around)[0]
            times.append(time.process_time() - start)
        seconds[side] = min(times)
    assert (found[-1.0] >= 0).all() and (found[1.0] < 0).all()
    # All 1600 segments would take a hundred times as long as those nearby.
    assert seconds[1.0] < 5 * seconds[-1.0]
