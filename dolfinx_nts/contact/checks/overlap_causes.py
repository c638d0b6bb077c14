"""Causes of overlaps of bodies, and remedies, for warnings."""

from collections.abc import Collection, Sequence

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.method import EDGES, MORTAR
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.edges.rigid_edge_search import num_sharp_edges
from dolfinx_nts.search.overlap.overlaps import Overlap

__all__ = ["OverlapCauses", "Role"]

# Penetration of contact nodes relative to the initial overlap [-] below which the pair does not
# detect the overlap.
_SEEN = 0.1
# A contact pair, with the names of the bodies of its nodes and of its segments.
Role = tuple[PairState, frozenset[str], frozenset[str]]


class OverlapCauses:
    """Causes of overlaps, from the contact pairs of the two bodies.

    Texts may contain the names ``{inner}`` and ``{outer}`` of the two bodies.

    Args:
        bodies: The bodies.
        roles: The contact pairs, with the names of their bodies.
        obstacles: Names of the obstacles.
        is_static: Whether there is no inertia, for the remedies.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        roles: Sequence[Role],
        obstacles: Collection[str],
        *,
        is_static: bool,
    ) -> None:
        self._bodies, self._roles = bodies, roles
        self._obstacles, self._is_static = frozenset(obstacles), is_static

    def between_bodies(self, overlap: Overlap) -> bool:
        """Whether two different bodies overlap, and no obstacle. Local."""
        one, other = overlap.names
        return one != other and not self._obstacles.intersection(overlap.names)

    def without_pair(self, overlap: Overlap) -> str:
        """Cause and remedy if the bodies of an overlap have no common pair, otherwise ""."""
        one, other = overlap.names
        sides = [side for _, a, b in self._roles for side in ((a, b), (b, a))]
        if any(one in nodes and other in segments for nodes, segments in sides):
            return ""
        if one == other:
            return (
                "it has no self contact, and parts of it pass through each other; "
                "all_pairs(self_contact=[...]) adds it"
            )
        return (
            "no contact pair contains both, so that no contact force acts between them; add one, "
            "for instance by all_pairs, unless this is intended"
        )

    def at_start(self, overlap: Overlap, x: Floats) -> str:
        """Cause of an overlap of the initial positions, shape ``(l, 3)`` [m]. Collective."""
        if verdict := self.without_pair(overlap):
            return verdict
        both = set(overlap.names)
        seen = [
            _deepest(contact, contact.gap(x, max(overlap.size, contact.search.initial_depth)))
            for contact, nodes, segments in self._roles
            if both <= nodes | segments
        ]
        depth = max(seen)
        if depth < _SEEN * overlap.depth and self._has_mean_gaps(both):
            return (
                "their contact pair closes mean gaps over facets, not those of single points; "
                "harmless where round surfaces touch, as forces act once mean gaps are closed; "
                "otherwise move the bodies apart before the first step"
            )
        if depth < _SEEN * overlap.depth:
            return (
                "their contact pair does not detect this, as it checks its nodes only, to a depth "
                "of half a facet; no force acts there, and the bodies may pass through each other; "
                "move them apart before the first step"
            )
        if depth < overlap.depth / 2:
            return (
                f"the nodes of their contact pair are {depth:.3g} m inside; harmless between "
                "facets of round surfaces that fit, as in a shrink fit; otherwise move the bodies "
                "apart before the first step, as no force acts on the deeper parts"
            )
        if self._is_static:
            return "harmless if intended: the first step makes a press fit, and closes the gaps"
        return (
            "harmless if intended: a step of QuasiStatic makes a press fit, from which "
            "load_state continues with inertia; without it, elastic impact keeps this depth, "
            "while plastic impact and springs throw the bodies apart; otherwise move them apart "
            "before the first step"
        )

    def in_run(self, overlap: Overlap) -> str:
        """Cause of an overlap in a run, and remedy. Collective."""
        if verdict := self.without_pair(overlap):
            return verdict
        inner, outer = overlap.names
        if overlap.nodes == 0 and self._lacks_edges(overlap):
            return (
                "edges of both cross between nodes, which their contact pairs do not detect; add "
                "contact of edges: all_pairs(..., edges=True), or a further pair of the same "
                "surfaces with method='edge-to-edge'"
            )
        held = [
            contact
            for contact, nodes, segments in self._roles
            if (inner in nodes and outer in segments)
            # The deepest point is a node of the segments, but nodes of the pair may be almost as
            # deep.
            or (
                outer in nodes and inner in segments and _contact_depth(contact) > overlap.depth / 2
            )
        ]
        if not held and inner in self._obstacles:
            return (
                "their contact pair constrains only the nodes of {outer}; {inner} penetrates "
                "between them with too little contact force; use finer facets there, or, for "
                "a sharp obstacle, a meshed RigidBody, whose edges and corners have contact"
            )
        if not held:
            is_mean = self._has_mean_gaps({inner, outer})
            what = "closes mean gaps over facets" if is_mean else "constrains only the nodes"
            return f"their contact pair {what} of " + (
                "{outer}; {inner} penetrates between them; use the finer or softer surface as "
                "nodes, or both surfaces where corners or edges strike (two_half_passes, or one "
                "surface of both bodies that touches itself)"
            )
        if any(isinstance(contact.pair.enforcement, Penalty) for contact in held):
            compressed = max(map(_compression, held))
            if compressed < overlap.depth / 2:
                reason = (
                    "as mean gaps over facets are closed; finer facets reduce it"
                    if self._has_mean_gaps({inner, outer})
                    else "as nodes changed their segments under load; a smaller dt reduces it"
                )
                only = f"springs of their contact pair are compressed by {compressed:.3g} m only"
                return f"{only}, {reason}"
            return (
                "the springs of their contact pair are compressed that much; stiffer ones "
                "(eps_N), LagrangeMultiplier or a smaller dt reduce it"
            )
        if self._is_static:
            return (
                "their contact pair closes gaps of nodes; between them, and where a node touches "
                "another segment, as in concave edges, surfaces overlap: use finer facets there, "
                "and a pair for each side of a concave edge"
            )
        return (
            "multipliers keep nodes at the depth that they reached in the step in which they "
            "touched; harmless if it does not grow, and less with a smaller dt or "
            "StepControl(gap_tol=...); if it grows, the pair lacks surfaces that touch "
            "(all_pairs has all of them)"
        )

    def _has_mean_gaps(self, both: set[str]) -> bool:
        """Whether mortar contact acts between two bodies. Local."""
        return any(c.pair.method == MORTAR and both <= a | b for c, a, b in self._roles)

    def _lacks_edges(self, overlap: Overlap) -> bool:
        """Whether two bodies in space have sharp edges, but no edge-to-edge contact."""
        if dimension(self._bodies[0].V) < 3 or not self.between_bodies(overlap):
            return False
        both = set(overlap.names)
        contacts = [c for c, nodes, segments in self._roles if both <= nodes | segments]
        pairs = [each.pair for contact in contacts for each in (contact, *contact.vertices)]
        sides = [side for pair in pairs for side in (pair.nodes, pair.segments)]
        return all(pair.method != EDGES for pair in pairs) and all(map(num_sharp_edges, sides))

    def is_loaded(self, overlap: Overlap) -> bool:
        """Whether an active node of two bodies is at least half as deep as their overlap."""
        both = set(overlap.names)
        of_both = [pair for pair, nodes, segments in self._roles if both <= nodes | segments]
        loaded = (each for pair in of_both for each in (pair, *pair.vertices))
        return any(_deepest_loaded(each) > overlap.depth / 2 for each in loaded)


def _contact_depth(contact: PairState) -> float:
    """Largest penetration of a contact node or a loaded vertex of a pair [m]. Collective."""
    return max([_deepest(contact, contact.history.gap), *map(_deepest_loaded, contact.vertices)])


def _compression(contact: PairState) -> float:
    """Largest compression of a spring of a pair, or of its vertices [m]. Collective."""
    parts = contact, *contact.vertices
    return max(_deepest(each, each.history.gap - each.history.offset) for each in parts)


def _deepest_loaded(contact: PairState) -> float:
    """Largest penetration of an active node of a pair [m]. Collective."""
    return _deepest(contact, np.where(contact.history.active, contact.history.gap, np.nan))


def _deepest(contact: PairState, gap: Floats) -> float:
    """Largest penetration by the gaps of the nodes of a pair, shape ``(n,)`` [m]. Collective."""
    depth = -np.nan_to_num(gap).min(initial=0.0)
    return reductions.largest(contact.nodes.V.mesh.comm, float(depth))
