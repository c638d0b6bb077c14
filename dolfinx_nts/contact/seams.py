"""Seams: the facets between bodies that cannot move relative to each other.

Such bodies are tied, or rigid with equal guides. Nothing can touch facets on a seam, but a node
that slides over the seam with a small penetration would get them as segments.
"""

from collections.abc import Callable, Sequence
from copy import copy
from itertools import combinations

import numpy as np
from dolfinx.mesh import compute_midpoints

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.enforcement import Tied
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.closed_boundaries import closed_boundaries
from dolfinx_nts.model.connected_bodies import connected
from dolfinx_nts.model.rigid_body import RigidBody
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.search.overlap.inside import Insides

__all__ = ["with_surfaces", "without_seams"]

# Distance in front of a facet within which another body covers it, relative to the distance between
# the midpoints of facet and cell [-]. Larger: gaps between fastened bodies, which nodes may enter,
# count as seams; smaller: facets of curved seams with meshes that do not match are missed.
_IN_FRONT = 0.1


def without_seams(bodies: Sequence[Body], pairs: Sequence[ContactPair]) -> tuple[ContactPair, ...]:
    """Leave out facets on seams of bodies that are tied, or rigid with equal guides. Collective.

    Args:
        bodies: The bodies.
        pairs: Their pairs.

    Returns:
        The pairs; where a surface has facets on seams, a copy of the pair without these facets.
    """
    fastened = _fastened(bodies, pairs)
    if not fastened.any():
        return tuple(pairs)
    V = bodies[0].V
    groups = connected(bodies)
    insides = Insides(V.mesh.comm, closed_boundaries(groups))
    insides.move(reference_positions(V))
    number = {body: i for i, group in enumerate(groups) for body in group}
    group_of = np.full(len(V.dofmap.list), -1)
    for body in bodies:
        group_of[body.cells] = number[body]
    together = np.zeros((len(groups), len(groups)), dtype=bool)
    for i, j in np.argwhere(fastened):
        together[number[bodies[i]], number[bodies[j]]] = True

    def without_covered(surface: Surface) -> Surface:
        """Surface without facets on seams; unchanged if none or all facets are on seams."""
        facets, cells, points = _in_front(surface)
        covered: Flags = np.zeros(len(facets), dtype=bool)
        for group in range(len(groups)):
            own = together[group_of[cells], group] & (group_of[cells] != group)
            there, mine = joined(V.mesh.comm, points[own]), int(own.sum())
            depth = insides.depth(there, np.full(len(there), group, np.int32), np.zeros(len(there)))
            first = int(V.mesh.comm.exscan(mine) or 0)
            covered[own] |= depth[first : first + mine] > 0
        left = np.array([np.count_nonzero(covered), np.count_nonzero(~covered)])
        if not reductions.total(V.mesh.comm, left).all():
            return surface
        return Surface.of(V, facets[~covered], surface.name, smooth=surface.smooth)

    def may_cross(pair: ContactPair) -> bool:
        """Whether a pair may have a body that slides over seams: not between fastened bodies."""
        if isinstance(pair.enforcement, Tied) or pair.touches_itself:
            return False
        if not isinstance(pair.segments, Surface):
            return True
        first, second = (_bodies_of(bodies, side) for side in (pair.nodes, pair.segments))
        return not fastened[np.ix_(first, second)].any()

    return tuple(
        with_surfaces(pair, without_covered) if may_cross(pair) else pair for pair in pairs
    )


def with_surfaces(pair: ContactPair, reduced: Callable[[Surface], Surface]) -> ContactPair:
    """Copy of a pair with reduced surfaces; the pair itself if nothing is left out. Collective.

    ``reduced`` returns a surface with fewer facets, or the surface itself.
    """
    sides = {
        name: reduced(side)
        for name in ("nodes", "segments")
        if isinstance(side := getattr(pair, name), Surface)
    }
    if all(side is getattr(pair, name) for name, side in sides.items()):
        return pair
    found = copy(pair)
    vars(found).update(_declared=pair.declared, **sides)
    return found


def _fastened(bodies: Sequence[Body], pairs: Sequence[ContactPair]) -> Flags:
    """Whether two bodies never move relative to each other at seams, ``(b, b)``. Collective."""
    fastened: Flags = np.zeros((len(bodies), len(bodies)), dtype=bool)
    for pair in pairs:
        if isinstance(pair.enforcement, Tied) and isinstance(pair.segments, Surface):
            of_nodes, of_segments = (_bodies_of(bodies, s) for s in (pair.nodes, pair.segments))
            fastened |= np.outer(of_nodes, of_segments) | np.outer(of_segments, of_nodes)
    guided = [(i, body) for i, body in enumerate(bodies) if isinstance(body, RigidBody)]
    for (i, first), (j, second) in combinations(guided, 2):
        fastened[i, j] = fastened[j, i] = _are_guided_alike(first, second)
    np.fill_diagonal(fastened, False)
    return fastened


def _are_guided_alike(first: RigidBody, second: RigidBody) -> bool:
    """Whether two rigid bodies have no free motion and the same prescribed motion. Local."""
    if first.guide is None or second.guide is None:
        return False
    if first.free().size or second.free().size:
        return False
    one, other = first.guide.motion, second.guide.motion
    return one is other or (one.is_rest and other.is_rest)


def _bodies_of(bodies: Sequence[Body], surface: Surface) -> Flags:
    """Whether each body has nodes of a surface, shape ``(b,)``. Collective."""
    mine = np.array([bool(np.isin(surface.nodes, body.nodes).any()) for body in bodies])
    return reductions.anywhere(surface.V.mesh.comm, mine)


def _in_front(surface: Surface) -> tuple[Ints, Ints, Floats]:
    """Owned facets of a surface, their cells, and points in front, ``(f, 3)`` [m]. Collective."""
    mesh = surface.V.mesh
    dim = mesh.topology.dim
    facets = surface.owned_facets
    mesh.topology.create_connectivity(dim - 1, dim)
    to_cells = mesh.topology.connectivity(dim - 1, dim)
    # A facet of the boundary has one cell.
    cells: Ints = to_cells.array[to_cells.offsets[facets]]
    middles = compute_midpoints(mesh, dim - 1, facets)
    outward = middles - compute_midpoints(mesh, dim, cells)
    return facets, cells, middles + _IN_FRONT * outward
