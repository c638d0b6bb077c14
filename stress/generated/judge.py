"""Geometric judge: overlap and distance of bodies by brute force over their boundaries.

It needs NumPy only, and no function of the package. Bodies are inside each other where the
winding number of a boundary around points of the other boundary is one.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Boundary", "boundary_of_cells", "column_force", "nodal_mass"]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Facets of cells by their vertices, in the order of Basix.
_FACETS = {
    (2, 3): [[0, 1], [0, 2], [1, 2]],
    (2, 4): [[0, 1], [0, 2], [1, 3], [2, 3]],
    (3, 4): [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]],
    (3, 8): [
        [0, 1, 2, 3],
        [0, 1, 4, 5],
        [0, 2, 4, 6],
        [1, 3, 5, 7],
        [2, 3, 6, 7],
        [4, 5, 6, 7],
    ],
}
# Number of decimals to which coordinates of one node agree [m].
_DECIMALS = 8


@dataclass(frozen=True)
class Boundary:
    """Closed boundary of a body, as edges in the plane or triangles in space.

    Attributes:
        weights: Points of the boundary as sums of nodes, shape ``(p, n)`` [-].
        simplices: Points of each edge or triangle, oriented outward, shape ``(s, d)``.
        facet: Facet of each simplex, shape ``(s,)``.
        nodes: Nodes that are vertices of each facet, shape ``(f, k)``.
    """

    weights: Array
    simplices: Ints
    facet: Ints
    nodes: Ints

    def simplices_at(self, x: Array) -> Array:
        """Positions of the vertices of simplices, shape ``(s, d, d)`` [m]."""
        return (self.weights @ x)[self.simplices]

    def samples(self, x: Array) -> Array:
        """Vertices, middles and quarters of the edges of simplices, shape ``(m, d)`` [m]."""
        points, corners = self.weights @ x, self.simplices_at(x)
        between = [points]
        for i in range(corners.shape[1]):
            first, second = corners[:, i - 1], corners[:, i]
            between += [(1 - s) * first + s * second for s in (0.25, 0.5, 0.75)]
        between.append(corners.mean(axis=1))
        return np.unique(np.round(np.concatenate(between), 12), axis=0)

    def depth(self, x: Array, points: Array) -> Array:
        """Distance of points from the boundary inside of it, 0 outside, ``(m,)`` [m]."""
        simplices = self.simplices_at(x)
        is_near = np.all((points > simplices.min((0, 1))) & (points < simplices.max((0, 1))), 1)
        depth = np.zeros(len(points))
        if is_near.any():
            inside = _winding(points[is_near], simplices) > 0.5
            depth[is_near] = np.where(inside, _distance(points[is_near], simplices), 0.0)
        return depth

    def distance(self, x: Array, points: Array) -> Array:
        """Distance of points from the boundary, shape ``(m,)`` [m]."""
        return _distance(points, self.simplices_at(x))

    def patch(self, x: Array, node: int) -> Array:
        """Sample points of the facets around a node, shape ``(m, d)`` [m]."""
        around = np.flatnonzero(np.any(self.nodes == node, axis=1))
        some = Boundary(
            self.weights, self.simplices[np.isin(self.facet, around)], self.facet, self.nodes
        )
        corners = some.simplices_at(x)
        fractions = np.array(np.meshgrid(*[np.linspace(0, 1, 5)] * (x.shape[1] - 1)))
        fractions = fractions.reshape(x.shape[1] - 1, -1).T
        fractions = fractions[fractions.sum(axis=1) <= 1]
        barycentric = np.column_stack([1 - fractions.sum(axis=1), fractions])
        return np.einsum("qk,ski->sqi", barycentric, corners).reshape(-1, x.shape[1])


def boundary_of_cells(X: Array, cells: Ints, own: Ints, degree: int) -> Boundary:
    """Find the boundary of cells.

    Args:
        X: Nodes of the displacement in the reference configuration, shape ``(n, d)`` [m].
        cells: Nodes at the vertices of each cell, in the order of Basix, shape ``(c, k)``.
        own: Nodes of the body.
        degree: Of the displacement; at degree 2 middle nodes are found by their coordinates.

    Returns:
        Its boundary: faces with four vertices are split around their centres.
    """
    dim = X.shape[1]
    local = np.array(_FACETS[dim, cells.shape[1]])
    facets = cells[:, local].reshape(-1, local.shape[1])
    owner = np.repeat(np.arange(len(cells)), len(local))
    _, first, count = np.unique(
        np.sort(facets, axis=1), axis=0, return_index=True, return_counts=True
    )
    facets, owner = facets[first[count == 1]], owner[first[count == 1]]
    rows: list[Array] = []
    numbers: dict[bytes, int] = {}
    node_at = {tuple(np.round(X[i], _DECIMALS) + 0.0): i for i in own}

    def point(corners: Ints, share: Array) -> int:
        """Number of the sample point at a position of a facet of degree 1."""
        place = tuple(np.round(share @ X[corners], _DECIMALS) + 0.0)
        row = np.zeros(len(X))
        if degree == 2 and place in node_at and np.count_nonzero(share) != 1:
            row[node_at[place]] = 1.0
        else:
            np.add.at(row, corners, share)
        key = row.tobytes()
        if key not in numbers:
            numbers[key] = len(rows)
            rows.append(row)
        return numbers[key]

    simplices, facet = [], []
    for f, corners in enumerate(facets):
        for shares in _pieces(len(corners), degree):
            ids = [point(corners, share) for share in shares]
            simplices.append(ids)
            facet.append(f)
    weights, pieces = np.array(rows), np.array(simplices)
    at = (weights @ X)[pieces]
    away = at.mean(axis=1) - X[cells[owner]].mean(axis=1)[facet]
    turned = np.einsum("si,si->s", _normals(at), away) < 0
    pieces[turned] = pieces[turned][:, ::-1]
    return Boundary(weights, pieces, np.array(facet), facets)


def _pieces(k: int, degree: int) -> list[Array]:
    """Subdivision of a facet with k vertices into simplices, as weights of the vertices."""
    unit = np.eye(k)
    if k == 2:
        middle = unit.mean(axis=0)
        return [unit] if degree == 1 else [np.array([unit[0], middle]), np.array([middle, unit[1]])]
    if k == 3:
        if degree == 1:
            return [unit]
        a, b, c = (unit[[0, 1]].mean(0), unit[[1, 2]].mean(0), unit[[0, 2]].mean(0))
        corners = [(unit[0], a, c), (unit[1], b, a), (unit[2], c, b), (a, b, c)]
        return [np.array(some) for some in corners]
    ring = unit[[0, 1, 3, 2]]
    centre = unit.mean(axis=0)
    if degree == 1:
        return [np.array([ring[i - 1], ring[i], centre]) for i in range(4)]
    middles = [(ring[i - 1] + ring[i]) / 2 for i in range(4)]
    halves = []
    for i in range(4):
        halves += [np.array([ring[i - 1], middles[i], centre])]
        halves += [np.array([middles[i], ring[i], centre])]
    return halves


def _normals(simplices: Array) -> Array:
    """Normals of simplices, of any length."""
    if simplices.shape[1] == 2:
        along = simplices[:, 1] - simplices[:, 0]
        return np.column_stack([along[:, 1], -along[:, 0]])
    return np.cross(simplices[:, 1] - simplices[:, 0], simplices[:, 2] - simplices[:, 0])


def _winding(points: Array, simplices: Array) -> Array:
    """Winding number of outward simplices around points."""
    r = simplices[None] - points[:, None, None]  # (m, s, d, d)
    if points.shape[1] == 2:
        a, b = r[:, :, 0], r[:, :, 1]
        turn = np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], np.sum(a * b, axis=-1))
        return np.asarray(turn.sum(axis=1) / (2 * np.pi))
    a, b, c = r[:, :, 0], r[:, :, 1], r[:, :, 2]
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    volume = np.einsum("msi,msi->ms", a, np.cross(b, c))
    scalar = la * lb * lc + np.sum(a * b, -1) * lc + np.sum(b * c, -1) * la + np.sum(c * a, -1) * lb
    return np.asarray(np.arctan2(volume, scalar).sum(axis=1) / (2 * np.pi))


def _distance(points: Array, simplices: Array) -> Array:
    """Distance of points from the nearest simplex."""
    p = points[:, None]
    if points.shape[1] == 2:
        return np.asarray(_to_edge(p, simplices[None, :, 0], simplices[None, :, 1]).min(axis=1))
    a, b, c = (simplices[None, :, i] for i in range(3))
    nearest = np.minimum(np.minimum(_to_edge(p, a, b), _to_edge(p, b, c)), _to_edge(p, c, a))
    e, f, r = b - a, c - a, p - a
    ee, ef, ff = (np.sum(u * v, axis=-1) for u, v in ((e, e), (e, f), (f, f)))
    er, fr = np.sum(e * r, axis=-1), np.sum(f * r, axis=-1)
    area = ee * ff - ef * ef
    area = np.where(area > 0, area, np.inf)
    s, t = (ff * er - ef * fr) / area, (ee * fr - ef * er) / area
    over = (s >= 0) & (t >= 0) & (s + t <= 1) & np.isfinite(area)
    height = np.abs(np.sum(np.cross(e, f) * r, axis=-1)) / np.sqrt(area)
    return np.asarray(np.where(over, np.minimum(height, nearest), nearest).min(axis=1))


def _to_edge(p: Array, a: Array, b: Array) -> Array:
    """Distance of points from edges."""
    along = b - a
    square = np.sum(along**2, axis=-1)
    s = np.sum((p - a) * along, axis=-1) / np.where(square > 0, square, 1)
    return np.asarray(np.linalg.norm(p - a - np.clip(s, 0, 1)[..., None] * along, axis=-1))


def column_force(stretch: float, modulus: float, area: float) -> float:
    """Force in a neo-Hookean column without lateral contraction [N].

    Its energy is ``mu / 2 (I1 - 3 - 2 ln J)``, with ``mu = E / 2`` as Poisson's ratio is 0.
    """
    return modulus / 2 * (stretch - 1 / stretch) * area


def nodal_mass(X: Array, cells: Ints) -> Array:
    """Lumped volume of the nodes of cells of degree 1, shape ``(n,)`` [m^d].

    Exact for simplices, parallelograms and parallelepipeds.
    """
    dim = X.shape[1]
    corners = X[cells]
    axes = [1, 2, 3] if cells.shape[1] == dim + 1 else [1, 2, 4]
    edges = corners[:, axes[:dim]] - corners[:, :1]
    factor = {(2, 3): 2.0, (3, 4): 6.0}.get((dim, cells.shape[1]), 1.0)
    volume = np.abs(np.linalg.det(edges)) / factor
    mass = np.zeros(len(X))
    np.add.at(mass, cells.ravel(), np.repeat(volume / cells.shape[1], cells.shape[1]))
    return mass
