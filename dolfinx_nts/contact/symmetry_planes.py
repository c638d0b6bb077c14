"""Facets on planes of symmetry, which are no boundary.

In the model of one half, facets of several bodies lie on the plane of symmetry, and their nodes
cannot leave it. They are not the boundary of the whole: a node on this plane and below a surface of
another body is inside the whole body, but on the boundary of its half.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
from dolfinx import la

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.enforcement import Tied
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.seams import with_surfaces
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined

__all__ = ["without_symmetry_planes"]

# Deviation of a normal from an axis [-], and of a facet from a plane relative to the longest facet
# [-], that count as round-off.
_ROUND_OFF = 1e-9


def without_symmetry_planes(pairs: Sequence[ContactPair], fixed: Ints) -> tuple[ContactPair, ...]:
    """Leave out facets on planes of symmetry that both surfaces of a pair share. Collective.

    Args:
        pairs: The pairs.
        fixed: Owned scalar dofs with a prescribed displacement.

    Returns:
        The pairs. A pair whose surfaces both have facets on one plane with the same outward normal
        is replaced by a copy without these facets, if supports fix all their nodes in this
        direction only.
    """
    if not pairs or not reductions.total(pairs[0].nodes.V.mesh.comm, len(fixed)):
        return tuple(pairs)
    is_fixed = _fixed_components(pairs[0].nodes, fixed)
    planes_of = cache(lambda surface: _planes(surface, is_fixed))

    def without_shared_planes(surface: Surface, other: Surface) -> Surface:
        """Surface without the facets on planes that both surfaces share, unless none is left."""
        own, (others, _) = planes_of(surface), planes_of(other)
        if not len(others):
            return surface
        near = np.abs(own[1][:, None] - others) <= _ROUND_OFF * np.array([1, 1, surface.size])
        covered: Flags = np.count_nonzero(near.all(axis=2), axis=1) > 0
        left = np.array([np.count_nonzero(covered), np.count_nonzero(~covered)])
        if not reductions.total(surface.V.mesh.comm, left).all():
            return surface
        facets = np.unique(surface.facet[~covered])
        return Surface.of(surface.V, facets, surface.name, smooth=surface.smooth)

    def between(pair: ContactPair) -> ContactPair:
        other = pair.segments
        if isinstance(pair.enforcement, Tied) or not isinstance(other, Surface):
            return pair
        both = {pair.nodes: other, other: pair.nodes}
        return with_surfaces(
            pair, cache(lambda surface: without_shared_planes(surface, both[surface]))
        )

    return tuple(map(between, pairs))


def _fixed_components(surface: Surface, fixed: Ints) -> Flags:
    """Whether the components of the displacement of all local nodes are prescribed, ``(l, d)``."""
    V = surface.V
    vector = la.vector(V.dofmap.index_map, dimension(V))
    vector.array[fixed] = 1.0
    vector.scatter_forward()
    is_fixed: Flags = vector.array.reshape(-1, dimension(V)) > 0
    return is_fixed


def _planes(surface: Surface, is_fixed: Flags) -> tuple[Floats, Floats]:
    """Planes on which supports fix the normal displacement of segments of a surface. Collective.

    Returns:
        Axis, sign of the normal, and coordinate of the planes of all ranks, ``(p, 3)``; the same
        for each segment of this rank, NaN for none, ``(s, 3)``.
    """
    segments, orientation = surface.segments, surface.orientation
    x = reference_positions(surface.V)[segments]
    normal = area_vectors(x, orientation)
    length = np.linalg.norm(normal, axis=1)
    axis = np.abs(normal).argmax(axis=1)
    every = np.arange(len(segments))
    along = normal[every, axis]
    at = x[every, :, axis]
    are_fixed = is_fixed[segments]
    is_plane = np.abs(along) >= (1 - _ROUND_OFF) * length
    is_plane &= np.ptp(at, axis=1) <= _ROUND_OFF * surface.size
    is_plane &= are_fixed[every, :, axis].all(axis=1) & ~are_fixed.all(axis=(1, 2))
    planes = np.column_stack([axis, np.sign(along), at.mean(axis=1)])
    planes[~is_plane] = np.nan
    found = np.unique(joined(surface.V.mesh.comm, planes[is_plane]), axis=0)
    differs = np.abs(np.diff(found, axis=0)) > _ROUND_OFF * np.array([1, 1, surface.size])
    is_last = np.ones(len(found), dtype=bool)
    is_last[:-1] = differs.any(axis=1)
    return found[is_last], planes
