"""Check for nodes on the stiffer and finer of two surfaces."""

import logging
from collections.abc import Sequence

import numpy as np

from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.moduli import least_moduli
from dolfinx_nts.model.surfaces import Surface, facet_size_towards
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.kinks import arc_length

__all__ = ["warn_of_stiff_nodes"]

_logger = logging.getLogger("dolfinx_nts")

# Ratio of the moduli, and size of the soft facets relative to the stiff ones, above which nodes on
# the stiff body are reported [-]. Smaller: warnings although pressures are right within 4 %, as in
# a Hertz contact of equal moduli with any sizes; larger: no warning although pressures scatter. At
# a ratio of moduli of 10 they scatter by 4, 6, 23 and 33 % for soft facets that are 1, 1.5, 2 and 3
# times as long; at 1e4 by 96 % from 1.5 on, and below a flat punch by 100 % at equal lengths.
_STIFFER, _FINER = 5.0, 0.9


def warn_of_stiff_nodes(bodies: Sequence[Body], pairs: Sequence[ContactPair]) -> None:
    """Warn of nodes on a stiffer body whose facets are no longer than the segments. Collective.

    The softer body then has fewer degrees of freedom than there are multipliers: pressures
    that alternate from node to node hardly deform it, and remain undetermined.

    Args:
        bodies: All bodies of a stepper.
        pairs: Its contact pairs.
    """
    comm, modulus = bodies[0].V.mesh.comm, least_moduli(bodies)
    for pair in pairs:
        if pair.touches_itself or not isinstance(pair.segments, Surface):
            continue
        of_nodes, of_segments = (modulus[side.segments] for side in (pair.nodes, pair.segments))
        softest = reductions.least(comm, float(of_nodes.min(initial=np.inf)))
        stiffest = reductions.largest(comm, float(of_segments.max(initial=0.0)))
        if not (softest >= _STIFFER * stiffest and np.isfinite(stiffest)):
            continue
        two = pair.nodes, pair.segments
        sizes = facet_size_towards(*two), facet_size_towards(*two[::-1])
        # Facets of the softer body would not resolve a rounder one.
        if sizes[1] < _FINER * sizes[0] or arc_length(*two) < sizes[1] or comm.rank:
            continue
        _logger.warning(
            "nodes of contact between %s are on the stiffer body, and its facets are no longer "
            "than those of the softer one: pressures may alternate from node to node, and friction "
            "may be some percent too small; let the softer body provide the nodes, with facets of "
            "at most %.3g m",
            pair.between,
            sizes[0],
        )
