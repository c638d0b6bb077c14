"""Contact (quadrature) points of mortar facets, and shape functions of the multipliers there.

Dual functions are negative on a part of a facet. Opposite a kink of the segments the gap is not
linear, and an open gap may reduce the mean gap. A facet therefore has the functions ``c dual + (1 -
c) linear``. The fraction ``c`` is the largest for which no mean gap is less than the least gap on
the facets around the node. Opposite distinct kinks it has linear functions, whose weights vanish in
equilibrium where the gap is open.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Array, Flags, Floats, Ints, indices
from dolfinx_nts.search.edges.sharp_edges import unit_normals
from dolfinx_nts.search.mortar.facet_candidates import FacetCandidates, distances, extend_evenly
from dolfinx_nts.search.mortar.mortar_points import MortarFacets, MortarPoints, Shares
from dolfinx_nts.search.mortar.whole_facets import linear_functions

__all__ = ["FacetPoints"]

# Spread of the normals of undeformed segments below the facets around a node, 1 less the length of
# their mean [-]: up to the first value the surface counts as smooth, from the second value on as a
# kink. A kink by the angle a in the middle has a^2 / 8: 5 and 10 degrees. Larger: dual functions at
# steeper chamfers (with 17 degrees, contact opens next to the chamfer in 33 of 63 generated cases);
# smaller: coarser round segments count as kinks, with less smooth pressures.
_SMOOTH, _KINKED = 0.001, 0.004
# Step between unconnected segments below a facet, relative to its diameter [-]: up to the first
# value the surface counts as smooth, from the second value on as a kink. Larger: the open gap above
# the lower segments counts as much as the penetration of the upper ones. (Without them the force of
# a block above a step of 3 % of a facet is 15 % too small.) Smaller: joints of bodies that are
# deformed differently count as kinks.
_LEVEL, _STEPPED = 0.002, 0.01
# Multiple of the least gap in equilibrium [-] up to which points opposite a kink have full weight,
# and power with which weights decrease for larger gaps, opposite kinks and opposite steps. Larger
# multiple or smaller power: open points keep nodes apart, and forces are too small (by 45 % without
# a limit on the coarsest mesh of a chamfered punch, by 9 % with 4; with the values of kinks by 20 %
# above steps of 2 % of a facet, by 4 % with those of steps). Opposite: points that are open due to
# the waviness of deformed facets have less weight (with the values of steps the force of the
# coarsest chamfered punch is 18 % too large).
_COUNTED, _POWER = 4.0, 2.0
_COUNTED_AT_STEPS, _POWER_AT_STEPS = 2.0, 4.0

# Least derivative of the mean gap of a node with respect to its own displacement [-], with
# multipliers and with springs. Smaller: only parts of facets far from the node are covered, as
# below a trailing edge, and its force may be 1e4 times too large (with multipliers, 3 of 28 sliding
# blocks fail at 0.005; with springs 1 fails without this limit); larger: nodes at rims penetrate,
# and springs of nodes that leave a surface lose their energy earlier (at 0.01).
_LEAST_OWN, _LEAST_OWN_OF_SPRINGS = 0.02, 0.005

# Distance from its segment, in coordinates of the reference segment [-], above which a point is
# left out. Only facets at right angles to segments have such points, and with inertia points that
# slide that far within a step. Larger: projections of warped segments have no solution (at 1.5 in
# a pile of balls), and near it forces are arbitrary; smaller: facets inclined towards their
# segments lose points.
_BEYOND = 1.25


@dataclass(frozen=True)
class FacetPoints:
    """Quadrature points of facets, and corners of the integration cells, each with one segment.

    Attributes:
        facets, candidates: Facets and candidates of both surfaces.
        places: Points and corners, without shares of nodes.
        facet: Facet of each, shape ``(p,)``.
        of_segment: Candidate on whose facet each point is, shape ``(p,)``.
        weight: Reference area of each, 0 of corners, shape ``(p,)`` [m^2].
        linear: Linear shape functions of the vertices of facets at the points, shape ``(p, k)``.
        dual: Functions dual to them, shape ``(p, k)``.
        kink: 1 on facets opposite kinks, 0 opposite smooth segments, continuous between, ``(p,)``
            [-].
        step: The same for steps between unconnected segments, which count as kinks, ``(p,)`` [-].
        known: Positions of nodes [m], and gaps at these positions without offset, ``(p,)`` [m].
    """

    facets: MortarFacets
    candidates: FacetCandidates
    places: MortarPoints
    facet: Ints
    of_segment: Ints
    weight: Floats
    linear: Floats
    dual: Floats
    kink: Floats
    step: Floats
    known: tuple[tuple[Floats, Floats], ...]

    @classmethod
    def choose(
        cls,
        facets: MortarFacets,
        candidates: FacetCandidates,
        x_n: Floats,
        x: Floats,
        reach: float,
        *,
        kinks: bool = True,
        slides_far: bool = False,
    ) -> "FacetPoints":
        """Choose the points of all nodes. Collective.

        Args:
            facets: Facets around the nodes.
            candidates: Segments of the other surface.
            x_n: Positions at t_n, see `Candidates`.
            x: Positions at which segments are projected on facets.
            reach: Search distance of the facets [m].
            kinks: Whether multipliers opposite kinks of flat segments have linear shape functions.
            slides_far: Whether points may be at any distance from their segments at x_n, on their
                extension; otherwise points farther away than at x are left out.
        """
        is_smooth = facets.of_patches is not None or candidates.rise is not None
        *_, thickness = candidates.of_segments
        facet, of_segment, weight, phi, dual, steps = _kernels.mortar_points(
            facets.vertices,
            facets.orientation,
            facets.X,
            x_n,
            x,
            candidates.segments,
            candidates.orientation,
            candidates.key,
            thickness,
            x_n,
            x,
            reach,
            float(candidates.initial_depth.max(initial=0.0)),
            facets.is_axisymmetric,
            is_smooth,
        )
        k = dual.shape[1]
        linear = phi if phi.shape[1] == k else phi @ linear_functions(k)
        reached = np.hstack([facets.facet_nodes[facet], candidates.facet_nodes[of_segment]])
        width, whole = 1 + len(candidates.key), candidates.whole[of_segment]
        _, patch = np.unique(facet.astype(np.int64) * width + whole, return_inverse=True)
        places = MortarPoints(
            reached,
            facets.patched(facet, phi),
            of_segment,
            np.zeros(len(facet)),
            patch.astype(np.int32),
            Shares.none(facets.nodes),
        )
        segment = candidates.of_points(places, of_segment, (x_n, x))
        places = replace(places, segment=segment)
        is_triangle, known = candidates.segments.shape[1] == 3, list[tuple[Floats, Floats]]()
        faces = np.ones(len(facet), dtype=bool)
        for y, slides in ((x_n, slides_far), (x, False)):
            xi, gap, *_ = candidates.projections(places, y, segment)
            near = distances(xi, is_triangle=is_triangle) <= _BEYOND
            if slides:
                near |= np.isfinite(gap) & extend_evenly(candidates, y, segment, xi)
            faces &= near
            known.append((y, gap))
        if not faces.all():
            kept = indices(faces)
            places = places.only(kept, places.shares)
            facet, of_segment, segment = facet[kept], of_segment[kept], segment[kept]
            weight, linear, dual = weight[kept], linear[kept], dual[kept]
            known = [(y, gap[kept]) for y, gap in known]
        if is_smooth:
            offset = candidates.shortened(places, x, segment, facets.rise(facet, x))
            places = replace(places, offset=offset)
        smooth = np.zeros(len(facet))
        found = cls(
            *(facets, candidates, places, facet, of_segment),
            *(weight, linear, dual, smooth, smooth),
            tuple(known),
        )
        # Smooth segments have kinks between facets, but not between their patches.
        has_kinks = kinks and candidates.rise is None
        if not has_kinks:
            return found
        kink, step = found._kinks(steps)
        return replace(found, kink=kink, step=step)

    def _kinks(self, steps: Floats) -> tuple[Floats, Floats]:
        """Largest kink, and step, of segments around the vertices of the facet of each point.

        Shapes ``(p,)`` each. Collective. The kink is computed from undeformed normals, which do not
        change, and from the steps between unconnected segments below each facet, ``(f,)`` [-].
        """
        facets, scatter, k = self.facets, self.candidates.scatter, self.linear.shape[1]
        segments, orientation = self.candidates.segments, self.candidates.orientation
        normal = (unit_normals(facets.X[segments]) * orientation[:, None])[self.of_segment]
        vertices = facets.vertices[self.facet, :k].ravel()
        sums = [
            np.bincount(vertices, ((self.weight * values) * self.linear.T).T.ravel(), len(facets.X))
            for values in (*normal.T, np.ones(len(normal)))
        ]
        length, whole = np.linalg.norm(sums[:3], axis=0), sums[3]
        spread = 1 - np.divide(length, whole, out=np.ones(len(whole)), where=whole > 0)
        kink = np.zeros((scatter.index_map.size_local, 3))
        kink[facets.nodes, 0] = spread[facets.nodes]
        kink = np.clip((kink - _SMOOTH) / (_KINKED - _SMOOTH), 0.0, 1.0)
        of_steps = np.clip((steps - _LEVEL) / (_STEPPED - _LEVEL), 0.0, 1.0)
        at_vertices = np.zeros(len(facets.X))
        np.maximum.at(at_vertices, facets.vertices[:, :k], of_steps[:, None])
        kink[facets.nodes, 1] = at_vertices[facets.nodes]
        of_points = scatter.forward(kink)[facets.vertices[self.facet, :k], :2].max(axis=1)
        return of_points.max(axis=1), of_points[:, 1]

    def largest_dual_fractions(self, states: Sequence[Floats], slack: float) -> Floats:
        """Largest fraction of dual functions that keeps mean gaps above the least gap. Local.

        With this fraction, or less on some facets, the mean gap of a node is not less than the
        least gap on the facets around it. The integrals of ``psi (g - least)`` are not negative
        with the linear functions, and therefore with the mixed functions.

        Args:
            states: Positions of nodes at which mean gaps are bounded, each of shape ``(l, 3)``
                [m].
            slack: Difference of gaps that is round-off [m].

        Returns:
            Fractions between 0 and 1, shape ``(n,)`` [-].
        """
        facets, count = self.facets, len(self.facets.X)
        used, row = np.unique(self.facet, return_inverse=True)
        vertices = facets.vertices[used, : self.linear.shape[1]]
        weight = (1 - self.kink) * self.weight

        def integrals(values: Floats) -> Floats:
            columns = [np.bincount(row, v, len(used)) for v in weight * values.T]
            sums: Floats = np.stack(columns, axis=1).astype(np.float64, copy=False)
            return sums

        def at_nodes(values: Array) -> Floats:
            sums = np.bincount(vertices.ravel(), values.ravel(), count)[facets.nodes]
            return sums.astype(np.float64, copy=False)

        def integrals_above(gap: Floats, least: Floats, functions: Floats) -> Floats:
            above = integrals((functions.T * gap).T)
            return above - least[vertices] * integrals(functions)

        fraction: Floats = np.ones(len(facets.nodes))
        for x in states:
            gap, least = self._gaps(x)
            linear, dual = (integrals_above(gap, least, f) for f in (self.linear, self.dual))
            area = slack * at_nodes(integrals(self.linear))
            there, taken = at_nodes(linear), at_nodes(np.fmax(linear - dual, 0.0))
            # If the gap is constant up to round-off, the dual functions are kept.
            with np.errstate(invalid="ignore", divide="ignore"):
                room = area * area / (area + there)
                fraction = np.fmin(fraction, (there + room) / taken)
        return fraction

    def on_facets_of(self, nodes: Flags) -> Flags:
        """Flags of the owned nodes on facets around flagged ones, both ``(n,)``. Collective."""
        facets, scatter, k = self.facets, self.candidates.scatter, self.linear.shape[1]
        flags = np.zeros((scatter.index_map.size_local, 3))
        flags[facets.nodes, 0] = nodes
        vertices = facets.vertices[:, :k]
        of_facets = scatter.forward(flags)[vertices, 0].max(axis=1, initial=0.0)
        around = np.zeros(len(facets.X))
        np.maximum.at(around, vertices, of_facets[:, None])
        found: Flags = around[facets.nodes] > 0
        return found

    def _weights_at_kinks(self, inner: Ints, gap: Floats, level: Floats, slack: float) -> Floats:
        """Weights of the points ``inner`` opposite kinks: 1 up to a multiple of the least gap.

        ``gap`` and the least gap magnitude ``level`` of the facets [m] have the shape ``(p,)``.
        """
        step = self.step[inner]
        multiple = (1 - step) * _COUNTED + step * _COUNTED_AT_STEPS
        power = (1 - step) * _POWER + step * _POWER_AT_STEPS
        counted = np.fmax(multiple * level, slack)
        weights: Floats = (counted / np.fmax(gap, counted)) ** power
        return weights

    def _without_distant_nodes(self, inner: Ints, psi: Floats, least: float) -> Floats:
        """Move functions of nodes that hardly affect their mean gap to other nodes of the facet.

        The sum of the functions at each point stays the same. ``psi`` are the functions at the
        points ``inner``, shape ``(p, k)``, ``least`` the least derivative of a mean gap with
        respect to the displacement of its node [-]. Collective.
        """
        facets, scatter, k = self.facets, self.candidates.scatter, psi.shape[1]
        linear, vertices = self.linear[inner], facets.vertices[self.facet[inner], :k]
        values = self.weight[inner, None] * psi
        area, own = (
            np.bincount(vertices.ravel(), each.ravel(), len(facets.X))[facets.nodes]
            for each in (values, values * linear)
        )
        lacks = np.zeros((scatter.index_map.size_local, 3))
        lacks[facets.nodes, 0] = (area > 0) & (own < least * area)
        lacking = scatter.forward(lacks)[vertices, 0] > 0
        left = np.where(lacking, 0.0, linear)
        whole = left.sum(axis=1, keepdims=True)
        gives = lacking.any(axis=1, keepdims=True) & (whole > 0)
        taken = np.where(lacking, psi, 0.0).sum(axis=1, keepdims=True)
        others = left * (taken / np.where(whole > 0, whole, 1.0))
        return np.where(gives, np.where(lacking, 0.0, psi) + others, psi)

    def _gaps(self, x: Floats) -> tuple[Floats, Floats]:
        """Gaps of points and corners, and the least gap around each node of the map, ``(l,)``."""
        gap = next((gap for y, gap in self.known if y is x), None)
        if gap is None:
            gap = self.candidates.gap(self.places, x, self.places.segment)
        gap = gap + self.places.offset
        least = np.full(len(self.facets.X), np.inf)
        np.fmin.at(least, self.facets.vertices[self.facet, : self.linear.shape[1]], gap[:, None])
        return gap, least

    def points(
        self,
        dual_fraction: Floats | None = None,
        x: Floats | None = None,
        slack: float = 0.0,
        *,
        is_stiff: bool = False,
    ) -> MortarPoints:
        """Create contact points with the weights of the nodes. Collective.

        Points below a segment are left out if they are above an adjacent segment beyond a convex
        edge, or less deep below it, see `AdjacentFacets.are_nearer_to_adjacent`. Opposite kinks,
        linear functions are multiplied by a weight. It is 1 up to a multiple of the least gap
        magnitude on the facets next to the facet of the point, and then decreases.

        Args:
            dual_fraction: Largest fraction of the dual functions around each node, shape ``(n,)``;
                None: 1, and the method is local.
            x: Positions whose gaps determine the weights, in equilibrium or at t_n, shape ``(l,
                3)`` [m]. With None all weights are 1, and no points are left out.
            slack: Difference of gaps that is round-off [m].
            is_stiff: Whether contact is enforced by multipliers instead of springs: the threshold
                for moving functions to other nodes is larger.
        """
        facets, has_weight = self.facets, self.weight > 0
        if x is not None and (around := self.candidates.adjacent(x)) is not None:
            adjacent, vertices = around
            places = self.places.of(x), vertices, self.of_segment
            has_weight &= ~adjacent.are_nearer_to_adjacent(*places)
        inner = indices(has_weight)
        facet, psi = self.facet[inner], self.dual[inner]
        if dual_fraction is not None:
            scatter, k = self.candidates.scatter, psi.shape[1]
            values = np.ones((scatter.index_map.size_local, 3))
            values[facets.nodes, 0] = dual_fraction
            gap: Floats = np.zeros(len(inner))
            linear, kink = self.linear[inner], self.kink[inner]
            if x is not None:
                gaps, least_gap = self._gaps(x)
                gap, values[facets.nodes, 1] = gaps[inner], least_gap[facets.nodes]
            of_facets = scatter.forward(values)[facets.vertices[:, :k]].min(axis=1)
            c, level = of_facets[facet, :2].T
            weight: Floats = np.ones(len(gap))
            if x is not None:
                weight = self._weights_at_kinks(inner, gap, np.abs(level), slack)
            smooth = linear + c[:, None] * (psi - linear)
            psi = ((1 - kink) * smooth.T + kink * weight * linear.T).T
            least = _LEAST_OWN if is_stiff else _LEAST_OWN_OF_SPRINGS
            psi = self._without_distant_nodes(inner, psi, least)
        key = self.candidates.key[self.of_segment[inner]]
        shares = facets.shares(facet, self.weight[inner], psi, key)
        return self.places.only(inner, shares)
