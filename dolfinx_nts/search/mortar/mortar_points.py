"""Contact points of surface-to-surface contact: quadrature points of the facets of the nodes.

The points are chosen at some state of both surfaces. They then are material points of their facets,
each with one segment, see `cpp/nts/search/mortar_points.h`. A node of the surface that is a vertex
carries a multiplier, which acts at all points of the facets around it, weighted with the shape
function psi of the multiplier; its gap is the mean gap of these points.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Array, Floats, GlobalInts, Ints
from dolfinx_nts.model.kinematics import ContactKinematics
from dolfinx_nts.model.obstacles.facing import Facing
from dolfinx_nts.search.mortar.facet_candidates import rises

__all__ = ["MortarFacets", "MortarPoints", "Shares", "at_nodes"]

# Vertices of reference cells in their coordinates, by number.
_CORNERS = {
    2: np.array([[0.0, 0.0], [1.0, 0.0]]),
    3: np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
    4: np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]),
}

# Least fraction of the area of a node covered by segments [-] for which it carries a multiplier.
_LEAST_COVERED = 1e-6


@dataclass(frozen=True)
class MortarFacets:
    """Facets around the owned nodes of a surface, by nodes of a scatter's map.

    Attributes:
        nodes: Owned nodes, shape ``(n,)``.
        area: Approximate reference areas of the nodes that are vertices, shape ``(n,)`` [m^2].
        vertices: Nodes of the facets in Basix order, vertices first, shape ``(f, n)``.
        orientation: +1 where a_1 x a_2 points out of the body, otherwise -1, ``(f,)``.
        X: Reference positions of the nodes of the map, shape ``(l, 3)`` [m].
        is_axisymmetric: Whether the mesh is axisymmetric.
        facet_nodes: Nodes on which the points of the facets depend, shape ``(f, m)``: ``vertices``,
            or the nodes of the patches of a smooth surface.
        of_patches: Weights of these nodes in the control points of the patches, shape
            ``(f, c, m)``, and in the offset from facet to patch, ``(f, m)``, see
            `FacetCandidates`; None without patches.
    """

    nodes: Ints
    area: Floats
    vertices: Ints
    orientation: Floats
    X: Floats
    is_axisymmetric: bool
    facet_nodes: Ints
    of_patches: tuple[Floats, Floats] | None

    def rise(self, facet: Ints, x: Floats) -> Floats:
        """Offsets of points from the facets to the patches, shape ``(p, 3)`` [m]."""
        if self.of_patches is None:
            return np.zeros((len(facet), 3))
        return rises(self.of_patches[1], self.facet_nodes, facet, x)

    def patched(self, facet: Ints, phi: Floats) -> Floats:
        """Weights of patch nodes at points with shape functions ``phi`` of facets, ``(p, m)``."""
        if self.of_patches is None:
            return phi
        xi, weights = phi @ _CORNERS[phi.shape[1]], self.of_patches[0]
        values = _kernels.patch_functions(xi, weights.shape[1])
        patched: Floats = (values[:, None] @ weights[facet])[:, 0]
        return patched

    def shares(self, facet: Ints, weight: Floats, psi: Floats, key: GlobalInts) -> "Shares":
        """Weights of the nodes at ``p`` points, see `Shares`.

        Args:
            facet: Facet of each point, shape ``(p,)``.
            weight: Reference area of each, shape ``(p,)`` [m^2].
            psi: Shape functions of the multipliers of the vertices at the points, shape ``(p, k)``.
            key: Key of the segment of each point, shape ``(p,)``.
        """
        number = np.full(len(self.X), -1, dtype=np.int32)
        number[self.nodes] = np.arange(len(self.nodes), dtype=np.int32)
        on_facet = number[self.vertices[facet, : psi.shape[1]]]
        point, column = np.nonzero(on_facet >= 0)
        node, value = on_facet[point, column], weight[point] * psi[point, column]
        area = _sums(node, value, len(self.nodes))
        carries = area > _LEAST_COVERED * self.area
        # Sorted by nodes, and for each node the segment with the lowest key first.
        order = np.lexsort((point, key[point], node))
        order = order[carries[node[order]]]
        node, of_share = node[order], point[order].astype(np.int32)
        starts = _starts(np.bincount(node, minlength=len(area)))
        area = np.where(carries, area, 0.0)
        return Shares(self.nodes, area, starts, of_share, value[order] / area[node])


@dataclass(frozen=True)
class Shares:
    """Weights of ``m`` nodes with multipliers at ``p`` contact points, ``i`` entries. Local.

    A share is one entry for a node and a point: the reference area of the point times the shape
    function of the multiplier.

    Attributes:
        nodes: The nodes, shape ``(m,)``.
        area: Area on which the multiplier of each node acts, shape ``(m,)`` [m^2].
        start: Offsets of the shares of the nodes, shape ``(m + 1,)``.
        point: Points of the shares, shape ``(i,)``.
        value: Weight of the point in the mean of the node, shape ``(i,)`` [-].
    """

    nodes: Ints
    area: Floats
    start: GlobalInts
    point: Ints
    value: Floats

    @classmethod
    def none(cls, nodes: Ints) -> "Shares":
        """Create the shares of nodes that have no contact points."""
        no_points = np.empty(0, dtype=np.int32), np.empty(0)
        return cls(nodes, np.zeros(len(nodes)), _starts(np.zeros(len(nodes), int)), *no_points)

    @cached_property
    def node(self) -> Ints:
        """Node of each share, shape ``(i,)``."""
        return np.repeat(np.arange(len(self.area), dtype=np.int32), np.diff(self.start))

    def mean(self, values: Floats) -> Floats:
        """Mean of values at the points, ``(p,)``, for each node, NaN without points, ``(m,)``."""
        means = _sums(self.node, self.value * values[self.point], len(self.area))
        return np.where(self.area > 0, means, np.nan)

    def sums(self, values: Floats) -> Floats:
        """Sum of values of the shares, ``(i, ...)``, for each node, ``(m, ...)``."""
        return self.reduced(np.add, (self.value * values.T).T, 0.0)

    def reduced(self, by: np.ufunc, values: Array, none: float) -> Floats:
        """Reduce values of shares, ``(i, ...)``, for each node, ``(m, ...)``; ``none`` without."""
        result: Floats = np.full((len(self.area), *values.shape[1:]), none, dtype=values.dtype)
        carries = np.diff(self.start) > 0
        if carries.any():
            result[carries] = by.reduceat(values, self.start[:-1][carries], axis=0)
        return result

    def first(self, values: Ints) -> Ints:
        """Value at the first point of each node, ``(m,)``; -1 without points."""
        first = np.full(len(self.area), -1, dtype=np.int32)
        carries = self.area > 0
        first[carries] = values[self.point[self.start[:-1][carries]]]
        return first

    def spread(self, values: Floats, num_points: int) -> Floats:
        """Interpolate values of nodes, ``(m,)``, to the points by their shares, ``(p,)``."""
        return _sums(self.point, self.value * values[self.node], num_points)

    def take(self, nodes: Ints) -> tuple["Shares", Ints]:
        """Select the shares of some nodes; also return the points that remain."""
        counts = np.diff(self.start)[nodes]
        start = _starts(counts)
        entries = np.repeat(self.start[nodes] - start[:-1], counts) + np.arange(start[-1])
        used, point = np.unique(self.point[entries], return_inverse=True)
        of_nodes, of_shares = (self.nodes[nodes], self.area[nodes]), point.astype(np.int32)
        return Shares(*of_nodes, start, of_shares, self.value[entries]), used


@dataclass(frozen=True)
class MortarPoints:
    """Contact points of nodes, see `ContactPoints`. Local.

    Attributes:
        reached: Nodes on which facet and segment of each point depend,
            shape ``(p, m + n)``.
        phi: Weights of the nodes of the facet in the point, shape ``(p, m)``.
        segment: Candidate of each point, or the number of its plane, see
            `FacetCandidates.of_points`, shape ``(p,)``.
        offset: Reduction of the gap of each point by the shifts of patches, computed at the choice
            of the points and constant in the step, ``(p,)`` [m]; 0 without patches.
        patch: Number of the pair of facets of each point, from 0, shape ``(p,)``.
        shares: Shares of the nodes in the points.
    """

    reached: Ints
    phi: Floats
    segment: Ints
    offset: Floats
    patch: Ints
    shares: Shares

    @property
    def nodes(self) -> Ints:
        """Array of -1: no contact point is a node."""
        return np.full(len(self.segment), -1, dtype=np.int32)

    @property
    def facing(self) -> Facing:
        """No restriction: the choice of segments has already used the admissible directions."""
        return Facing.everywhere(len(self.segment))

    def of(self, values: Floats) -> Floats:
        """Evaluate a nodal field at the points, see `ContactPoints.of`."""
        return _kernels.at_points(self.phi, self.reached, values)

    def rows(self, values: Floats, parts: Floats) -> Floats:
        """Sum vectors of pairs, ``(p, c, 3 (1 + n))``, to rows of the nodes, ``(m, c, 3 d)``.

        ``parts`` are the weights of the vectors in the rows, by shares, shape ``(i, c, c)``.
        """
        s, (lists, place) = self.shares, self._rows
        of_shares = s.start, s.point, parts, place
        return _kernels.sum_rows(self.phi, *of_shares, lists.shape[1], values)

    @property
    def lists(self) -> Ints:
        """Nodes of each row, the node with the multiplier first, shape ``(m, d)``.

        Shorter rows repeat it.
        """
        return self._rows[0]

    @cached_property
    def _rows(self) -> tuple[Ints, Ints]:
        """Lists of nodes, and positions in them of the nodes of each share, ``(i, m + n)``."""
        shares = self.shares
        return _rows(shares.nodes, shares.node, self.reached[shares.point])

    def blocks(self, factor: Floats, matrix: Floats) -> Floats:
        """Sum matrices of pairs, ``(p, 3 (1 + n), 3 (1 + n))``, to matrices of pairs of facets.

        ``factor`` is the factor of each point, shape ``(p,)``; the result has the shape
        ``(b, 3 (m + n), 3 (m + n))``.
        """
        count = len(self.patch_nodes)
        return _kernels.sum_blocks(self.phi, self.patch, count, factor, matrix)

    @cached_property
    def patch_nodes(self) -> Ints:
        """Nodes of both facets of each pair of facets, shape ``(b, m + n)``."""
        return self.reached[np.unique(self.patch, return_index=True)[1]]

    def take(self, nodes: Ints) -> "MortarPoints":
        """Select the points of some nodes, see `ContactPoints.take`."""
        shares, used = self.shares.take(nodes)
        return self.only(used, shares)

    def only(self, points: Ints, shares: Shares) -> "MortarPoints":
        """Select some points, and the shares in these points."""
        patch = np.unique(self.patch[points], return_inverse=True)[1].astype(np.int32)
        of_points = self.segment[points], self.offset[points], patch
        return MortarPoints(self.reached[points], self.phi[points], *of_points, shares)


def at_nodes(
    points: MortarPoints, pairs: ContactKinematics
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Sum kinematics of the pairs of points for the nodes.

    Returns mean gaps at both ends, ``(m,)`` [m], rows of force and gradient, ``(m, 3 d)``, and the
    least cosine of the rotation of a normal, ``(m,)``.
    """
    s, (lists, place) = points.shares, points._rows
    of_shares = s.start, s.point, s.value, place, lists.shape[1]
    ends = pairs.gap_n + points.offset, pairs.gap + points.offset, pairs.turn
    return _kernels.sum_contact(points.phi, *of_shares, *ends, pairs.force, pairs.gradient)


