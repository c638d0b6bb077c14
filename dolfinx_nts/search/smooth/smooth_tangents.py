r"""Tangents of a smooth surface at its nodes, linear in the positions of neighbouring nodes.

Weights are computed in the reference configuration. At a node within a smooth part of the surface a
quadratic surface through the node is fitted to the nodes of adjacent facets by least squares. It
gives the derivatives x_u and x_v along two directions of the tangent plane. They are exact for
linear positions on any mesh, so that planes stay plane, and for quadratic ones if there are enough
nodes. At feature edges, such as free edges, and in the plane, the tangent belongs to the parabola
through the node and its two neighbours along the feature,

.. math:: (h_-^2 (x_+ - x) + h_+^2 (x - x_-)) / (h_- h_+ (h_- + h_+)),

which is the tangent of a circle through equidistant nodes. An edge with a tangent at one end only
gets the reflection of this tangent at the other end, which gives a parabola. An edge without
tangents is straight.
"""

from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.model.obstacles.rims import SHARP
from dolfinx_nts.search.smooth.near_facets import NearFacets

__all__ = ["Tangents"]

# Weight of the curvature relative to the misfit in the fit [-], for nodes with too few neighbours.
_SLIGHTLY = 1e-4


class Tangents(NamedTuple):
    """Tangents at both ends of edges, as weighted sums of nodes. Local.

    They are derivatives with respect to a parameter from 0 to 1 along the edge, from its first end
    to the second, with the length of the tangents of a circular arc.

    Attributes:
        nodes: Nodes, shape ``(e, 2, m)``, with possible repetitions.
        weights: Their weights, shape ``(e, 2, m)``.
    """

    nodes: Ints
    weights: Floats

    @classmethod
    def of(cls, near: NearFacets, edges: Ints) -> "Tangents":
        """Tangents of edges of facets of this rank."""
        ends = near.edges[edges]
        node, other = ends.ravel(), ends[:, ::-1].ravel()
        nodes, weights, has_own = _own(near, np.repeat(edges, 2), node, other)
        # Length as on a circular arc through both ends.
        sense = np.tile([1.0, -1.0], len(edges))
        tangent, chord = _vectors(near.X, nodes, weights), near.X[other] - near.X[node]
        length, distance = np.linalg.norm(tangent, axis=1), np.linalg.norm(chord, axis=1)
        length[~has_own] = 1.0
        cosine = np.einsum("hi,hi->h", tangent, chord) / (length * distance)
        weights *= (sense * 2 * distance / ((1 + cosine) * length))[:, None]
        # An edge without a tangent at one end uses the tangent at the other end.
        shape = len(edges), 2, nodes.shape[1]
        nodes, weights = nodes.reshape(shape), weights.reshape(shape)
        has_own = has_own.reshape(-1, 2)
        chord, tangent = chord[::2, None], _vectors(near.X, nodes, weights)
        part = 2 * (tangent * chord).sum(axis=2) / (chord**2).sum(axis=2)
        by_other = ~has_own & has_own[:, ::-1]
        nodes = np.where(by_other[:, :, None], nodes[:, ::-1], nodes)
        weights = np.where(by_other[:, :, None], -weights[:, ::-1], weights)
        along = np.where(by_other, part[:, ::-1], ~has_own & ~by_other)
        along = along[:, :, None] * [-1.0, 1.0]
        both = np.repeat(ends[:, None], 2, axis=1)
        return cls(np.dstack([both, nodes]), np.dstack([along, weights]))


