"""Stiffness of the cells at the springs of a contact pair.

A layer of cells of height h, between nodes, and P-wave modulus M has the stiffness M/h per area.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.model.layers import layers
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import Candidates
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
# Relative difference of layers that counts as zero [-], larger than round-off.
_EQUAL = 1e-6


@dataclass
class Layers:
    """Layers of cells at the nodes of a pair, and at the segments that the nodes may face.

    A pair may have segments of cells of many sizes, or of several bodies. A spring has the
    stiffness of the segment that its node faces when contact begins.

    Attributes:
        area: Areas of the ``m`` nodes, shape ``(m,)`` [m^2].
        own: Compression of the layer of each node per pressure [m/Pa], 0 where it does not deform,
            and slowness 1/(rho c) of its waves [m^2 s/kg], shape ``(m, 2)``.
        least: The least values of the segments that deform, for each node, ``(m, 2)``; 0 if none
            deforms.
        segment_nodes, of_segments: Owned nodes of the segments, ``(k,)``, and their values,
            ``(k, 2)``.
        varies: Whether the values of the segments differ.
    """

    area: Floats
    own: Floats
    least: Floats
    segment_nodes: Ints
    of_segments: Floats
    varies: bool
    # Values at the nodes of a map, kept while the candidates have this map.
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
        nodes, segments = pair.nodes, pair.segments
        slowness: Floats = np.zeros(len(modulus))
        if density is not None:
            slowness = 1 / np.sqrt(density * modulus)
        area, compression = layers(nodes, modulus)
        own = np.column_stack([compression, slowness[nodes.nodes]])
        others: Ints = np.empty(0, dtype=np.int32)
        there: Floats = np.empty((0, 2))
        extremes: Floats = np.full((2, 2), -np.inf)
        if isinstance(segments, Surface):
            others, (_, compression) = segments.nodes, layers(segments, modulus)
            there = np.column_stack([compression, slowness[others]])
            deforming = there[compression > 0]
            if len(deforming):
                extremes[:] = -deforming.min(axis=0), deforming.max(axis=0)
        extremes = reductions.largest(nodes.V.mesh.comm, extremes)
        least = np.where(np.isfinite(extremes[0]), -extremes[0], 0.0)
        varies = bool(np.any(extremes[1] > (1 + _EQUAL) * least) and least[0] > 0)
        return cls(area, own, np.tile(least, (len(area), 1)), others, there, varies)

    @classmethod
    def joint(cls, parts: Sequence["Layers"]) -> "Layers":
        """Layers of several pairs, node by node. Local."""
        names = ("area", "own", "least", "segment_nodes", "of_segments")
        area, own, least, nodes, values = (
            np.concatenate([getattr(part, name) for part in parts]) for name in names
        )
        return cls(area, own, least, nodes, values, any(part.varies for part in parts))

    @classmethod
    def serialized(
        cls, archive: Archive, name: str, pair: ContactPair, layers: "Layers | None"
    ) -> "Layers | None":
        """The layers of a pair, or those of the archive when it is read. Collective."""
        if not archive.same(f"{name}_exist", layers is not None):
            return None
        m, segments = len(pair.nodes.nodes), pair.segments
        others: Ints = np.empty(0, dtype=np.int32)
        if isinstance(segments, Surface):
            others = segments.nodes
        if layers is None:
            values = np.zeros(m), np.zeros((m, 2)), np.zeros((m, 2))
            layers = cls(*values, others, np.zeros((len(others), 2)), False)
        area, own, least = (
            archive.nodal(f"{name}_{key}", pair.nodes.node_ids, getattr(layers, key))
            for key in ("area", "own", "least")
        )
        there = layers.of_segments
        if isinstance(segments, Surface):
            there = archive.nodal(f"{name}_segments", segments.node_ids, there)
        varies = bool(archive.same(f"{name}_vary", layers.varies))
        return cls(area, own, least, others, there, varies)

    @property
    def deforms(self) -> Flags:
        """Whether the nodes or the segments deform, shape ``(m,)``. Local."""
        flags: Flags = np.fmax(self.own, self.least)[:, 0] > 0
        return flags

    def stiffness(self, *, in_series: bool = False) -> Floats:
        """Largest stiffness, where the stiffest segment is faced, ``(m,)`` [N/m]. Local.

        It is that of the softer layer, or of both layers in series; infinite where nothing deforms.
        """
        with np.errstate(divide="ignore"):
            stiffness: Floats = self.area / self._compression(self.least, in_series)
        return stiffness

    def of_candidates(self, candidates: Candidates) -> Floats | None:
        """Values of the candidate segments, ``(s, 2)``; None if they are equal. Collective."""
        if not self.varies:
            return None
        scatter = candidates.scatter
        if self._there is None or self._there[0] is not scatter:
            values = np.zeros((scatter.index_map.size_local, 3))
            for column, of_nodes in enumerate(self.of_segments.T):
                np.maximum.at(values[:, column], self.segment_nodes, of_nodes)
            self._there = scatter, np.array(scatter.forward(values))
        means: Floats = self._there[1][candidates.segments].mean(axis=1)[:, :2]
        return means

    def stiffness_fraction(self, faced: Floats | None, *, in_series: bool = False) -> Floats:
        """Stiffness with the segments that nodes face, divided by `stiffness`, ``(m,)`` [-]. Local.

        Args:
            faced: Values of these segments, shape ``(m, 2)``, not finite without a segment; None if
                all segments are equal.
            in_series: See `stiffness`.
        """
        if faced is None:
            return np.ones(len(self.area))
        most = self._compression(self.least, in_series)
        actual = self._compression(self._known(faced), in_series)
        return np.divide(most, actual, out=np.ones_like(most), where=actual > 0)

    def depth_per_speed(self, faced: Floats | None) -> Floats:
        """Compression at which springs change to the stiff slope, per impact speed [s]. Local.

        Where surfaces meet at a relative speed v, plane waves of both sides of the impedances
        Z = rho c exert the pressure v/(1/Z_1 + 1/Z_2). Up to one and a half times this pressure
        springs are soft.

        Args:
            faced: As for `stiffness_fraction`.

        Returns:
            At each node, shape ``(m,)``; infinite where nothing deforms.
        """
        other = self.least if faced is None else self._known(faced)
        slowness = self.own[:, 1] + other[:, 1]
        depth = _BEYOND_WAVES * SOFT * np.fmax(self.own, other)[:, 0]
        return np.divide(depth, slowness, out=np.full_like(depth, np.inf), where=self.deforms)

    def _known(self, faced: Floats) -> Floats:
        return np.where(np.isfinite(faced), np.fmax(faced, self.least), self.least)

    def _compression(self, other: Floats, in_series: bool) -> Floats:
        join = np.add if in_series else np.maximum
        compression: Floats = join(self.own[:, 0], other[:, 0])
        return compression
