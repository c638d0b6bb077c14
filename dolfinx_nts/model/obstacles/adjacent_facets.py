"""Adjacent facets of a surface, and selection of facets that are equally near to a point."""

from functools import cached_property

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Array, Flags, Floats, Ints
from dolfinx_nts.model.obstacles.rims import FACET_EDGES, SHARP
from dolfinx_nts.model.segments import area_vectors

__all__ = ["AdjacentFacets"]

# Largest difference of the distances of equally near facets, relative to the facet [-]. Smaller
# than 1e-11, the error of Newton's method: round-off chooses one of the facets. Larger: nodes next
# to an edge count as above it.
_EQUAL = 1e-8


class AdjacentFacets:
    """Facets of a surface, and their neighbours by common vertices. Local.

    In the methods ``points`` are positions of ``m`` points, shape ``(m, 3)`` [m], ``x`` positions
    of the vertices, shape ``(l, 3)`` [m], and ``facet`` one facet of each point, shape ``(m,)``.

    Args:
        facets: Vertices of each facet in Basix order, shape ``(s, k)``.
        orientation: +1 where a_1 x a_2 points outwards, otherwise -1, shape ``(s,)``.
        first: Offsets of groups of facets, shape ``(g + 1,)``. Facets of different groups are not
            adjacent even if they share vertices. None for one group.
    """

    def __init__(self, facets: Ints, orientation: Floats, first: Ints | None = None) -> None:
        self._facets, self._orientation, self._first = facets, orientation, first

    def as_near(self, points: Floats, x: Floats, facet: Ints, size: Floats) -> tuple[Ints, Ints]:
        """Find all facets that are as near to a point as its own facet, including that one.

        They share a vertex with the facet of the point, and the point is on the same side of them.
        Edges between them are blunter than 30 degrees, as sharper ones separate sides of the body.
        ``size`` is the diameter of the facet of each point, shape ``(m,)`` [m].

        Returns:
            Points with several such facets, ascending, and the facets, both of shape ``(e,)``.
        """
        row, other = self._around(facet)
        pairs = _kernels.with_vertices(points[row], x, self._facets, other)
        xi, gap, normal, _ = _kernels.project(pairs, self._orientation[other])
        away = np.where(_outside(xi, self._facets.shape[1]) <= 0, np.abs(gap), _from_edges(pairs))
        own = np.flatnonzero(other == facet[row])
        margin = _EQUAL * size[row]
        near = np.abs(away - away[own][row]) <= margin
        near &= (gap < -margin) == (gap[own][row] < -margin)
        alike = np.einsum("ei,ei->e", normal, normal[own][row]) >= SHARP
        # Facets across a vertex may be joined by others between them.
        (entries,) = (near & np.isin(row, row[near & ~alike])).nonzero()
        if len(entries):
            around = row[entries], other[entries], normal[entries]
            alike[entries] = self._joined(*around, alike[entries])
        near &= alike
        near &= np.bincount(row[near], minlength=len(facet))[row] > 1
        return row[near], other[near]

    def _joined(self, row: Ints, facet: Ints, normal: Floats, first: Flags) -> Flags:
        """Facets that edges blunter than 30 degrees join to the first ones, shape ``(k,)``.

        Args:
            row: Numbers of the points around which the facets are, ascending, shape ``(k,)``.
            facet: The facets, shape ``(k,)``.
            normal: Their unit normals, shape ``(k, 3)``.
            first: Flags of the facets with which the search starts, shape ``(k,)``.
        """
        one, two = _entries(row, row)
        corners = self._facets[facet]
        common = (corners[one][:, :, None] == corners[two][:, None, :]).sum(axis=(1, 2))
        blunt = (common > 1) & (np.einsum("pi,pi->p", normal[one], normal[two]) >= SHARP)
        one, two, reached = one[blunt], two[blunt], first.copy()
        while True:
            before = reached.copy()
            reached[one[before[two]]] = True
            if np.array_equal(reached, before):
                return reached

    def outside(self, points: Floats, x: Floats, facet: Ints) -> Floats:
        """Distances of projections outside facets in reference coordinates, ``(m,)`` [-]."""
        pairs = _kernels.with_vertices(points, x, self._facets, facet)
        return _outside(_kernels.project(pairs, self._orientation[facet])[0], pairs.shape[1] - 1)

    def are_nearer_to_adjacent(self, points: Floats, x: Floats, facet: Ints) -> Flags:
        """Whether points below their facets are less deep below an adjacent one, ``(m,)``.

        The adjacent facet turns away at a convex edge by 30 degrees or more. Points above it are
        not inside the body, and points less deep below it entered the body through it.
        """
        flags: Flags = np.zeros(len(facet), dtype=bool)
        used, index = np.unique(facet, return_inverse=True)
        which = index.astype(np.int32)
        own, other = self._turning_away(used, x)
        (near,) = np.isin(which, own).nonzero()
        gap = self._gaps(points[near], x, facet[near])
        near, gap = near[gap < 0], gap[gap < 0]
        place, beyond = _entries(own, which[near])
        row = near[place]
        flags[row[self._gaps(points[row], x, other[beyond]) > gap[place]]] = True
        return flags

    def _gaps(self, points: Floats, x: Floats, facet: Ints) -> Floats:
        """Gaps of points above facets, shape ``(m,)`` [m]."""
        pairs = _kernels.with_vertices(points, x, self._facets, facet)
        gap: Floats = _kernels.project(pairs, self._orientation[facet])[1]
        return gap

    def _turning_away(self, facet: Ints, x: Floats) -> tuple[Ints, Ints]:
        """Adjacent facets that turn away at a convex edge: ascending index and facet, ``(e,)``."""
        own, other = self._with_common_edge
        row, place = _entries(own, facet)
        own, other = own[place], other[place]
        (normal, middle), (of_other, beyond) = (
            (
                _kernels.unit_vectors(area_vectors(x[self._facets[each]], self._orientation[each])),
                x[self._facets[each]].mean(axis=1),
            )
            for each in (own, other)
        )
        turns = np.einsum("ei,ei->e", normal, of_other) < SHARP
        turns &= np.einsum("ei,ei->e", beyond - middle, normal) < 0
        return row[turns], other[turns]

    @cached_property
    def _with_common_edge(self) -> tuple[Ints, Ints]:
        """Pairs of facets with a common edge, by ascending first facet, both ``(e,)``."""
        own, other = self._around(np.arange(len(self._facets), dtype=np.int32))
        same = self._facets[own][:, :, None] == self._facets[other][:, None]
        at_edge = same.sum(axis=(1, 2)) == min(self._facets.shape[1] - 1, 2)
        return own[at_edge], other[at_edge]

    def have_common_vertices(self, facet: Ints, other: Ints) -> Flags:
        """Whether facets share vertices with the facets ``other``, shape ``(m,)``."""
        own, theirs = self._facets[facet], self._facets[other]
        flags: Flags = (own[:, :, None] == theirs[:, None]).any(axis=(1, 2))
        return flags

    @cached_property
    def _corners(self) -> tuple[Ints, Array]:
        """Facet corners sorted by vertex, and offset of the first corner of each vertex."""
        corners = self._facets.ravel()
        order = np.argsort(corners, kind="stable").astype(np.int32)
        return order, np.searchsorted(corners[order], np.arange(corners.max(initial=-1) + 2))

    def _around(self, facet: Ints) -> tuple[Ints, Ints]:
        """Neighbours of facets: ascending index of the facet and neighbour, both ``(e,)``."""
        vertices, width = self._facets[facet], len(self._facets)
        order, begin = self._corners
        corner, places = _expanded(begin[vertices].ravel(), begin[vertices + 1].ravel())
        other, row = order[places] // vertices.shape[1], corner // vertices.shape[1]
        row, other = np.divmod(np.unique(row.astype(np.int64) * width + other), width)
        if self._first is not None:
            group, of_other = (
                np.searchsorted(self._first, each, side="right") for each in (facet, other)
            )
            same = group[row] == of_other
            row, other = row[same], other[same]
        return row.astype(np.int32), other.astype(np.int32)


