"""Check for round surfaces that fit each other, and facets too coarse for their clearance."""

import logging
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from dolfinx import fem

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import Floats, GlobalInts, Ints, indices
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.bodies import Body, body_of_nodes
from dolfinx_nts.model.connected_bodies import connected
from dolfinx_nts.model.obstacles.facing import Facing
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.search.global_search import GlobalSearch

__all__ = ["warn_of_round_fits"]

_logger = logging.getLogger("dolfinx_nts")

# Least overlap of the boxes of two surfaces along each axis, relative to the smaller box [-], if
# one surface encloses the other; search radius relative to the longest facet [-]; and least number
# of facets [-].
_AROUND, _REACH, _FEWEST = 0.05, 0.5, 8
# Gap of a facet relative to the deviation of facets [-] above which facets do not matter (at a
# ratio of 4 the force of a pin in a hole is 11 % too large). Length of the mean normal of an arc of
# facets [-] below which the arc encloses the other body: 0.97 for an arc of 50 degrees.
_WIDE, _TURNED = 10.0, 0.97
# Deviation from a round surface, and difference of the radii of both surfaces [-], above which
# surfaces do not fit. Largest axial component of the normals of a cylinder [-], less than on
# spheres.
_ROUND, _SIMILAR, _ALONG_AXIS = 0.15, 0.3, 0.02
# Deviation relative to the length of facets [-] up to which the nodes of two surfaces coincide.
_ROUND_OFF = 1e-9


class _Fit(NamedTuple):
    """Two bodies that fit each other.

    Attributes:
        deviation: Root mean square of the difference between the gap at the middle of a facet and
            the mean at its nodes [m].
        gap: Mean gap [m].
        bodies: Numbers of the bodies.
    """

    deviation: float
    gap: float
    bodies: tuple[int, int]


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


def warn_of_round_fits(pairs: Sequence[ContactPair], bodies: Sequence[Body]) -> None:
    """Warn of round bodies inside each other whose facets do not resolve the gap. Collective.

    Facets are chords of the round surfaces: the gap of a pin in a hole varies along each facet,
    unless the nodes of both lie opposite each other. Bodies fit if a connected arc of facets of one
    body, of 50 degrees or more, lies close to a surface of the other body with about the same
    radius.

    Args:
        pairs: The contact pairs.
        bodies: The bodies of the stepper.
    """
    for pair in pairs:
        nodes, segments = pair.nodes, pair.segments
        if pair.touches_itself or not isinstance(segments, Surface) or pair.method == EDGES:
            continue
        if nodes.smooth or segments.smooth or not _is_around(nodes, segments):
            continue
        fits = _fits(nodes, segments, bodies)
        if fits and nodes.V.mesh.comm.rank == 0:
            worst, others = max(fits), len({frozenset(fit.bodies) for fit in fits}) - 1
            names = " and ".join(bodies[number].name for number in worst.bodies)
            _logger.warning(
                "round surfaces of %s%s fit each other with a gap of %.2g m, which flat facets "
                "change by %.2g m from place to place: forces and pressures may be wrong by a "
                "tenth or more; use %s",
                names,
                f", and {others} more of other bodies," * (others > 0),
                *(worst.gap, worst.deviation, _remedy(nodes.V)),
            )


def _remedy(V: fem.FunctionSpace) -> str:
    """Advice for a mesh that resolves the gap. Local."""
    if Element.of(V).degree == 1:
        return "finer facets, or both surfaces with smooth=True and method='mortar'"
    if compat.geometry_degree(V.mesh) == 1:
        return "curved cells, by gmsh.model.mesh.setOrder(2), and finer facets"
    return "finer facets"


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


