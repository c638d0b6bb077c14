"""Smooth surfaces: a cubic patch on each facet, linear in the positions of nodes around it.

The edges of a facet become cubic curves through its vertices with the tangents of `Tangents`.
Neighbours share these curves, so that the surface is continuous. A quadrilateral is the Coons patch
of its four curves, a triangle the cubic patch that reproduces quadratic surfaces. Both are exact
for surfaces that are quadratic in their coordinates. A patch is given by its Bezier control points,
see `cpp/nts/geometry/patch.h`, which are linear in the nodes with constant weights of sum one.
Patches are therefore invariant under rigid motions, and planes stay plane.
"""

from functools import cached_property
from weakref import WeakKeyDictionary

from mpi4py import MPI

import basix
import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, GlobalInts, Ints
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.smooth.near_facets import NearFacets, local_edges
from dolfinx_nts.search.smooth.smooth_tangents import Tangents

__all__ = ["SmoothPatches", "flat_patch"]


class SmoothPatches:
    """Patches on the facets of a rank. Collective.

    Args:
        surface: The surface, of degree 1.

    Attributes:
        ids: Global numbers of the nodes of each facet: vertices in Basix order, then neighbours,
            padded with the first vertex, shape ``(s, m)``.
        owners: Ranks that own the nodes, shape ``(s, m)``.
        weights: Weights of these nodes in the ``c`` control points, shape ``(s, c, m)``.
    """

    ids: GlobalInts
    owners: Ints
    weights: Floats

    def __init__(self, surface: Surface) -> None:
        near = NearFacets.of(surface)
        vertices = near.facets[near.own]
        facet_edges = near.facet_edges[near.own]
        edges, number = np.unique(facet_edges, return_inverse=True)
        number = number.reshape(facet_edges.shape)
        tangents = Tangents.of(near, edges)
        nodes, weights = tangents.nodes[number], tangents.weights[number]
        # First vertices of the edges of facets, as in Basix.
        begins = [begin for begin, _ in local_edges(vertices.shape[1])]
        turned = near.edges[edges[number], 0] != vertices[:, begins]
        nodes[turned], weights[turned] = nodes[turned][:, ::-1], -weights[turned][:, ::-1]
        nodes, self.weights = _gathered(surface.V.mesh.comm, vertices, nodes, weights)
        self.ids, self.owners = near.dofs[nodes], near.owners[nodes]
        self._X = near.X[vertices]

    @cached_property
    def rise(self) -> Floats:
        """Weights of nodes in the vector from the mean of each facet to the mean of its patch.

        Shape ``(s, m)``; means are over the undeformed facet.
        """
        k, c = self._X.shape[1], self.weights.shape[1]
        cell = {2: "interval", 3: "triangle", 4: "quadrilateral"}[k]
        # Quadrature degree: patches on quadrilaterals have at most degree 4, the area degree 1.
        xi, weight = basix.make_quadrature(basix.CellType[cell], 5)
        linear = basix.create_element(basix.ElementFamily.P, basix.CellType[cell], 1)
        phi, *slopes = linear.tabulate(1, xi)[:, :, :, 0]
        first, *second = (np.einsum("qk,ski->sqi", slope, self._X) for slope in slopes)
        across = np.cross(first, second[0]) if second else first
        area = weight * np.linalg.norm(across, axis=2)
        area /= area.sum(axis=1, keepdims=True)
        places = np.column_stack([xi, np.zeros((len(xi), 2 - xi.shape[1]))])
        control = area @ _kernels.patch_functions(places, c)
        rise: Floats = np.einsum("sc,scm->sm", control, self.weights)
        rise[:, :k] -= area @ phi
        return rise

    @classmethod
    def of(cls, surface: Surface) -> "SmoothPatches":
        """Cached patches of a surface. Collective."""
        if surface not in _KNOWN:
            _KNOWN[surface] = cls(surface)
        return _KNOWN[surface]


# Cache of the patches of surfaces.
_KNOWN: WeakKeyDictionary[Surface, SmoothPatches] = WeakKeyDictionary()


