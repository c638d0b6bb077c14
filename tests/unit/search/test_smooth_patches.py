"""Patches of smooth surfaces: control points as weighted sums of nodes."""

import numpy as np
import pytest
from dolfinx import fem, mesh

import dolfinx_nts as nts
from dolfinx_nts.search.smooth.near_facets import NearFacets
from dolfinx_nts.search.smooth.smooth_patches import SmoothPatches
from helpers.models.box_meshes import boxes, distribute
from helpers.models.round import ring_mesh

EDGE = np.linspace(0, 1, 21)


def bernstein(t):
    """Polynomials of degree 3 at places t, ``(..., 4)``."""
    t = np.asarray(t)[..., None]
    n = np.arange(4)
    return np.array([1, 3, 3, 1]) * t**n * (1 - t) ** (3 - n)


def control(patches, x):
    """Control points of all patches of this rank, by positions of all nodes in their order."""
    return patches.weights @ x[patches.ids]


def surface_of(comm, data, where=None):
    domain, cells, _, tag = distribute(comm, data)
    V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    body = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(1.0e3, 0.3, 1.0))
    return nts.boundary_of(body, where=where, smooth=True)


def uneven(cell="hexahedron", shape=(5, 4, 1)):
    """A flat box whose upper nodes lie unevenly, each cell a parallelogram."""
    data = boxes([shape], [(1.0, 1.0, 0.3)], cell)
    data.X[:, 0] += 0.3 * data.X[:, 0] ** 2
    data.X[:, 1] += 0.2 * data.X[:, 1] ** 2
    data.X[:, :2] = data.X[:, :2] @ np.array([[1.0, 0.2], [0.3, 1.0]])
    return data


def top(x):
    return x[2] > 0.299


def num_at_rim(surface):
    """Vertices of each facet that lie on the rim, on one rank."""
    near = NearFacets.of(surface)
    at_rim = np.zeros(surface.V.dofmap.index_map.size_global, dtype=np.int32)
    at_rim[near.dofs[np.unique(near.edges[near.is_feature])]] = 1
    return at_rim[surface.segments].sum(axis=1)


def quadratic(X, curvature=1.0):
    return curvature * (0.3 * X[:, 0] ** 2 - 0.4 * X[:, 0] * X[:, 1] + 0.2 * X[:, 1] ** 2)


@pytest.mark.parametrize("cells", [16, 24])
@pytest.mark.serial
def test_circle_in_the_plane_is_a_circle_from_16_edges_on(comm, cells):
    V = fem.functionspace(
        ring_mesh(comm, [(0.0, 0.0)], cells, "quadrilateral", 0.1), ("P", 1, (2,))
    )
    outer = nts.Surface.where(V, lambda x: np.hypot(x[0], x[1]) > 0.99, smooth=True)
    patches = SmoothPatches(outer)
    assert patches.weights.shape[1:] == (4, 4)
    assert np.abs(patches.weights.sum(axis=2) - 1).max() < 1e-14
    points = bernstein(EDGE) @ control(patches, V.tabulate_dof_coordinates())
    assert np.abs(np.linalg.norm(points, axis=2) - 1).max() < 2e-7 * (16 / cells) ** 6


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_planes_stay_planes_and_lines_lines_whatever_the_mesh(comm, cell):
    surface = surface_of(comm, uneven(cell))
    V = surface.V
    patches = SmoothPatches(surface)
    assert np.abs(patches.weights.sum(axis=2) - 1).max() < 1e-13
    # The box turns at its edges by more than 30 degrees: all its patches are the facets.
    x = V.tabulate_dof_coordinates()
    moved = x @ np.array([[1.0, 0.3, 0.1], [-0.2, 0.8, 0.4], [0.1, 0.1, 1.2]])
    k = surface.segments.shape[1]
    values = np.zeros((V.dofmap.index_map.size_global, 3))
    first, last = V.dofmap.index_map.local_range
    values[first:last] = moved[: last - first]
    values = comm.allreduce(values)
    points = control(patches, values)
    ids = V.dofmap.index_map.local_to_global(surface.segments.ravel())
    corners = values[ids.reshape(surface.segments.shape)]
    thirds = np.arange(4) / 3
    if k == 3:
        u, v = np.array([(i / 3, j / 3) for j in range(4) for i in range(4 - j)]).T
        phi = np.stack([1 - u - v, u, v], axis=1)
    else:
        v, u = (c.ravel() for c in np.meshgrid(thirds, thirds, indexing="ij"))
        phi = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], axis=1)
    assert np.abs(points - phi @ corners).max() < 1e-10


