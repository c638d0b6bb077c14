"""Nodes touch segments that face them, not the sides of adjacent bodies."""

import time

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.nodal_facets import NodalFacets
from helpers.models import box_meshes

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
        """Search for segments near the nodes of the second body."""
        return GlobalSearch(*(nts.boundary_of(body) for body in reversed(self.bodies)))

    def finder(self, x, search=None):
        """Function of the search radius that finds segments and gaps of all second nodes."""
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


def test_block_next_to_another_faces_its_side(comm, agree):
    two = Two(comm, ((0, 0, 0), (1, 1, 1), (2, 2, 2)), ((1, 0, 0), (2, 1, 1), (2, 2, 2)))
    X, gap = two.gaps((GAP, 0, 0))
    assert agree(np.allclose(gap[np.isclose(X[:, 0], 1)], GAP, atol=1e-12))


def test_edge_of_a_turned_block_faces_the_pressed_surface(comm, agree):
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


def test_side_of_a_block_hides_segments_behind_its_rim(comm, agree):
    # A slanted block in front of the end of a beam of one long cell. The lower edge faces away from
    # the end and up to the underside, behind whose plane it lies: beyond the end, not inside.
    beam = ((0, -1, 0), (4, 1, 0.5), (1, 1, 1))
    two = Two(comm, beam, ((-0.4, -0.3, 0.2), (-0.1, 0.3, 0.8), (1, 1, 1)))
    _, gap = two.gaps((0, 0, 0))
    assert agree(not (gap < 0).any())


@cells
def test_searches_at_any_distance_find_the_same_segment(comm, agree, cell):
    floor, stone = ((0, 0, 0), (4, 4, 1), (5, 5, 2)), ((0, 0, 0), (1, 1, 1), (4, 4, 4))
    two, rng = Two(comm, floor, stone, cell=cell), np.random.default_rng(7)
    X, found, search = two.V.tabulate_dof_coordinates(), 0, two.search()
    for _ in range(30):
        # Both are warped, at random positions of the stone. The search knows the last segments.
        bend = rng.uniform(-0.5, 0.5, (3, 3))
        x = X + np.sin(2 * X @ bend) * rng.uniform(0, 0.6)
        x[two.bodies[1].nodes] += rng.uniform(-2, 4, 3)
        find = two.finder(x)
        anywhere, far, again = find(np.inf), find(1e3), two.finder(x, search)(np.inf)
        for found_there in (anywhere, again):
            pairs = zip(found_there, far, strict=True)
            assert agree(all(np.array_equal(*pair, equal_nan=True) for pair in pairs))
        found += np.count_nonzero(far[0] >= 0)
    assert comm.allreduce(found) > 0  # a rank may have no node of the stone


def find(node, triangles, segments):
    """Segment of a node with triangles around it, ``(f, 3, 3)``, it first, or -1."""
    count = len(triangles)
    numbers = np.arange(count, dtype=np.int32)
    facets = _kernels.NodeFacets(
        np.arange(3 * count, dtype=np.int32).reshape(count, 3),
        np.ones(count),
        np.array([0, count], dtype=np.int32),
        numbers,
        0 * numbers,
        np.ones(count),
    )
    rows = np.arange(4 * len(segments), dtype=np.int32).reshape(-1, 4)
    kernel = _kernels.Segments(rows, np.ones(len(rows)), np.arange(len(rows)))
    none, first = np.full(1, -1, np.int32), np.zeros(1, np.int32)
    around = facets, triangles.reshape(-1, 3), first, np.full(len(rows), np.inf)
    return kernel.pair(node[None], none, 0.01, np.inf, segments.reshape(-1, 3), *around)[0][0]


@pytest.mark.serial
def test_node_faces_segments_within_its_cone_of_normals(rng):
    square = np.array([[-9.0, -9, 0], [9, -9, 0], [-9, 9, 0], [9, 9, 0]])
    num_faced = 0
    for _ in range(300):
        # Corners, edges and faces: normals within a half space.
        normals = rng.normal(size=(rng.integers(1, 6), 3)) + rng.uniform(0, 2) * np.eye(3)[0]
        normals = normals @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        # Sums of three of them with positive weights make up the cone.
        choice = rng.integers(len(normals), size=(20000, 3))
        weights = rng.exponential(size=(20000, 3)) ** 3
        cone = np.vstack([np.einsum("ij,ijk->ik", weights, normals[choice]), normals])
        cosine = (-cone[:, 2] / np.linalg.norm(cone, axis=1)).max()
        if abs(cosine - 0.1) < 0.02:  # cosine of 84 degrees, and the distance of samples
            continue
        first = [np.linalg.svd(normal[None])[2][1] for normal in normals]
        edges = np.stack([0 * normals, first, np.cross(normals, first)], axis=1)
        node = np.array([0, 0, 0.5])
        found = find(node, node + edges, square[None])
        assert (found >= 0) == (cosine > 0.1)
        num_faced += found >= 0
    assert 50 < num_faced < 250


@pytest.mark.serial
def test_node_ahead_of_an_edge_waits_for_the_face_beyond_it(rng):
    """Wedges over a flat surface, whose sides lean by two angles against it."""
    turn, num_waiting, num_touching = 20.0, 0, 0  # degrees: angle that is no edge
    around = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    floor = np.stack([np.zeros((4, 3)), around, np.roll(around, -1, axis=0)], axis=1)
    width = np.array([[0.0, -4, 0], [0, 4, 0]])
    for _ in range(200):
        behind, ahead = rng.uniform(-10, 60), rng.uniform(5, 83)
        if min(abs(ahead - turn), abs(ahead - abs(behind) - turn), behind + ahead) < 1:
            continue
        # Sides of the wedge with their normals down, the edge at the origin.
        b, a = np.radians([behind, ahead])
        back = width[::-1], width[::-1] + 5 * np.array([-np.cos(b), 0, np.sin(b)])
        front = width, width + 5 * np.array([np.cos(a), 0, np.sin(a)])
        segments = np.stack([np.concatenate(back), np.concatenate(front)])
        # The node lies in front of the side ahead.
        normal = np.array([np.sin(a), 0, -np.cos(a)])
        node = rng.uniform(0.05, 0.3) * np.array([np.cos(a), 0, np.sin(a)])
        node += rng.uniform(0.001, 0.05) * normal + [0, rng.uniform(-1, 1), 0]
        turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turned *= np.sign(np.linalg.det(turned))
        found = find(turned @ node, (node + floor) @ turned.T, segments @ turned.T)
        waits = ahead > turn and abs(behind) < ahead - turn
        assert (found == 1) != waits
        num_waiting, num_touching = num_waiting + waits, num_touching + (not waits)
    assert min(num_waiting, num_touching) > 30


@pytest.mark.serial
def test_nodes_that_face_nothing_do_not_search_all_segments():
    n, m = 40, 200
    grid = np.arange((n + 1) ** 2, dtype=np.int32).reshape(n + 1, n + 1)
    corners = (grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:])
    floor = np.stack(corners, axis=-1).reshape(-1, 4)
    x = np.zeros((grid.size, 3))
    x[:, :2] = np.stack(np.divmod(grid.ravel(), n + 1), axis=-1) / n
    kernel = _kernels.Segments(floor, np.ones(len(floor)), np.arange(len(floor)))
    # A triangle around each node, facing down or up.
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