def _fits(one: Surface, other: Surface, bodies: Sequence[Body]) -> list[_Fit]:
    """Bodies of two surfaces that fit each other. Collective."""
    X, (s, k) = reference_positions(one.V), one.segments.shape
    x, comm, reach = X[one.segments], one.V.mesh.comm, _REACH * one.size
    candidates, _ = GlobalSearch(one, other).update(X, reach + one.size)
    places = _Places(np.concatenate([x.reshape(-1, 3), x.mean(axis=1)]))
    none = np.full(s * (k + 1), -1, dtype=np.int32)
    segment, gaps = candidates.pair(places, candidates.scatter.forward(X), none, reach)
    at_nodes, middle = gaps[: s * k].reshape(s, k).mean(axis=1), gaps[s * k :]
    body = body_of_nodes(bodies).astype(np.float64)
    there = candidates.scatter.forward(np.repeat(body[:, None], 3, axis=1))[:, 0]
    opposite: Floats = np.full(s, np.nan)
    has = segment[s * k :] >= 0
    opposite[has] = there[candidates.segments[segment[s * k :][has], 0]]
    rows = np.column_stack(
        [
            *(at_nodes, middle - at_nodes, body[one.segments[:, 0]], opposite),
            *(x.mean(axis=1), area_vectors(x, one.orientation)),
            one.V.dofmap.index_map.local_to_global(one.segments.ravel()).reshape(s, k),
        ]
    )
    rows = joined(comm, rows[np.isfinite(rows).all(axis=1)])
    group: Ints = np.zeros(len(bodies), dtype=np.int32)
    for number, members in enumerate(connected(bodies)):
        group[[bodies.index(each) for each in members]] = number
    two = group[rows[:, 2:4].astype(np.int32)]
    fits = []
    for sides in np.unique(two, axis=0):
        of_two = rows[(two == sides).all(axis=1)]
        near = of_two[np.abs(of_two[:, 0]) <= _WIDE * np.sqrt(np.mean(of_two[:, 1] ** 2))]
        arcs = _components(near[:, 10:].astype(np.int64))
        fits += [fit for arc in arcs if (fit := _fit_of_arc(near[arc])) is not None]
    return fits


def _fit_of_arc(rows: Floats) -> _Fit | None:
    """Fit of connected facets, if they are round and the other surface has the same radius. Local.

    Columns of the rows: mean gap at the nodes of a facet, difference to its middle, numbers of its
    body and of the opposite one, middle and area vector.
    """
    gap, difference, middle, normal = rows[:, 0], rows[:, 1], rows[:, 4:7], rows[:, 7:10]
    area = np.linalg.norm(normal, axis=1)
    deviation = np.sqrt(np.mean(difference**2))
    if len(rows) < _FEWEST or np.linalg.norm(normal.sum(axis=0)) > _TURNED * area.sum():
        return None
    if not deviation > _ROUND_OFF * np.sqrt(area.mean()):
        return None
    normal = normal / area[:, None]
    part = area / area.sum()
    # Normals of a cylinder have no component along its axis.
    values, axes = np.linalg.eigh(normal.T @ (part[:, None] * normal))
    axes = axes[:, values > _ALONG_AXIS]
    radius, rest = _sphere(middle @ axes, normal @ axes, part)
    opposite, _ = _sphere((middle + gap[:, None] * normal) @ axes, normal @ axes, part)
    if rest > _ROUND or abs(opposite - radius) > _SIMILAR * abs(radius):
        return None
    own, other = (int(np.bincount(column.astype(np.int32)).argmax()) for column in rows.T[2:4])
    return _Fit(float(deviation), float(np.abs(gap.mean())), (own, other))


def _sphere(x: Floats, normal: Floats, part: Floats) -> tuple[float, float]:
    """Radius of the sphere or circle with given points and normals, and deviation from it. Local.

    Args:
        x: Points, shape ``(n, d)`` [m].
        normal: Unit normals there, shape ``(n, d)``.
        part: Weights of sum 1, shape ``(n,)``.

    Returns:
        Radius, positive if convex [m], and deviation of the points relative to their spread [-].
    """
    x, normal = x - part @ x, normal - part @ normal
    radius = np.sum(part @ (normal * x)) / np.sum(part @ normal**2)
    spread, rest = (np.sqrt(np.sum(part @ each**2)) for each in (x, x - radius * normal))
    return float(radius), float(rest / spread)


def _components(facets: GlobalInts) -> list[Ints]:
    """Facets that are connected by common nodes, by component. Local.

    ``facets`` are numbers of their nodes, shape ``(f, k)``.
    """
    node = np.unique(facets, return_inverse=True)[1].reshape(facets.shape)
    label = np.arange(len(facets))
    least = np.full(node.max(initial=-1) + 1, len(facets))
    while True:
        np.minimum.at(least, node, label[:, None])
        new = least[node].min(axis=1, initial=len(facets))
        new = new[new]  # halves the way to the first facet
        if np.array_equal(new, label):
            return [indices(label == n) for n in np.unique(label)]
        label = new
