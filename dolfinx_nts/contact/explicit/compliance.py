"""Compliance of contact springs in explicit steps, which limits the step."""

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["compliance"]

# Number of edge springs that may act on one node [-]: one for each adjacent edge.
_EDGES_PER_NODE = 2.0


def compliance(pair: ContactPair, mass: Floats) -> Floats:
    """Inverse reduced masses of the springs of a pair. Collective.

    The force of an edge spring acts on both ends of an edge.

    Args:
        pair: The pair.
        mass: Lumped mass of the owned nodes, shape ``(n,)`` [kg].

    Returns:
        At each node of the surface of nodes, shape ``(m,)`` [1/kg].
    """
    nodes, segments = pair.nodes.nodes, pair.segments
    if pair.method == EDGES:
        both = (each for each in (pair.nodes, segments) if isinstance(each, Surface))
        return np.full(len(nodes), _EDGES_PER_NODE * sum(_of_lightest(each, mass) for each in both))
    own: Floats = 1 / mass[nodes]
    if isinstance(segments, Surface):
        counts = np.array([len(nodes), len(segments.nodes)], dtype=float)
        counts = reductions.total(pair.nodes.V.mesh.comm, counts)
        own += max(1.0, counts[0] / counts[1]) * _of_lightest(segments, mass)
    return own


def _of_lightest(surface: Surface, mass: Floats) -> float:
    """Inverse mass of the lightest node of a surface [1/kg]. Collective."""
    lightest = float(mass[surface.nodes].min(initial=np.inf))
    return 1 / float(reductions.least(surface.V.mesh.comm, lightest))
