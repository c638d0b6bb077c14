"""Springs that are too soft: nodes sink so deep into a surface that the bodies overlap."""

import logging
from collections.abc import Sequence

import numpy as np

from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.parallel import reductions

__all__ = ["SoftSprings"]

_logger = logging.getLogger("dolfinx_nts")

# Depth, relative to the longest segment [-], from which on shapes are wrong to the eye: half of
# that at which a node loses its segment.
_DEEP = 0.25


class SoftSprings:
    """Warns of pairs whose springs let nodes sink deep into a surface, once for each pair.

    Collective, as is `look`.

    Args:
        contacts: Contact of all pairs.

    Attributes:
        yielding: Contact of the pairs that were told.
    """

    def __init__(self, contacts: Sequence[PairState]) -> None:
        """Watch the pairs with springs."""
        self.yielding: list[PairState] = []
        self._watched = [c for c in contacts if isinstance(c.pair.enforcement, Penalty)]

    def look(self) -> None:
        """Look at the accepted contact."""
        if not self._watched:
            return
        comm = self._watched[0].nodes.V.mesh.comm
        deepest = [-c.history.gap[c.history.active].min(initial=0.0) for c in self._watched]
        depths = reductions.largest(comm, np.array(deepest))
        for contact, depth in zip(self._watched, depths, strict=True):
            pair = contact.pair
            if depth <= _DEEP * pair.segment_size:
                continue
            self.yielding.append(contact)
            if comm.rank == 0:
                _logger.warning(
                    "springs between %s let nodes sink in by %.3g (%.0f %% of a facet): energies "
                    "count them, but the bodies overlap; take a stiffer Penalty (%s) or a "
                    "LagrangeMultiplier",
                    pair.between,
                    depth,
                    100 * depth / pair.segment_size,
                    contact,
                )
        self._watched = [each for each in self._watched if each not in self.yielding]