@pytest.mark.serial
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_a_surface_bent_to_a_quadratic_one_is_exact_within_it(comm, cell):
    surface = surface_of(comm, uneven(cell), top)
    patches, X = SmoothPatches(surface), surface.V.tabulate_dof_coordinates()
    x = X + np.outer(quadratic(X), [0, 0, 1])
    inside = num_at_rim(surface) == 0
    assert inside.sum() > 3
    points = control(patches, x)[inside]
    if points.shape[1] == 16:
        # Parallelograms, so that the surface is quadratic in the coordinates of a patch.
        net = points.reshape(-1, 4, 4, 3)
        places = np.einsum("ui,vj,pjic->puvc", bernstein(EDGE), bernstein(EDGE), net)
    else:
        u, v = np.array([(a, b) for a in EDGE[::4] for b in EDGE[::4] if a + b <= 1]).T
        ij = [(i, j) for j in range(4) for i in range(4 - j)]
        fact = np.array([1, 1, 2, 6])
        phi = [
            6 / (fact[i] * fact[j] * fact[3 - i - j]) * u**i * v**j * (1 - u - v) ** (3 - i - j)
            for i, j in ij
        ]
        places = np.einsum("cn,pci->pni", np.array(phi), points)
    places = places.reshape(-1, 3)
    error = places[:, 2] - 0.3 - quadratic(places)
    assert np.abs(error).max() < 1e-7


def bent(cell="hexahedron", shape=(6, 6, 2), radius=1.0):
    """A part of a sphere: its upper side has this radius, and turns by 10 degrees a facet."""
    data = boxes([shape], [(1.0, 1.0, 1.0)], cell)
    angle = np.pi / 18 * np.array(shape)[:2] * (data.X[:, :2] - 0.5)
    direction = np.column_stack([np.tan(angle), np.ones(len(angle))])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    data.X[:] = (radius * (0.5 + data.X[:, 2] / 2))[:, None] * direction
    return data


def outer(x):
    return np.linalg.norm(x, axis=0) > 0.999


@pytest.mark.serial
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_sphere_is_hundreds_of_times_rounder_than_its_facets(comm, cell):
    surface = surface_of(comm, bent(cell), outer)
    points = control(SmoothPatches(surface), surface.V.tabulate_dof_coordinates())
    # Edges from rim to rim, at the corners of the mesh of triangles, are straight.
    points = points[num_at_rim(surface) < 2] if cell == "tetrahedron" else points
    sag = (np.pi / 18) ** 2 / 8
    if cell == "hexahedron":
        places = np.einsum(
            "ui,vj,pjic->puvc", bernstein(EDGE), bernstein(EDGE), points.reshape(-1, 4, 4, 3)
        )
    else:
        # Edges from the first vertex to the others.
        places = np.concatenate(
            [bernstein(EDGE) @ points[:, [0, 1, 2, 3]], bernstein(EDGE) @ points[:, [0, 4, 7, 9]]]
        )
    error = np.abs(np.linalg.norm(places, axis=-1) - 1).max()
    assert error < sag / 50


def test_neighbours_share_their_edges_on_any_number_of_ranks(comm):
    surface = surface_of(comm, bent(), outer)
    patches = SmoothPatches(surface)
    V = surface.V
    values = np.zeros((V.dofmap.index_map.size_global, 3))
    first, last = V.dofmap.index_map.local_range
    values[first:last] = V.tabulate_dof_coordinates()[: last - first]
    values = comm.allreduce(values)
    own = control(patches, values).reshape(-1, 4, 4, 3)
    rims = [own[:, 0], own[:, 3], own[:, :, 0], own[:, :, 3]]
    curves = np.concatenate(comm.allgather(np.concatenate(rims)))
    middles = np.einsum("i,pic->pc", bernstein(0.5), curves)
    distance = np.linalg.norm(middles[:, None] - middles[None], axis=2)
    shared = (distance < 1e-13).sum(axis=1)
    # All edges except the rim belong to two patches.
    assert np.count_nonzero(shared == 1) == 4 * 6 and np.count_nonzero(shared == 2) == 2 * 2 * 30
    assert patches.weights.shape[2] == 16


@pytest.mark.serial
def test_degree_two_is_refused(comm):
    domain = mesh.create_unit_square(comm, 2, 2)
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    with pytest.raises(ValueError, match="degree 1 with smooth=True, given degree 2: on curved"):
        nts.Surface.where(V, lambda x: np.isclose(x[1], 1), smooth=True)
