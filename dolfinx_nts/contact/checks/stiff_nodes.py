"""Check for nodes on the stiffer and finer of two surfaces."""

import logging
from collections.abc import Sequence

import numpy as np

from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.surfaces import Surface, facet_size_towards
from dolfinx_nts.parallel import reductions

__all__ = ["warn_of_stiff_nodes"]

_logger = logging.getLogger("dolfinx_nts")

# Ratio of the moduli, and least ratio of the facets of the softer to those of the stiffer body [-],
# from which on a warning is issued. At equal moduli pressures of a Hertz contact are right within
# 4 % whichever body gives the nodes. Those of nodes that are ten times as stiff scatter by 4, 6, 23
# and 33 % on facets that are 1, 1/1.5, 1/2 and 1/3 as long, those of nodes 1e4 times as stiff by
# 96 % from 1/1.5 on, and those of a flat punch by 100 % at equal lengths.
_STIFFER, _FINER = 5.0, 0.9


def warn_of_stiff_nodes(bodies: Sequence[Body], pairs: Sequence[ContactPair]) -> None:
    """Warn of nodes on a stiffer body whose facets are no longer than the segments. Collective.

    The softer body then has fewer degrees of freedom than there are multipliers: patterns of
    pressures that alternate from node to node deform it hardly, and remain undetermined.

    Args:
        bodies: All bodies of a stepper.
        pairs: Its contact pairs.
    """
    V = bodies[0].V
    comm, modulus = V.mesh.comm, np.full(len(reference_positions(V)), np.inf)
    for body in bodies:
        # At nodes of several bodies that of the softest one; no check of energies with fields.
        own = np.inf if body.is_rigid else body.material.least_modulus
        modulus[body.nodes] = np.minimum(modulus[body.nodes], own)
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
        if sizes[1] < _FINER * sizes[0] or comm.rank:
            continue
        _logger.warning(
            "nodes of contact between %s are on the stiffer body, and its facets are no longer "
            "than those of the softer one: forces are right, but pressures may alternate from node "
            "to node; let the softer body give the nodes, with facets of at most %.3g m",
            pair.between,
            sizes[0],
        )
