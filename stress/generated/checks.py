"""Checks of an accepted step: overlap, and forces without contact."""

from collections.abc import Callable
from typing import Any

import numpy as np

from stress.generated.judge import Array, Boundary

__all__ = ["Obstacle", "Touching", "unbalanced"]

# Depth of nodes below segments that counts as zero, relative to a facet [-]. Multipliers are exact
# at nodes; mortar constrains mean gaps, so single points are deeper on coarse facets.
NODES, MORTAR = 0.02, 0.1
# The same for vertices of the segments between nodes of the other side [-].
REVERSE = 0.25
# Force that counts as zero, relative to modulus times area of a facet [-].
FORCE = 1e-6


class Obstacle:
    """A rigid obstacle, by its signed distance.

    Args:
        gap: Distance of points ``(m, d)``, negative inside, ``(m,)`` [m].
    """

    def __init__(self, gap: Callable[[Array], Array]) -> None:
        """Take the function."""
        self._gap = gap

    def depth(self, _: Array, points: Array) -> Array:
        """Depth of points, 0 outside, shape ``(m,)`` [m]."""
        return np.maximum(-self._gap(points), 0.0)

    def distance(self, _: Array, points: Array) -> Array:
        """Distance of points from the surface, shape ``(m,)`` [m]."""
        return np.abs(self._gap(points))


class Touching:
    """Two bodies, or a body and an obstacle, that may touch and not overlap.

    Args:
        nodes: Boundary of the body that gives the nodes.
        segments: The other boundary, or an obstacle.
        facet: Size of a facet [m].
        modulus: Young's modulus [Pa].
        mortar: Whether mean gaps are constrained.
        moving: Whether the scheme is one of elastic impact, which allows half of the approach in
            a step.
    """

    def __init__(
        self,
        nodes: Boundary,
        segments: Boundary | Obstacle,
        facet: float,
        modulus: float,
        mortar: bool = False,
        moving: bool = False,
    ) -> None:
        """Take boundaries and tolerances."""
        self._nodes, self._segments, self._facet, self._moving = nodes, segments, facet, moving
        self._tolerance = facet * (MORTAR if mortar else NODES)
        self._reverse = facet * REVERSE
        self._force = FORCE * modulus

    def wrong(
        self,
        before: Array,
        x: Array,
        forces: tuple[Any, Any] | None = None,
        free: float = 0.0,
    ) -> str:
        """Describe the violated condition at the end of a step, or return "".

        Args:
            before: Positions of the nodes at its start, shape ``(n, d)`` [m].
            x: Those at its end.
            forces: Nodes with multipliers and their values [N].
            free: Motion in the step without contact, at least [m].
        """
        approach = max(free, self._approach(before, x)) if self._moving else 0.0
        allowed = self._tolerance + approach / 2
        at_nodes = x[np.unique(self._nodes.nodes)]
        depth = self._segments.depth(x, at_nodes).max()
        if not np.all(np.isfinite(x)):
            return "positions are not finite"
        if depth > allowed:
            return f"nodes are {depth / self._facet:.3g} facets inside ({_part(depth, allowed)})"
        allowed = self._reverse + approach / 2
        depth = self._segments.depth(x, self._nodes.samples(x)).max()
        if isinstance(self._segments, Boundary):
            depth = max(depth, self._nodes.depth(x, self._segments.samples(x)).max())
        if depth > allowed:
            return f"facets are {depth / self._facet:.3g} facets inside ({_part(depth, allowed)})"
        return self._without_touch(x, forces, approach) if forces is not None else ""

    def _approach(self, before: Array, x: Array) -> float:
        """Largest relative motion of the two boundaries in a step, bounded by their sum [m]."""
        ends = [self._nodes]
        if isinstance(self._segments, Boundary):
            ends.append(self._segments)
        return float(sum(np.linalg.norm((b.weights @ (x - before)), axis=1).max() for b in ends))

    def _without_touch(self, x: Array, forces: tuple[Any, Any], approach: float) -> str:
        """Name a node with a contact force whose facets do not touch, or return ""."""
        for node, force in zip(*forces, strict=True):
            if abs(force) <= self._force * self._facet ** (x.shape[1] - 1):
                continue
            patch = self._nodes.patch(x, node)
            gap = self._segments.distance(x, patch).min()
            inside = self._segments.depth(x, patch).max() > 0
            if gap > self._tolerance + approach and not inside:
                return f"force {force:.4g} N at a gap of {gap / self._facet:.3g} facets"
        return ""


def _part(depth: float, allowed: float) -> str:
    return f"{depth / allowed:.1f} times as deep as allowed"


def unbalanced(forces: list[Any], scale: float, tolerance: float = 1e-5) -> str:
    """Describe the imbalance of forces on a body in equilibrium, or return ""."""
    rest = float(np.linalg.norm(np.sum(forces, axis=0)))
    is_wrong = rest > tolerance * scale
    return f"forces do not balance by {rest:.4g} of {scale:.4g} N" if is_wrong else ""
