r"""Tangents of a smooth surface at its nodes, linear in the positions of nodes around.

Weights belong to the reference configuration. At a node within a smooth part of the surface
the derivatives x_u and x_v along two directions of its tangent plane are those of the quadratic
surface through the node that fits the nodes of the facets around it best: they are exact where
positions are linear in u and v, whatever the mesh, so that planes stay planes, and where they
are quadratic, where there are enough nodes. Where an edge is a feature, as at rims, or in the
plane, the tangent is that of the parabola through the node and the two next ones along the
feature,

.. math:: (h_-^2 (x_+ - x) + h_+^2 (x - x_-)) / (h_- h_+ (h_- + h_+)),

which on a circle is the tangent of the circle. An edge that has no such tangent at one end has
that of the other end, reflected: it is an arc of a parabola; and one that has none at both ends
is straight.
"""

from functools import cached_property

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.rims import SHARP
from dolfinx_nts.search.whole_surface import WholeSurface

__all__ = ["Row", "SmoothTangents"]

# Numbers of nodes, and their weights.
Row = tuple[Ints, Floats]

# What curvature counts in a fit, relative to the misfit, where nodes do not tell it [-].
_SLIGHTLY = 1e-4


class SmoothTangents:
    """Tangents of edges at their ends. Local.

    Args:
        whole: The surface.
    """

    def __init__(self, whole: WholeSurface) -> None:
        """Find what is around each node."""
        self._whole, n = whole, len(whole.X)
        feature = np.flatnonzero(whole.is_feature).astype(np.int32)
        self._features = _lists(whole.edges[feature], feature, n)
        facets = np.arange(len(whole.facets), dtype=np.int32)
        self._facets = _lists(whole.facets, facets, n)
        self._known: dict[tuple[int, int], Row | None] = {}

    def at(self, edge: int, end: int) -> Row:
        """Tangent of an edge at one of its ends, 0 or 1, in the sense from 0 to 1.

        It is the derivative by a parameter from 0 to 1, as long as on a circle.
        """
        own = self._own(edge, end)
        if own is not None:
            return own
        start, stop = self._whole.edges[edge]
        along = np.array([start, stop], dtype=np.int32), np.array([-1.0, 1.0])
        other = self._own(edge, 1 - end)
        if other is None:
            return along
        chord = self._vector(along)
        part = 2 * float(self._vector(other) @ chord) / float(chord @ chord)
        return _sum(along, other, part, -1.0)

    def _own(self, edge: int, end: int) -> Row | None:
        """Tangent that the surface has at an end of an edge, if it is smooth there."""
        if (edge, end) not in self._known:
            self._known[edge, end] = self._find(edge, end)
        return self._known[edge, end]

    def _find(self, edge: int, end: int) -> Row | None:
        whole = self._whole
        node, other = whole.edges[edge, end], whole.edges[edge, 1 - end]
        sense = 1.0 - 2.0 * end
        features = self._features[node]
        row: Row | None = None
        if len(features) == 0:
            row = self._within(node, other)
        elif whole.is_feature[edge] and len(features) == 2:
            row = self._along(node, other, features[features != edge][0])
        if row is None:
            return None
        # As long as on a circle through both ends.
        tangent, chord = self._vector(row), whole.X[other] - whole.X[node]
        length, distance = np.linalg.norm(tangent), np.linalg.norm(chord)
        cosine = float(tangent @ chord) / (length * distance)
        nodes, weights = row
        return nodes, sense * 2 * distance / ((1 + cosine) * length) * weights

    def _within(self, node: int, other: int) -> Row:
        """Derivative at a node of a smooth part in the direction of another one."""
        whole = self._whole
        nodes, fit, frame = self._fits[node]
        u = frame @ (whole.X[other] - whole.X[node])
        return nodes, u @ fit

    def _along(self, node: int, other: int, edge: int) -> Row | None:
        """Derivative along a feature in the direction of one neighbour, if it turns smoothly."""
        whole = self._whole
        before = whole.edges[edge].sum() - node
        X = whole.X[[before, node, other]]
        (back, ahead), h = np.diff(X, axis=0), np.linalg.norm(np.diff(X, axis=0), axis=1)
        if back @ ahead < SHARP * h[0] * h[1]:
            return None
        a, b = h[0] / (h[1] * h.sum()), h[1] / (h[0] * h.sum())
        return np.array([before, node, other], dtype=np.int32), np.array([-b, b - a, a])

    @cached_property
    def _fits(self) -> "_Fits":
        return _Fits(self._whole, self._facets)

    def _vector(self, row: Row) -> Floats:
        """A tangent in the reference configuration [m]."""
        nodes, weights = row
        vector: Floats = weights @ self._whole.X[nodes]
        return vector


class _Fits(dict[int, tuple[Ints, Floats, Floats]]):
    """Derivatives x_u and x_v at nodes by those around: nodes, ``(2, m)`` weights, frame."""

    def __init__(self, whole: WholeSurface, facets: list[Ints]) -> None:
        super().__init__()
        self._whole, self._facets, self._normals = whole, facets, whole.normals

    def __missing__(self, node: int) -> tuple[Ints, Floats, Floats]:
        whole, around = self._whole, self._facets[node]
        normal = self._normals[around].sum(axis=0)
        frame = np.linalg.svd(normal[None, :])[2][1:]
        nodes = np.unique(whole.facets[around])
        nodes = nodes[nodes != node].astype(np.int32)
        u, v = frame @ (whole.X[nodes] - whole.X[node]).T
        size = np.sqrt(np.mean(u**2 + v**2))
        u, v = u / size, v / size
        A = np.column_stack([u, v, u**2, u * v, v**2])
        slight = _SLIGHTLY * np.eye(5)[2:]
        weights = np.linalg.pinv(np.vstack([A, slight]))[:2, : len(nodes)] / size
        nodes = np.append(nodes, node).astype(np.int32)
        weights = np.column_stack([weights, -weights.sum(axis=1)])
        self[node] = nodes, weights, frame
        return self[node]


def _sum(first: Row, second: Row, a: float, b: float) -> Row:
    """Combine two rows with the factors a and b."""
    nodes, place = np.unique(np.concatenate([first[0], second[0]]), return_inverse=True)
    weights: Floats = np.zeros(len(nodes))
    np.add.at(weights, place, np.concatenate([a * first[1], b * second[1]]))
    return nodes.astype(np.int32), weights


def _lists(nodes: Ints, values: Ints, count: int) -> list[Ints]:
    """Values at each of ``count`` nodes, by the nodes of each value, shape ``(v, c)``."""
    order = np.argsort(nodes.ravel(), kind="stable")
    bounds = np.cumsum(np.bincount(nodes.ravel(), minlength=count))[:-1]
    return np.split(np.repeat(values, nodes.shape[1])[order], bounds)
