"""Check for round surfaces that fit each other, and facets too coarse for their clearance."""

import logging
from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.obstacles.facing import Facing
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.search.global_search import GlobalSearch

__all__ = ["warn_of_round_fits"]

_logger = logging.getLogger("dolfinx_nts")

# Part of the extent of the smaller surface by which the boxes of both overlap where one is around
# the other [-], search radius relative to the longest facet [-], and least number of facets [-].
_AROUND, _REACH, _FEWEST = 0.05, 0.5, 8
# Gap of a facet relative to the deviation of facets [-] above which facets do not matter, and
# length of the mean normal of the other facets [-] below which they are around the other body: 0.9
# for an arc of 90 degrees. A pin in a hole with a ratio of 4 has 11 % too much force.
_WIDE, _TURNED = 10.0, 0.9


class _Places:
    """Points at given positions, see `ContactPoints`. Local."""

    def __init__(self, positions: Floats) -> None:
        self._positions, n = positions, len(positions)
        self.nodes: Ints = np.full(n, -1, dtype=np.int32)
        self.facing: Facing = Facing.everywhere(n)

    def of(self, values: Floats) -> Floats:
        return self._positions

    def take(self, nodes: Ints) -> "_Places":
        return _Places(self._positions[nodes])


def warn_of_round_fits(pairs: Sequence[ContactPair]) -> None:
    """Warn of round bodies in each other whose gap is not resolved by their facets. Collective.

    Facets are chords of the round surfaces: the gap of a pin in a hole varies along each facet,
    unless the nodes of both lie opposite each other.

    Args:
        pairs: The contact pairs.
    """
    for pair in pairs:
        nodes, segments = pair.nodes, pair.segments
        if pair.touches_itself or not isinstance(segments, Surface) or pair.method == EDGES:
            continue
        if nodes.smooth or segments.smooth or not _is_around(nodes, segments):
            continue
        gap, deviation = _fit(nodes, segments)
        if deviation > 0 and nodes.V.mesh.comm.rank == 0:
            _logger.warning(
                "round surfaces of %s fit each other with a gap of %.2g m, which flat facets "
                "change by %.2g m from place to place: forces and pressures may be wrong by a "
                "tenth or more; use finer facets, or both surfaces with smooth=True and "
                "method='mortar'",
                *(pair.between, gap, deviation),
            )


def _is_around(one: Surface, other: Surface) -> bool:
    """Whether the boxes of two surfaces overlap along all axes. Collective."""
    X = reference_positions(one.V)[:, : dimension(one.V)]
    own = [
        [-x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)]
        for x in (X[one.nodes], X[other.nodes])
    ]
    ends = reductions.largest(one.V.mesh.comm, np.array(own))
    low, high = -ends[:, 0], ends[:, 1]
    overlap = high.min(axis=0) - low.max(axis=0)
    return bool((overlap > _AROUND * (high - low).max(axis=1).min()).all())


def _fit(one: Surface, other: Surface) -> tuple[float, float]:
    """Mean gap, and deviation of facets of one surface from it, or 0 if they do not fit [m].

    Collective. The deviation is the root mean square of the difference between the gap at the
    middle of a facet and the mean at its nodes.
    """
    X, (s, k) = reference_positions(one.V), one.segments.shape
    x, comm, reach = X[one.segments], one.V.mesh.comm, _REACH * one.size
    candidates, _ = GlobalSearch(one, other).update(X, reach + one.size)
    places = _Places(np.concatenate([x.reshape(-1, 3), x.mean(axis=1)]))
    none = np.full(s * (k + 1), -1, dtype=np.int32)
    _, gaps = candidates.pair(places, candidates.scatter.forward(X), none, reach)
    at_nodes, middle = gaps[: s * k].reshape(s, k).mean(axis=1), gaps[s * k :]
    rows = np.column_stack([at_nodes, middle - at_nodes, area_vectors(x, one.orientation)])
    rows = joined(comm, rows[np.isfinite(rows).all(axis=1)])
    if not len(rows):
        return 0.0, 0.0
    near = rows[np.abs(rows[:, 0]) <= _WIDE * np.sqrt(np.mean(rows[:, 1] ** 2))]
    lengths = np.linalg.norm(near[:, 2:], axis=1)
    if len(near) < _FEWEST or np.linalg.norm(near[:, 2:].sum(axis=0)) > _TURNED * lengths.sum():
        return 0.0, 0.0
    gap, deviation = np.abs(near[:, 0].mean()), np.sqrt(np.mean(near[:, 1] ** 2))
    return float(gap), float(deviation)
