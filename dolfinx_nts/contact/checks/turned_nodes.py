"""Check of nodes that touch along another normal than that of their own facets."""

import logging
import math
from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.method import NODES
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.obstacles.rigid_surface import RigidSurface
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["TurnedNodes"]

_logger = logging.getLogger("dolfinx_nts")

# Cosine of the angle between the contact normal and the inward normals of all facets at a node [-]
# below which there is a warning. Larger: warnings for coarse round surfaces, whose facets meet at
# tens of degrees. Smaller: later warnings; the force on a block that tips over an edge is wrong
# from the angle of friction on.
_ALONG = math.cos(math.radians(45))
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
        # Only segments of meshes and of rigid surfaces have edges.
        self._watched = [
            each
            for each in contacts
            if each.pair.method == NODES and isinstance(each.pair.segments, Surface | RigidSurface)
        ]

    def check_at(self, step: int, x: Floats, t: float) -> None:
        """Check after every tenth step. Other arguments as for `check`."""
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
            if reductions.anywhere(nodes.V.mesh.comm, bool(turned.any())):
                self._watched.remove(contact)
                self._warn(contact, reference_positions(nodes.V)[nodes.nodes[turned]], t)

    @staticmethod
    def _warn(contact: PairState, X: Floats, t: float) -> None:
        comm = contact.nodes.V.mesh.comm
        places = [place for each in comm.allgather(X.tolist()) for place in each]
        if comm.rank == 0:
            _logger.warning(
                "at t = %g s, nodes of contact between %s press along normals that differ by "
                "more than 45 degrees from those of their facets, at %d nodes, one of them at "
                "%s m in the reference configuration: an edge presses on a face there, and the "
                "direction of the force is wrong; exchange both sides, so that the edge gives "
                "nodes, or use method='mortar' between bodies that deform",
                *(t, contact.pair.between, len(places), np.round(min(places), 6).tolist()),
            )
