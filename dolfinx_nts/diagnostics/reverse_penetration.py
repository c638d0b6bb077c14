"""Vertices of segments that sink into the surface of the nodes.

Node-to-segment contact is one-sided: it keeps nodes out of segments, not the
vertices of the segments out of the facets between the nodes.
"""

import logging

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.global_search import GlobalSearch

__all__ = ["ReversePenetration"]


_logger = logging.getLogger("dolfinx_nts")

_DEEP = 0.1  # of the largest facet


class ReversePenetration:
    """Looks for them in the pairs of a stepper, and warns once for each pair.

    Self contact and pairs that are there in both directions are left out.
    Collective, as its methods.

    Args:
        stepper: What is run.

    Attributes:
        deepest: Largest depth found so far by position of the pair [m].
    """

    def __init__(self, stepper: Stepper) -> None:
        """Turn the pairs around."""
        self._stepper = stepper
        directions = {(pair.nodes, pair.segments) for pair in stepper.pairs}
        self._turned = {
            i: GlobalSearch(pair.segments, pair.nodes)
            for i, pair in enumerate(stepper.pairs)
            if isinstance(pair.segments, Surface) and (pair.segments, pair.nodes) not in directions
        }
        self.deepest = dict.fromkeys(self._turned, 0.0)

    def look(self) -> None:
        """Look at the pairs in contact as they are now."""
        comm: MPI.Comm = self._stepper.u.function_space.mesh.comm
        for i, search in self._turned.items():
            pair = self._stepper.pairs[i]
            if not reductions.anywhere(comm, bool(pair.history.active.any())):
                continue
            depth = reductions.largest(comm, _depth(pair, search, self._stepper.x))
            limit = _DEEP * pair.nodes.size
            if depth > limit >= self.deepest[i] and comm.rank == 0:
                _logger.warning(
                    "pair %d: vertices of the segments are %.3g inside the surface of the nodes, "
                    "which one-sided contact allows; the finer or softer surface should give the "
                    "nodes, or both (two_half_passes)",
                    i + 1,
                    depth,
                )
            self.deepest[i] = max(self.deepest[i], depth)


def _depth(pair: ContactPair, search: GlobalSearch, x: Floats) -> float:
    """Depth of the deepest vertex of this rank [m]. Collective."""
    assert isinstance(pair.segments, Surface)
    vertices, reach = pair.segments.nodes, pair.nodes.size
    here, _ = search.update(x, reach)
    ghosted = here.with_ghosts(x[: here.index_map.size_local])
    none = np.full(len(vertices), -1, dtype=np.int32)
    _, gap = here.pair(ghosted, vertices, none, reach)
    return float(max(0.0, -np.min(gap[~np.isnan(gap)], initial=0.0)))
