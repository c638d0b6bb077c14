"""Stiffness of the cells at the springs of a contact pair.

A layer of cells of height h, between nodes, and P-wave modulus M has the stiffness M/h per area.
The height is at most a multiple of the thickness of the other body: springs as soft as coarse cells
would let these sink through a thin sheet.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.model.layers import layers, walls
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.search.nodal_facets import NodalFacets
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["SOFT", "Layers"]

# Compliance of a default spring with inertia relative to that of the cells [-]: of the cells of
# both sides in explicit steps, whose forces are those at one end, of the softer side in implicit
# steps. Smaller: nodes vibrate at frequencies above those of the cells, which waves cannot carry
# away. The contact force of colliding rods then scatters permanently by 15 % (1), 9 % (1.25), 4 %
# (5/3), 3 % (2) of its mean in explicit steps, and by 8 % (1.1), 5 % (4/3), 3 % (5/3) in implicit
# steps. Larger: more penetration, and lower peaks of impact forces unless the spring becomes
# stiffer: for a ball on a block of 6 cells by 5 % (1.1), 6 % (4/3), 7 % (5/3). Measured on the rods
# of tests/verification/impact/test_rods.py with 40 cells and in benchmarks.defaults.
SOFT = 5 / 3
# Compression up to which springs are soft, relative to the compression by the pressure of plane
# waves [-]. Larger: with 2.4 instead of 1.5 the peak force of the ball is 4.5 instead of 1.9 % too
# small; smaller (1.2: 1.4 %): vibration exceeds that pressure, and would persist where springs are
# stiff.
_BEYOND_WAVES = 1.5
# Largest height of a layer relative to the thickness of the other body [-]. Larger: nodes pass
# through thin sheets under smaller loads: with 3, as soon as layers are compressed by a tenth.
# Smaller: springs are stiffer than the cells, and scatter, between bodies of few cells.
_THICK = 3.0
# Relative difference of layers that counts as zero [-], larger than round-off.
_EQUAL = 1e-6


@dataclass
class Layers:
    """Layers of cells at the nodes of a pair, and at the segments that the nodes may face.

    A pair may have segments of cells of many sizes, or of several bodies. A spring has the
    stiffness of the segment that its node faces when contact begins.

    Attributes:
        area: Areas of the ``m`` nodes, shape ``(m,)`` [m^2].
        own: Values of the layer of each node, shape ``(m, 4)``: compression per pressure [m/Pa], 0
            where it does not deform; slowness 1/(rho c) of its waves [m^2 s/kg]; compliance of the
            material 1/M [1/Pa]; largest height of the layers of the other body [m].
        least: The least values of the segments that deform, and the least height of all segments,
            for each node, ``(m, 4)``; 0 if none deforms.
        segment_nodes, of_segments: Owned nodes of the segments, ``(k,)``, and their values,
            ``(k, 4)``.
        varies: Whether the values of the segments differ.
        least_height: Least height of the layer of each node behind a facet, relative to the mean of
            all its facets, ``(m,)`` [-]; 1 on surfaces without edges.
    """

    area: Floats
    own: Floats
    least: Floats
    segment_nodes: Ints
    of_segments: Floats
    varies: bool
    least_height: Floats
    # Cached values at the nodes of an index map, valid while the candidates use this map.
    _there: tuple[NodalScatter, Floats] | None = field(default=None, init=False, repr=False)

    @classmethod
    def of(cls, pair: ContactPair, modulus: Floats, density: Floats | None = None) -> "Layers":
        """Layers of a pair. Collective.

        Args:
            pair: The pair.
            modulus: P-wave modulus at the owned nodes, shape ``(n,)`` [Pa]; infinite in bodies that
                do not deform, and where the modulus vanishes, so that cells do not limit the spring
                stiffness.
            density: Density at the owned nodes, shape ``(n,)`` [kg/m^3]; None if slownesses are not
                needed.
        """
        nodes, segments, comm = pair.nodes, pair.segments, pair.nodes.V.mesh.comm
        slowness: Floats = np.zeros(len(modulus))
        if density is not None:
            slowness = 1 / np.sqrt(density * modulus)
        area, height = layers(nodes)
        others: Ints = np.empty(0, dtype=np.int32)
        heights = [height, np.empty(0)]
        if isinstance(segments, Surface):
            others, (_, heights[1]) = segments.nodes, layers(segments)
        limits = _heights(pair, heights, [modulus[nodes.nodes], modulus[others]])
        own, there = (
            np.column_stack([h / modulus[at], slowness[at], 1 / modulus[at], limit])
            for h, at, limit in zip(heights, (nodes.nodes, others), limits, strict=True)
        )
        extremes: Floats = np.full((2, 4), -np.inf)
        deforming = there[there[:, 0] > 0]
        if len(deforming):
            extremes[:] = -deforming.min(axis=0), deforming.max(axis=0)
        if len(there):
            extremes[:, 3] = -there[:, 3].min(), there[:, 3].max()
        extremes = reductions.largest(comm, extremes)
        least = np.where(np.isfinite(extremes[0]), -extremes[0], 0.0)
        if not isinstance(segments, Surface):
            least[3] = min(_THICK * segments.extent, float(limits[0].max(initial=0.0)))
        varies = bool(np.any(extremes[1] > (1 + _EQUAL) * least) and least[0] > 0)
        facets = NodalFacets.of(nodes)
        least_height = facets.least_height if facets.has_edges else np.ones(len(area))
        rows = np.tile(least, (len(area), 1))
        return cls(area, own, rows, others, there, varies, least_height)

    @classmethod
    def joint(cls, parts: Sequence["Layers"]) -> "Layers":
        """Layers of several pairs, concatenated in the order of their nodes. Local."""
        names = ("area", "own", "least", "segment_nodes", "of_segments", "least_height")
        area, own, least, nodes, values, least_height = (
            np.concatenate([getattr(part, name) for part in parts]) for name in names
        )
        varies = any(part.varies for part in parts)
        return cls(area, own, least, nodes, values, varies, least_height)

    @classmethod
    def serialized(
        cls, archive: Archive, name: str, pair: ContactPair, layers: "Layers | None"
    ) -> "Layers | None":
        """Serialize the layers of a pair; returns the stored ones while restoring. Collective."""
        if not archive.same(f"{name}_exist", layers is not None):
            return None
        m, segments = len(pair.nodes.nodes), pair.segments
        others: Ints = np.empty(0, dtype=np.int32)
        if isinstance(segments, Surface):
            others = segments.nodes
        if layers is None:
            values = np.zeros(m), np.zeros((m, 4)), np.zeros((m, 4))
            layers = cls(*values, others, np.zeros((len(others), 4)), False, np.ones(m))
        area, own, least, least_height = (
            archive.nodal(f"{name}_{key}", pair.nodes.node_ids, getattr(layers, key))
            for key in ("area", "own", "least", "least_height")
        )
        there = layers.of_segments
        if isinstance(segments, Surface):
            there = archive.nodal(f"{name}_segments", segments.node_ids, there)
        varies = bool(archive.same(f"{name}_vary", layers.varies))
        return cls(area, own, least, others, there, varies, least_height)

    @property
    def deforms(self) -> Flags:
        """Whether the nodes or the segments deform, shape ``(m,)``. Local."""
        flags: Flags = np.fmax(self.own, self.least)[:, 0] > 0
        return flags

    def stiffness(self, *, in_series: bool = False) -> Floats:
        """Largest stiffness, of the least layers of both sides, ``(m,)`` [N/m]. Local.

        It is the stiffness of the softer layer, or of both in series; infinite where nothing
        deforms.
        """
        with np.errstate(divide="ignore"):
            stiffness: Floats = self.area / self._least_compression(in_series)
        return stiffness

    def of_candidates(self, candidates: Candidates) -> Floats | None:
        """Values of the candidate segments, ``(s, 4)``; None if they are equal. Collective."""
        if not self.varies:
            return None
        scatter = candidates.scatter
        if self._there is None or self._there[0] is not scatter:
            # A scatter forwards three values of each node.
            values = np.zeros((2, scatter.index_map.size_local, 3))
            for column, of_nodes in enumerate(self.of_segments.T):
                np.maximum.at(values[column // 3, :, column % 3], self.segment_nodes, of_nodes)
            self._there = scatter, np.hstack([np.array(scatter.forward(each)) for each in values])
        means: Floats = self._there[1][candidates.segments].mean(axis=1)[:, :4]
        return means

    def stiffness_fraction(
        self, faced: Floats | None, height: Floats | None, *, in_series: bool = False
    ) -> Floats:
        """Stiffness with the layers that are pressed, divided by `stiffness`, ``(m,)`` [-]. Local.

        Args:
            faced: Values of the segments that nodes face, shape ``(m, 4)``, not finite without a
                segment; None if all segments are equal.
            height: Height of the own layer where it is pressed, relative to the mean at the node,
                ``(m,)`` [-]; None for 1. It differs from 1 at edges of cells that are not as high
                as wide.
            in_series: See `stiffness`.
        """
        if faced is None and height is None and self.least_height.min(initial=1.0) == 1.0:
            return np.ones(len(self.area))
        most = self._least_compression(in_series)
        actual = _compression(self._pressed(height), self._values(faced), in_series)
        return np.divide(most, actual, out=np.ones_like(most), where=actual > 0)

    def soft_pressure(self, faced: Floats | None) -> Floats:
        """Pressure up to which springs are soft, per impact speed [Pa s/m]. Local.

        Where surfaces meet at a relative speed v, plane waves of both sides of the impedances
        Z = rho c exert the pressure v/(1/Z_1 + 1/Z_2). Springs are soft up to one and a half times
        this pressure.

        Args:
            faced: As for `stiffness_fraction`.

        Returns:
            At each node, shape ``(m,)``; infinite where nothing deforms.
        """
        slowness = self.own[:, 1] + self._values(faced)[:, 1]
        pressure: Floats = np.full_like(slowness, np.inf)
        return np.divide(_BEYOND_WAVES, slowness, out=pressure, where=self.deforms)

    def depth_per_speed(self, faced: Floats | None, height: Floats | None) -> Floats:
        """Compression of springs in implicit steps by `soft_pressure`, ``(m,)`` [s]. Local.

        Arguments as for `stiffness_fraction`.
        """
        depth: Floats = np.full(len(self.area), np.inf)
        compression = SOFT * _compression(
            self._pressed(height), self._values(faced), in_series=False
        )
        return np.multiply(self.soft_pressure(faced), compression, out=depth, where=self.deforms)

    def _values(self, faced: Floats | None) -> Floats:
        """Values of the segments faced, the least ones where they are not known, ``(m, 4)``."""
        if faced is None:
            return self.least
        return np.where(np.isfinite(faced), np.fmax(faced, self.least), self.least)

    def _least_compression(self, in_series: bool) -> Floats:
        """Least compression per pressure, for `stiffness`, ``(m,)`` [m/Pa]."""
        return _compression(self._pressed(self.least_height), self.least, in_series)

    def _pressed(self, height: Floats | None) -> Floats:
        """Values of the own layers with relative heights, see `stiffness_fraction`, ``(m, 4)``."""
        if height is None:
            return self.own
        own = self.own.copy()
        own[:, 0] *= height
        return own


def _compression(own: Floats, other: Floats, in_series: bool) -> Floats:
    """Compression per pressure of two layers: of the softer one, or of both in series, ``(m,)``."""
    join = np.add if in_series else np.maximum
    compression: Floats = join(_limited(own, other), _limited(other, own))
    return compression


def _limited(layer: Floats, body: Floats) -> Floats:
    """Compression per pressure of layers of the height that the other body admits, ``(m,)``."""
    compression: Floats = np.fmin(layer[:, 0], layer[:, 2] * body[:, 3])
    return compression


def _heights(
    pair: ContactPair, heights: Sequence[Floats], moduli: Sequence[Floats]
) -> list[Floats]:
    """Largest heights of layers opposite the nodes of both sides [m]. Collective.

    Args:
        pair: The pair.
        heights: Heights of the layers of both sides [m].
        moduli: P-wave moduli there [Pa].
    """
    deforming = [h[np.isfinite(m)] for h, m in zip(heights, moduli, strict=True)]
    extremes = [
        *(h.max(initial=0.0) for h in deforming),
        *(-h.min(initial=np.inf) for h in heights),
    ]
    most = reductions.largest(pair.nodes.V.mesh.comm, np.array(extremes))
    highest, lowest = most[:2], -most[2:]
    farthest = float(highest.max()) or 1.0
    # A body is at least as thick as its cells are high.
    return [
        _THICK * walls(side, farthest / _THICK)
        if isinstance(side, Surface) and other > _THICK * own
        else np.full(len(height), farthest)
        for side, height, own, other in zip(
            (pair.nodes, pair.segments), heights, lowest, highest[::-1], strict=True
        )
    ]
