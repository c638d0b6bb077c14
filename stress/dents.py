"""Dents: admissible depth of an active node below the facet adjacent to its segment."""

from typing import Any

import numpy as np

import dolfinx_nts as nts
from dolfinx_nts.contact.implicit.local_search import STATIC_OVERHANG
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.segments import area_vectors, diameters

__all__ = ["below_the_next_facet"]


def below_the_next_facet(stepper: Any) -> float:
    """Admissible depth of nodes in static equilibrium in the current state [m]. Collective.

    A node without inertia touches one facet, with a closed gap, and may be beyond its edge by a
    part of its size, `STATIC_OVERHANG`. In a dent the next facet turns up there: the node
    is below it by that way times the sine of the angle between the two.
    """
    surfaces = [
        pair.segments
        for pair in stepper.pairs
        if pair.method == "node-to-segment" and not isinstance(pair.segments, Obstacle)
    ]
    return max((_deepest(surface, stepper.x) for surface in surfaces), default=0.0)


def _deepest(surface: nts.Surface, x: Any) -> float:
    """Depth below facets of a surface at positions ``x`` of the local nodes, (l, 3) [m]."""
    index_map, comm = surface.V.dofmap.index_map, surface.V.mesh.comm
    ids = index_map.local_to_global(surface.segments.ravel()).reshape(surface.segments.shape)
    own = ids, x[surface.segments], surface.orientation
    ids, vertices, orientation = (
        np.concatenate(parts) for parts in zip(*comm.allgather(own), strict=True)
    )
    normals = area_vectors(vertices, orientation)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    middles = vertices.mean(axis=1)
    share_a_node = (ids[:, None, :, None] == ids[None, :, None, :]).any(axis=(2, 3))
    one, other = np.nonzero(share_a_node)
    turn = normals[other] - normals[one]
    is_dent = np.einsum("pi,pi->p", turn, middles[other] - middles[one]) < 0
    sine = np.linalg.norm(np.cross(normals[one], normals[other]), axis=1)
    depth = STATIC_OVERHANG * diameters(vertices)[one] * sine
    return float(depth[is_dent].max(initial=0.0))
