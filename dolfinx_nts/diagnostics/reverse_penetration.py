"""Reverse penetration: vertices of segments inside the surface of the nodes.

Node-to-segment contact is one-sided. It stops nodes at segments, but not the vertices of the
segments at the facets between the nodes.
"""

import logging

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.points import NodalPoints

__all__ = ["ReversePenetration"]

_logger = logging.getLogger("dolfinx_nts")

# Depth, relative to the size of the largest facet [-], above which a warning is worthwhile.
_DEEP = 0.1


class ReversePenetration:
    """Finds vertices of segments inside the surface of the nodes, and warns once for each pair.

    Self contact and pairs in both directions are left out. Collective, as are all its methods.

    Args:
        stepper: The stepper.

    Attributes:
        deepest: Largest depth found so far by position of the pair [m].
    """

    def __init__(self, stepper: Stepper) -> None:
        """Make the searches, in which nodes and segments change places."""
        self._stepper = stepper
        directions = {(pair.nodes, pair.segments) for pair in stepper.pairs}
        self._turned = {
            i: (GlobalSearch(pair.segments, pair.nodes), pair.segments.nodes)
            for i, pair in enumerate(stepper.pairs)
            if isinstance(pair.segments, Surface) and (pair.segments, pair.nodes) not in directions
        }
        self.deepest = dict.fromkeys(self._turned, 0.0)

    def look(self) -> None:
        """Look at the pairs that are in contact in the present state."""
        comm: MPI.Comm = self._stepper.u.function_space.mesh.comm
        for i, (search, vertices) in self._turned.items():
            contact = self._stepper.contacts[i]
            if not reductions.anywhere(comm, bool(contact.history.active.any())):
                continue
            depth = _depth(vertices, search, self._stepper.x, contact.nodes.size)
            depth = reductions.largest(comm, depth)
            limit = _DEEP * contact.nodes.size
            if depth > limit >= self.deepest[i] and comm.rank == 0:
                _logger.warning(
                    "vertices of %s are %.3g (%.0f %% of a facet) inside %s, whose nodes alone are "
                    "stopped: the energies are right, the shapes are not; let the finer or softer "
                    "surface give the nodes, or both (two_half_passes)",
                    contact.segments.name,
                    depth,
                    100 * depth / contact.nodes.size,
                    contact.nodes.name,
                )
            self.deepest[i] = max(self.deepest[i], depth)


def _depth(vertices: Ints, search: GlobalSearch, x: Floats, reach: float) -> float:
    """Depth of the deepest of some vertices of this rank [m]. Collective.

    Args:
        vertices: Local indices of the vertices, shape ``(v,)``.
        search: Finds the facets between the contact nodes.
        x: Positions of the local nodes, shape ``(l, 3)`` [m].
        reach: Largest depth of interest [m].
    """
    facets, _ = search.update(x, reach)
    none = np.full(len(vertices), -1, dtype=np.int32)
    _, gap = facets.pair(NodalPoints(vertices), facets.scatter.forward(x), none, reach)
    return float(max(0.0, -np.min(gap[~np.isnan(gap)], initial=0.0)))
