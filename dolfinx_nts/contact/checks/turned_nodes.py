"""Check of nodes that touch along another normal than that of their own facets."""

import logging
from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.method import NODES
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.parallel import reductions

__all__ = ["TurnedNodes"]

_logger = logging.getLogger("dolfinx_nts")

# Least cosine between the contact normal and the inward normal of a facet at the node [-]: 45
# degrees. Facets that meet flush, and those of round bodies, have larger ones; where an edge of the
# segments presses on a face, forces along the normal of a segment are wrong from smaller angles on,
# but coarse round surfaces reach these, too.
_ALONG = 0.7
# Number of steps between two checks [-]. Larger: later warnings; smaller: more time.
_EVERY = 10


class TurnedNodes:
    """Check of nodes within smooth faces that touch along the normal of a segment, not of the face.

    A node on an edge of the segments gets the normal of a segment, in node-to-segment contact. If
    its face rolls over the edge, the edge presses on the face along the normal of the face. Nodes
    on edges and tips of their own body may be touched from many sides and are not checked.
    Collective, as are all methods.

    Args:
        contacts: Contact of all pairs.
    """

    def __init__(self, contacts: Sequence[PairState]) -> None:
        self._watched = [each for each in contacts if each.pair.method == NODES]

    def check_at(self, step: int, x: Floats, t: float) -> None:
        """Check after some of the steps, by their number. Other arguments as for `check`."""
        if self._watched and step % _EVERY == 0:
            self.check(x, t)

    def check(self, x: Floats, t: float) -> None:
        """Check the accepted contact, and warn once for each pair.

        Args:
            x: Positions of the local nodes, shape ``(l, 3)`` [m].
            t: Time [s].
        """
        for contact in tuple(self._watched):
            nodes, history = contact.nodes, contact.history
            presses = history.active & (history.force != 0).any(axis=1)
            normal = np.where(presses[:, None], history.normal, 0.0)
            turned = presses & contact.facets.turns_from(x, normal, _ALONG)
            number = int(reductions.total(nodes.V.mesh.comm, np.count_nonzero(turned)))
            if number:
                self._watched.remove(contact)
                self._warn(contact, reference_positions(nodes.V)[nodes.nodes[turned]], t)

    @staticmethod
    def _warn(contact: PairState, X: Floats, t: float) -> None:
        comm = contact.nodes.V.mesh.comm
        places = [place for each in comm.allgather(X.tolist()) for place in each]
        if comm.rank == 0:
            _logger.warning(
                "at t = %g s, %d nodes of contact between %s press along normals that differ by "
                "more than 45 degrees from those of their facets, such as the one at %s m in the "
                "reference configuration: an edge presses on a face there, and the direction of "
                "the force is wrong; exchange both sides, so that the edge gives nodes, or use "
                "method='mortar' between bodies that deform",
                *(t, len(places), contact.pair.between, np.round(min(places), 6).tolist()),
            )
