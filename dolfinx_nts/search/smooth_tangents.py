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

from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.model.rims import SHARP
from dolfinx_nts.search.near_facets import NearFacets

__all__ = ["Tangents"]

# What curvature counts in a fit, relative to the misfit, where nodes do not tell it [-].
_SLIGHTLY = 1e-4


class Tangents(NamedTuple):
    """Tangents at both ends of edges, sums of nodes with weights. Local.

    They are derivatives by a parameter from 0 to 1 along the edge, as long as on a circle, in the
    sense from its first end to the second.

    Attributes:
        nodes: Shape ``(e, 2, m)``, each node possibly several times.
        weights: Shape ``(e, 2, m)``.
    """

    nodes: Ints
    weights: Floats

    @classmethod
    def of(cls, near: NearFacets, edges: Ints) -> "Tangents":
        """Find the tangents of edges, which are some of those at facets of this rank."""
        ends = near.edges[edges]
        node, other = ends.ravel(), ends[:, ::-1].ravel()
        nodes, weights, has_own = _own(near, np.repeat(edges, 2), node, other)
        # As long as on a circle through both ends.
        sense = np.tile([1.0, -1.0], len(edges))
        tangent, chord = _vectors(near.X, nodes, weights), near.X[other] - near.X[node]
        length, distance = np.linalg.norm(tangent, axis=1), np.linalg.norm(chord, axis=1)
        length[~has_own] = 1.0
        cosine = np.einsum("hi,hi->h", tangent, chord) / (length * distance)
        weights *= (sense * 2 * distance / ((1 + cosine) * length))[:, None]
        # Those that have none, from those of the other end.
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
    """Derivatives at nodes in the direction of others, where the surface is smooth there.

    Returns:
        Nodes and their weights, of any length, shape ``(h, m)``, zero where it is not; and where
        it is, shape ``(h,)``.
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
    ways = np.diff(near.X[three], axis=1)
    h = np.linalg.norm(ways, axis=2)
    turns_smoothly = np.einsum("hi,hi->h", *ways.swapaxes(0, 1)) >= SHARP * h.prod(axis=1)
    along, three, h = along[turns_smoothly], three[turns_smoothly], h[turns_smoothly]
    (before, after), both = h.T, h.sum(axis=1)
    a, b = before / (after * both), after / (before * both)
    nodes[along, :3], weights[along, :3] = three, np.column_stack([-b, b - a, a])

    has_own = np.zeros(len(node), dtype=bool)
    has_own[within] = has_own[along] = True
    return nodes, weights, has_own


def _fits(near: NearFacets, inside: Ints) -> tuple[Ints, Floats, Floats]:
    """Derivatives x_u and x_v at nodes by those around.

    Returns:
        The nodes around and the node itself, possibly several times, shape ``(w, m)``; their
        weights, ``(w, 2, m)``; and the directions of u and v, ``(w, 2, 3)``.
    """
    X, facets = near.X, near.facets
    normals = np.zeros(X.shape)
    np.add.at(normals, facets, near.normals[:, None])
    frames = np.linalg.svd(normals[inside, None])[2][:, 1:]
    k = facets.shape[1]
    # Each node of a facet with each other one, once.
    pairs = np.stack([np.repeat(facets, k, axis=1), np.tile(facets, k)], axis=2).reshape(-1, 2)
    pairs = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
    count = np.bincount(pairs[:, 0], minlength=len(X))
    first, count = (np.cumsum(count) - count)[inside], count[inside]
    around = np.repeat(inside[:, None], 1 + count.max(initial=0), axis=1)
    weights = np.zeros((len(inside), 2, around.shape[1]))
    for m in np.unique(count):
        some = np.flatnonzero(count == m)
        nodes = pairs[first[some, None] + np.arange(m), 1]
        way = X[nodes] - X[inside[some], None]
        u, v = np.einsum("wai,wmi->awm", frames[some], way)
        size = np.sqrt(np.mean(u**2 + v**2, axis=1))[:, None]
        u, v = u / size, v / size
        A = np.stack([u, v, u**2, u * v, v**2], axis=2)
        slight = np.broadcast_to(_SLIGHTLY * np.eye(5)[2:], (len(some), 3, 5))
        fit = np.linalg.pinv(np.concatenate([A, slight], axis=1))[:, :2, :m] / size[:, None]
        around[some, :m], weights[some, :, :m] = nodes, fit
    weights[:, :, -1] = -weights.sum(axis=2)  # of the node itself
    return around, weights, frames


def _vectors(X: Floats, nodes: Ints, weights: Floats) -> Floats:
    """Sums of positions with weights, shape ``(..., 3)`` [m]."""
    vectors: Floats = np.einsum("...m,...mi->...i", weights, X[nodes])
    return vectors
