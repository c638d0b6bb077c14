"""Choice of the contact points of mortar facets, and of the shape functions of their multipliers.

Dual functions are negative on a part of a facet. Above a kink of the segments the gap is not
linear, and an opening there may count as penetration. So a facet takes the functions
``c dual + (1 - c) linear`` with a part ``c``: the largest one with which no mean gap is less than
the least gap on the facets around the node.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Array, Floats, Ints
from dolfinx_nts.search.mortar.facet_candidates import FacetCandidates
from dolfinx_nts.search.mortar.mortar_points import MortarFacets, MortarPoints, Shares
from dolfinx_nts.search.mortar.whole_facets import linear_functions

__all__ = ["FacetPoints"]


@dataclass(frozen=True)
class FacetPoints:
    """Points of facets, and corners of the parts of facets below which there is one segment.

    Attributes:
        facets, candidates: Facets and candidates of both surfaces.
        places: Points and corners, without shares of nodes.
        facet: Facet of each, shape ``(p,)``.
        of_segment: Candidate whose facet each is on, shape ``(p,)``.
        weight: Reference area of each, 0 of corners, shape ``(p,)`` [m^2].
        linear: Linear functions of the vertices of facets there, shape ``(p, k)``.
        dual: Functions dual to them, shape ``(p, k)``.
    """

    facets: MortarFacets
    candidates: FacetCandidates
    places: MortarPoints
    facet: Ints
    of_segment: Ints
    weight: Floats
    linear: Floats
    dual: Floats

    @classmethod
    def choose(
        cls,
        facets: MortarFacets,
        candidates: FacetCandidates,
        x_n: Floats,
        x: Floats,
        reach: float,
    ) -> "FacetPoints":
        """Choose the points of all nodes. Local.

        Args:
            facets: Facets around the nodes.
            candidates: Segments of the other surface.
            x_n: Positions at t_n, see `Candidates`.
            x: Positions at which segments are projected on facets.
            reach: Search distance of the facets [m].
        """
        is_smooth = facets.of_patches is not None or candidates.rise is not None
        facet, of_segment, weight, phi, dual = _kernels.mortar_points(
            facets.vertices,
            facets.orientation,
            facets.X,
            x_n,
            x,
            candidates.segments,
            candidates.orientation,
            candidates.key,
            x_n,
            x,
            reach,
            float(candidates.sunk.max(initial=0.0)),
            facets.is_axisymmetric,
            is_smooth,
        )
        k = dual.shape[1]
        linear = phi if phi.shape[1] == k else phi @ linear_functions(k)
        reached = np.hstack([facets.wholes[facet], candidates.wholes[of_segment]])
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
        if is_smooth:
            offset = candidates.shortened(places, x, segment, facets.rise(facet, x))
            places = replace(places, offset=offset)
        return cls(facets, candidates, places, facet, of_segment, weight, linear, dual)

    def largest_parts(self, states: Sequence[Floats], slack: float) -> Floats:
        """Largest part of the dual functions on the facets around each node. Local.

        With it, or less on some facets, the mean gap of the node is not less than the least gap
        on these facets: the integrals of ``psi (g - least)`` by linear functions are not
        negative, and those by dual functions take no more from them than is there.

        Args:
            states: Positions of nodes at which mean gaps are bounded, each of shape ``(l, 3)``
                [m].
            slack: Difference of gaps that is round-off [m].

        Returns:
            Parts between 0 and 1, shape ``(n,)`` [-].
        """
        facets, count = self.facets, len(self.facets.X)
        used, row = np.unique(self.facet, return_inverse=True)
        vertices = facets.vertices[used, : self.linear.shape[1]]

        def integrals(values: Floats) -> Floats:
            columns = [np.bincount(row, v, len(used)) for v in self.weight * values.T]
            sums: Floats = np.stack(columns, axis=1).astype(np.float64, copy=False)
            return sums

        def at_nodes(values: Array) -> Floats:
            sums = np.bincount(vertices.ravel(), values.ravel(), count)[facets.nodes]
            return sums.astype(np.float64, copy=False)

        def integrals_above(gap: Floats, least: Floats, functions: Floats) -> Floats:
            above = integrals((functions.T * gap).T)
            return above - least[vertices] * integrals(functions)

        part: Floats = np.ones(len(facets.nodes))
        for x in states:
            gap = self.candidates.gap(self.places, x, self.places.segment) + self.places.offset
            least = np.full(count, np.inf)
            np.fmin.at(least, vertices[row], gap[:, None])
            linear, dual = (integrals_above(gap, least, f) for f in (self.linear, self.dual))
            area = slack * at_nodes(integrals(self.linear))
            there, taken = at_nodes(linear), at_nodes(np.fmax(linear - dual, 0.0))
            # A gap that is constant but for round-off leaves the dual functions.
            with np.errstate(invalid="ignore", divide="ignore"):
                room = area * area / (area + there)
                part = np.fmin(part, (there + room) / taken)
        return part

    def points(self, part: Floats | None = None) -> MortarPoints:
        """Take the points with the shares of the nodes in them. Collective.

        Args:
            part: Largest part of the dual functions around each node, shape ``(n,)``; None: 1,
                and the method is local.
        """
        facets, inner = self.facets, np.flatnonzero(self.weight > 0).astype(np.int32)
        facet, psi = self.facet[inner], self.dual[inner]
        if part is not None:
            scatter, k = self.candidates.scatter, psi.shape[1]
            values = np.ones((scatter.index_map.size_local, 3))
            values[facets.nodes, 0] = part
            of_facets = scatter.forward(values)[facets.vertices[:, :k], 0].min(axis=1)
            linear = self.linear[inner]
            psi = linear + of_facets[facet, None] * (psi - linear)
        key = self.candidates.key[self.of_segment[inner]]
        shares = facets.shares(facet, self.weight[inner], psi, key)
        return self.places.only(inner, shares)
