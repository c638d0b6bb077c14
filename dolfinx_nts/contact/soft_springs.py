"""Springs that are too soft: nodes sink so deep into a surface that the bodies overlap."""

import logging
from collections.abc import Sequence

import numpy as np

from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.parallel import reductions

__all__ = ["DEEP", "SoftSprings"]

_logger = logging.getLogger("dolfinx_nts")

# Depth, relative to the longest segment [-], from which on shapes are wrong to the eye: half of
# that at which a node loses its segment.
DEEP = 0.25


class SoftSprings:
    """Warns of pairs whose springs let nodes sink deep into a surface, once for each pair.

    Collective, as are its methods.

    Args:
        contacts: Contact of all pairs.
    """

    def __init__(self, contacts: Sequence[PairState]) -> None:
        """Watch the pairs with springs."""
        self._contacts = [c for c in contacts if isinstance(c.pair.enforcement, Penalty)]
        self._watched = self._contacts

    def yielding(self) -> list[PairState]:
        """Contact of the pairs whose nodes are deep inside now."""
        return [contact for contact, _ in _deep(self._contacts)]

    def watches(self, contact: PairState) -> bool:
        """Whether a pair has springs and was not told yet. Local."""
        return contact in self._watched

    def look(self) -> None:
        """Look at the accepted contact of the pairs that were not told."""
        told = _deep(self._watched)
        for contact, depth in told:
            pair = contact.pair
            if pair.nodes.V.mesh.comm.rank == 0:
                _logger.warning(
                    "springs between %s let nodes sink in by %.3g (%.0f %% of a facet): energies "
                    "count them, but the bodies overlap; take a stiffer Penalty (%s) or a "
                    "LagrangeMultiplier",
                    pair.between,
                    depth,
                    100 * depth / pair.segment_size,
                    contact,
                )
        if told:
            known = [contact for contact, _ in told]
            self._watched = [contact for contact in self._watched if contact not in known]


def _deep(contacts: Sequence[PairState]) -> list[tuple[PairState, float]]:
    """Contact whose active nodes are deep inside, and the greatest depth [m]. Collective."""
    if not contacts:
        return []
    deepest = [-c.history.gap[c.history.active].min(initial=0.0) for c in contacts]
    depths = reductions.largest(contacts[0].nodes.V.mesh.comm, np.array(deepest))
    both = zip(contacts, depths, strict=True)
    return [(c, float(depth)) for c, depth in both if depth > DEEP * c.pair.segment_size]
