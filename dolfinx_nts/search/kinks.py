"""Turning of a surface at its nodes: convex edges and corners, and convex curvature."""

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.obstacles.rims import SHARP
from dolfinx_nts.model.segments import area_vectors, diameters
from dolfinx_nts.model.surfaces import Surface, facing_segments
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.search.nodal_facets import NodalFacets

__all__ = ["arc_length", "nodes_on_kinks"]

# Angle by which a round surface turns below a facet [rad] above which the mean gap of the facet
# does not describe the contact. Larger: forces on bars bent over rigid rollers are too small, by
# 12 % where it is 0.5; smaller: nodes of the rigid surface, whose pressures scatter, where facets
# of the other body would do, with an error of 2 % at 0.2.
_TURNED = 0.25
# Fraction of plane nodes [-] up to which a surface counts as round. Larger: plane tools with
# rounded edges count as round; smaller, from 0.5 on: round surfaces of straight facets of degree 2,
# whose mid-nodes are plane, count as plane.
_MOST = 0.6
# Angle between facets of a plane due to round-off [rad].
_ROUND_OFF = 1e-6


class _Turn(NamedTuple):
    """Two facets around each of ``n`` nodes in the reference configuration.

    Attributes:
        cosine: Cosine of the angle between their normals, shape ``(n,)`` [-].
        distance: Distance of their centres, shape ``(n,)`` [m].
        is_convex: Whether one of them is behind the plane of the other one, ``(n,)``.
    """

    cosine: Floats
    distance: Floats
    is_convex: Flags


def nodes_on_kinks(surface: Surface) -> tuple[Flags, Floats]:
    """Find the owned nodes at which the surface turns by 30 degrees or more. Collective.

    In the reference configuration the normals of two facets around such a node differ by at least
    this angle, and one facet is behind the plane of the other one. Facets beyond a free edge of the
    surface are unknown.

    Args:
        surface: The surface.

    Returns:
        Flags of the owned nodes, shape ``(n,)``, and diameter of the smallest facet around each,
        shape ``(n,)`` [m].
    """
    turns, smallest = _turns(surface)
    flags = np.zeros(len(smallest), dtype=bool)
    for turn in turns:
        flags |= (turn.cosine < SHARP) & turn.is_convex
    return flags, smallest


def arc_length(surface: Surface, *others: Surface) -> float:
    """Length on which a round convex surface turns by a quarter radian. Collective.

    Edges and corners do not count.

    Args:
        surface: The surface.
        others: Surfaces; only facets that face these count, see `facing_segments`.

    Returns:
        The length [m]; infinite if three fifths of the nodes of these facets are on plane or
        concave ones.
    """
    comm, (_, faces) = surface.V.mesh.comm, facing_segments(surface, *others)
    first, (turns, smallest) = comm.exscan(len(surface.segments)) or 0, _turns(surface)
    some = surface.segments[faces[first : first + len(surface.segments)]]
    curvature: Floats = np.zeros(len(smallest))
    for turn in turns:
        angle = np.arccos(np.clip(turn.cosine, SHARP, 1.0))
        is_round = turn.is_convex & (turn.cosine > SHARP) & (turn.distance > 0)
        own = np.divide(angle, turn.distance, out=np.zeros_like(angle), where=is_round)
        curvature = np.fmax(curvature, own)
    of_all = joined(comm, curvature[np.isin(surface.nodes, some)])
    # At degree 2 half of the nodes are on straight facets.
    most = float(np.quantile(of_all, _MOST)) if len(of_all) else 0.0
    return _TURNED / most if most > _ROUND_OFF / surface.size else np.inf


def _turns(surface: Surface) -> tuple[Iterator[_Turn], Floats]:
    """Pairs of facets around the owned nodes, and smallest diameters, ``(n,)`` [m]. Collective."""
    around = NodalFacets.of(surface).around
    x = around.scatter.forward(reference_positions(surface.V))
    corners = x[around.vertices]
    vectors = area_vectors(corners, around.orientation)
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    normals, centres = vectors / np.where(length > 0, length, 1.0), corners.mean(axis=1)
    n, most = len(around.counts), int(around.counts.max(initial=0))
    # Facets of each node, with rows padded by the first facet.
    first = np.cumsum([0, *around.counts])[:-1]
    place = np.minimum(np.arange(most), around.counts[:, None] - 1)
    table = around.facets[first[:, None] + place] if n else np.empty((0, most), dtype=np.int32)

    def turn(i: int, j: int) -> _Turn:
        normal, beyond = normals[table[:, i]], centres[table[:, j]] - x[around.nodes]
        return _Turn(
            np.einsum("ni,ni->n", normal, normals[table[:, j]]),
            np.linalg.norm(centres[table[:, j]] - centres[table[:, i]], axis=1),
            np.einsum("ni,ni->n", normal, beyond) < 0,
        )

    smallest = diameters(corners)[table].min(axis=1) if n else np.empty(0)
    return (turn(i, j) for i, j in combinations(range(most), 2)), smallest