def _gathered(comm: MPI.Comm, vertices: Ints, nodes: Ints, weights: Floats) -> tuple[Ints, Floats]:
    """Nodes of each facet, see `SmoothPatches`, and their weights in the control points.

    ``nodes`` and ``weights`` of tangents have shape ``(s, c, 2, m)``, see `Tangents`.
    """
    s, k = vertices.shape
    rows, length = k + 2 * nodes.shape[1], nodes.shape[3]
    nodes = np.column_stack([vertices, nodes.reshape(s, (rows - k) * length)])
    weights = np.column_stack([np.ones(vertices.shape), weights.reshape(s, (rows - k) * length)])
    row = np.concatenate([np.arange(k), np.repeat(np.arange(k, rows), length)])
    # Vertices come first, then other nodes by their numbers.
    rank = nodes.copy()
    for vertex in range(k):
        rank[nodes == vertices[:, [vertex]]] = vertex - k
    order = np.argsort(rank, axis=1, kind="stable")
    is_new = np.diff(np.take_along_axis(rank, order, axis=1), axis=1, prepend=-k) != 0
    place = np.empty_like(nodes)
    np.put_along_axis(place, order, np.cumsum(is_new, axis=1, dtype=place.dtype), axis=1)
    width = int(reductions.largest(comm, float(place.max(initial=0)))) + 1
    facet = np.arange(s)[:, None]
    own = np.repeat(vertices[:, :1], width, axis=1)
    own[facet, place] = nodes
    values = np.zeros((s, rows, width))
    np.add.at(values, (facet, row, place), weights)
    return own, _CONTROL[k] @ values


def _edge() -> Floats:
    """Weights of both ends and both tangents in the control points of a cubic curve."""
    return np.array([[1, 0, 0, 0], [1, 0, 1 / 3, 0], [0, 1, 0, -1 / 3], [0, 1, 0, 0]])


def _curves(k: int) -> list[Floats]:
    """Weights of vertices and tangents in the control points of each edge, ``(4, 3 k)``."""
    curves: list[Floats] = []
    for number, ends in enumerate(local_edges(k)):
        curve = np.zeros((4, 3 * k))
        curve[:, [*ends, k + 2 * number, k + 2 * number + 1]] = _edge()
        curves.append(curve)
    return curves


def _quadrilateral() -> Floats:
    """Weights of vertices and tangents in the control points i + 4 j of a Coons patch, (16, 12)."""
    bottom, left, right, top = _curves(4)
    points = np.zeros((4, 4, 12))  # j, i
    points[0], points[3], points[:, 0], points[:, 3] = bottom, top, left, right
    for i in (1, 2):
        for j in (1, 2):
            u, v = i / 3, j / 3
            ruled = (1 - v) * bottom[i] + v * top[i] + (1 - u) * left[j] + u * right[j]
            corners = (1 - v) * ((1 - u) * bottom[0] + u * bottom[3])
            corners += v * ((1 - u) * top[0] + u * top[3])
            points[j, i] = ruled - corners
    return points.reshape(16, 12)


def _triangle() -> Floats:
    """Weights of vertices and tangents in the control points of a triangle, see `patch.h`."""
    far, left, bottom = _curves(3)  # from vertex 1 to 2, 0 to 2, 0 to 1
    points = np.array([*bottom, left[1], np.zeros(9), far[1], left[2], far[2], left[3]])
    inner = [bottom[1], bottom[2], left[1], left[2], far[1], far[2]]
    corners = [bottom[0], bottom[3], left[3]]
    points[5] = 1.5 * np.mean(inner, axis=0) - 0.5 * np.mean(corners, axis=0)
    return points


# Weights of the vertices of a facet, and of the tangents at both ends of its edges, in control
# points, by the number of vertices.
_CONTROL = {2: _edge(), 3: _triangle(), 4: _quadrilateral()}


def flat_patch(k: int) -> Floats:
    """Weights of the ``k`` vertices in the control points of a flat patch, ``(c, k)``."""
    chords = [np.eye(k)[b] - np.eye(k)[a] for a, b in local_edges(k) for _ in range(2)]
    points: Floats = _CONTROL[k] @ np.array([*np.eye(k), *chords])
    return points