def _sums(row: Array, values: Floats, num_rows: int) -> Floats:
    return np.bincount(row, values, minlength=num_rows).astype(np.float64, copy=False)


def _starts(counts: Array) -> GlobalInts:
    starts: GlobalInts = np.zeros(len(counts) + 1, dtype=np.int64)
    np.cumsum(counts, out=starts[1:])
    return starts


def _rows(own: Ints, row: Ints, nodes: Ints) -> tuple[Ints, Ints]:
    """Nodes of the rows, and positions of the nodes of shares in them, see `MortarPoints`.

    ``own`` is the first node of each row, shape ``(m,)``, ``row`` the row of each share, ``(i,)``,
    ``nodes`` the nodes on which the share depends, ``(i, m + n)``.
    """
    # The node of the row comes first, also in rows without shares.
    rank = np.where(nodes == own[row][:, None], 0, nodes.astype(np.int64) + 1)
    width = 1 + int(rank.max(initial=0))
    keys = np.concatenate([width * np.arange(len(own)), (width * row[:, None] + rank).ravel()])
    unique, inverse = np.unique(keys, return_inverse=True)
    in_row, node = np.divmod(unique, width)
    lengths = np.bincount(in_row, minlength=len(own))
    place = np.arange(len(unique)) - _starts(lengths)[in_row]
    lists = np.repeat(own[:, None], lengths.max(initial=1), axis=1).astype(np.int32)
    others = node > 0
    lists[in_row[others], place[others]] = node[others] - 1
    return lists, place[inverse[len(own) :]].reshape(nodes.shape).astype(np.int32)