def _own(near: NearFacets, edge: Ints, node: Ints, other: Ints) -> tuple[Ints, Floats, Flags]:
    """Derivatives at nodes in the direction of other nodes, where the surface is smooth.

    Returns:
        Nodes and their weights for a derivative of any length, shape ``(h, m)``, 0 where the
        surface is not smooth; and flags of smooth nodes, shape ``(h,)``.
    """
    features = near.edges[near.is_feature]
    count = np.bincount(features.ravel(), minlength=len(near.X))
    inside = np.unique(node[count[node] == 0])
    around, fits, frames = _fits(near, inside)
    nodes = np.repeat(node[:, None], max(3, around.shape[1]), axis=1)
    weights = np.zeros(nodes.shape)

    within = np.flatnonzero(count[node] == 0)
    fit, m = np.searchsorted(inside, node[within]), around.shape[1]
    u = np.einsum("hai,hi->ha", frames[fit], near.X[other[within]] - near.X[node[within]])
    nodes[within, :m], weights[within, :m] = around[fit], np.einsum("ha,ham->hm", u, fits[fit])

    along = np.flatnonzero(near.is_feature[edge] & (count[node] == 2))
    sums = np.zeros(len(near.X), dtype=node.dtype)
    np.add.at(sums, features, features[:, ::-1])
    three = np.column_stack([sums[node[along]] - other[along], node[along], other[along]])
    edges = np.diff(near.X[three], axis=1)
    h = np.linalg.norm(edges, axis=2)
    turns_smoothly = np.einsum("hi,hi->h", *edges.swapaxes(0, 1)) >= SHARP * h.prod(axis=1)
    along, three, h = along[turns_smoothly], three[turns_smoothly], h[turns_smoothly]
    (before, after), both = h.T, h.sum(axis=1)
    a, b = before / (after * both), after / (before * both)
    nodes[along, :3], weights[along, :3] = three, np.column_stack([-b, b - a, a])

    has_own = np.zeros(len(node), dtype=bool)
    has_own[within] = has_own[along] = True
    return nodes, weights, has_own


def _fits(near: NearFacets, inside: Ints) -> tuple[Ints, Floats, Floats]:
    """Derivatives x_u and x_v at nodes by a fit to neighbouring nodes.

    Returns:
        The neighbours and the node itself, with repetitions, shape ``(w, m)``; their weights,
        ``(w, 2, m)``; and the directions of u and v, ``(w, 2, 3)``.
    """
    X, facets = near.X, near.facets
    normals = np.zeros(X.shape)
    np.add.at(normals, facets, near.normals[:, None])
    frames = np.linalg.svd(normals[inside, None])[2][:, 1:]
    k = facets.shape[1]
    # Unique pairs of nodes of a facet.
    pairs = np.stack([np.repeat(facets, k, axis=1), np.tile(facets, k)], axis=2).reshape(-1, 2)
    pairs = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
    count = np.bincount(pairs[:, 0], minlength=len(X))
    first, count = (np.cumsum(count) - count)[inside], count[inside]
    around = np.repeat(inside[:, None], 1 + count.max(initial=0), axis=1)
    weights = np.zeros((len(inside), 2, around.shape[1]))
    for m in np.unique(count):
        some = np.flatnonzero(count == m)
        nodes = pairs[first[some, None] + np.arange(m), 1]
        offset = X[nodes] - X[inside[some], None]
        u, v = np.einsum("wai,wmi->awm", frames[some], offset)
        size = np.sqrt(np.mean(u**2 + v**2, axis=1))[:, None]
        u, v = u / size, v / size
        A = np.stack([u, v, u**2, u * v, v**2], axis=2)
        slight = np.broadcast_to(_SLIGHTLY * np.eye(5)[2:], (len(some), 3, 5))
        fit = np.linalg.pinv(np.concatenate([A, slight], axis=1))[:, :2, :m] / size[:, None]
        around[some, :m], weights[some, :, :m] = nodes, fit
    weights[:, :, -1] = -weights.sum(axis=2)  # weight of the node itself
    return around, weights, frames


def _vectors(X: Floats, nodes: Ints, weights: Floats) -> Floats:
    """Weighted sums of positions, shape ``(..., 3)`` [m]."""
    vectors: Floats = np.einsum("...m,...mi->...i", weights, X[nodes])
    return vectors