def _entries(ascending: Ints, values: Ints) -> tuple[Ints, Ints]:
    """Positions of values in sorted numbers: index of the value, and position, both ``(e,)``."""
    first = np.searchsorted(ascending, values, side="left")
    last = np.searchsorted(ascending, values, side="right")
    return _expanded(first, last)


def _expanded(first: Array, last: Array) -> tuple[Ints, Ints]:
    """Integers in half-open ranges [first, last): index of the range, and integer."""
    counts = last - first
    row = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    place = np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(len(row))
    return row, place.astype(np.int32)


def _outside(xi: Floats, num_vertices: int) -> Floats:
    """Distances of coordinates, ``(m, 2)``, from the reference facet, shape ``(m,)`` [-]."""
    if num_vertices == 2:
        xi = xi[:, :1]
    farthest = xi.sum(axis=1) if num_vertices == 3 else xi.max(axis=1, initial=-np.inf)
    result: Floats = np.fmax(-xi.min(axis=1, initial=np.inf), farthest - 1)
    return result


def _from_edges(pairs: Floats) -> Floats:
    """Distances of points from the edges of facets, ``(m,)``, for pairs ``(m, 1 + k, 3)`` [m]."""
    point, vertices = pairs[:, 0], pairs[:, 1:]
    distances = []
    for i, j in FACET_EDGES[vertices.shape[1]]:
        a, edge = point - vertices[:, i], vertices[:, j] - vertices[:, i]
        square = np.einsum("mi,mi->m", edge, edge)
        part = np.einsum("mi,mi->m", a, edge) / np.where(square > 0, square, 1.0)
        distances.append(np.linalg.norm(a - np.clip(part, 0, 1)[:, None] * edge, axis=1))
    nearest: Floats = np.min(distances, axis=0)
    return nearest
