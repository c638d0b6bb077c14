"""Check for penalty springs that are too soft."""

import logging
from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.obstacles.rigid_surface import RigidSurface
from dolfinx_nts.parallel import reductions

__all__ = ["SoftSprings", "deep_from"]

_logger = logging.getLogger("dolfinx_nts")

# Depths that are reported: relative to the longest segment [-], half the depth at which a node
# loses its segment; with obstacles, relative to the depth at which a node is lost [-].
_DEEP, _HALF = 0.25, 0.5


def deep_from(pair: ContactPair) -> float:
    """Penetration of the nodes of a pair above which it is reported [m]. Local."""
    limit, segments = _DEEP * pair.segment_size, pair.segments
    if isinstance(segments, RigidSurface):
        return min(limit, _HALF * max(segments.shortest_passage, segments.deepest))
    if isinstance(segments, Obstacle):
        return min(limit, _HALF * segments.shortest_passage)
    return limit


class SoftSprings:
    """Check for springs with deep penetration, and for bodies pushed through an obstacle.

    Each pair is reported once. Collective, as are its methods.

    Args:
        bodies: The bodies of a stepper.
        contacts: Contact of all pairs.
    """

    def __init__(self, bodies: Sequence[Body], contacts: Sequence[PairState]) -> None:
        self._bodies = tuple(bodies)
        self._contacts = [c for c in contacts if isinstance(c.pair.enforcement, Penalty)]
        self._watched = self._contacts

    def yielding(self) -> list[PairState]:
        """States of the pairs whose nodes are deep at present."""
        return [contact for contact, _ in _deep(self._contacts)]

    def watches(self, contact: PairState) -> bool:
        """Whether a pair has springs and was not reported yet. Local."""
        return contact in self._watched

    def pushed_through(self, x: Floats) -> str:
        """Message naming bodies that were pushed through an obstacle, or "".

        ``x`` are positions of the local nodes, shape ``(l, 3)`` [m]. Unlike other obstacles, a
        plane has no depth at which nodes are lost.
        """
        reported = [contact for contact in self._contacts if contact not in self._watched]
        return next(
            filter(None, (self._bodies_pushed_through(contact, x) for contact in reported)), ""
        )

    def _bodies_pushed_through(self, contact: PairState, x: Floats) -> str:
        """Names of bodies on the other side of the obstacle of a pair, or ""."""
        obstacle, nodes = contact.segments, contact.nodes.nodes
        if not isinstance(obstacle, Obstacle):
            return ""
        comm = contact.nodes.V.mesh.comm
        depth = obstacle.depth(contact.search.frame.at_end(x))
        for body in self._bodies:
            inside = bool((depth[body.nodes] > 0).all())
            meets = bool(np.isin(nodes, body.nodes).any())
            if reductions.everywhere(comm, inside) and reductions.anywhere(comm, meets):
                return f"{body.name} has passed completely into {obstacle.name}"
        return ""

    def check(self) -> None:
        """Check the accepted contact of pairs that were not reported."""
        deep = _deep(self._watched)
        for contact, depth in deep:
            pair = contact.pair
            if pair.nodes.V.mesh.comm.rank == 0:
                _logger.warning(
                    "springs between %s are compressed by up to %.3g (%.0f %% of a facet), so that "
                    "the bodies overlap: use a stiffer Penalty (%s) or a LagrangeMultiplier",
                    pair.between,
                    depth,
                    100 * depth / pair.segment_size,
                    contact,
                )
        if deep:
            known = [contact for contact, _ in deep]
            self._watched = [contact for contact in self._watched if contact not in known]


def _deep(contacts: Sequence[PairState]) -> list[tuple[PairState, float]]:
    """States with deep active nodes, and their largest depth [m]. Collective."""
    if not contacts:
        return []
    deepest = [-c.history.gap[c.history.active].min(initial=0.0) for c in contacts]
    depths = reductions.largest(contacts[0].nodes.V.mesh.comm, np.array(deepest))
    both = zip(contacts, depths, strict=True)
    return [(c, float(depth)) for c, depth in both if depth > deep_from(c.pair)]
