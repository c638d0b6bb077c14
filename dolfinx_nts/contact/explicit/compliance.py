"""Compliance of contact springs in explicit steps, which limits the step."""

from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["NodalProperties", "compliance"]

# Number of edge springs that may act on one node [-]: one for each adjacent edge.
_EDGES_PER_NODE = 2.0


class NodalProperties(NamedTuple):
    """Properties of the owned nodes of a space on which springs depend.

    Attributes:
        mass: Lumped mass, of nodes of rigid bodies a lower bound on the effective mass, infinite
            in bodies that guides hold in all directions, shape ``(n,)`` [kg].
        is_rigid: Whether the node belongs to a rigid body, shape ``(n,)``.
        modulus, density: See `Layers.of`.
    """

    mass: Floats
    is_rigid: Flags
    modulus: Floats
    density: Floats


def compliance(pair: ContactPair, at: NodalProperties) -> Floats:
    """Inverse reduced masses of the springs of a pair. Collective.

    The force of an edge spring acts on both ends of an edge.

    Args:
        pair: The pair.
        at: Properties of the nodes.

    Returns:
        At each node of the surface of nodes, shape ``(m,)`` [1/kg]; 1 where neither side can move.
    """
    nodes, segments = pair.nodes.nodes, pair.segments
    if pair.method == EDGES:
        both = [each for each in (pair.nodes, segments) if isinstance(each, Surface)]
        ends = _EDGES_PER_NODE * sum(max(_of_lightest(each, at)) for each in both)
        own: Floats = np.full(len(nodes), ends)
    else:
        own = 1 / at.mass[nodes]
        if isinstance(segments, Surface):
            counts = np.array([len(nodes), len(segments.nodes)], dtype=float)
            counts = reductions.total(pair.nodes.V.mesh.comm, counts)
            ratio = counts[0] / counts[1]
            # A node presses on one segment. The mass of a rigid body resists it as a whole.
            deformable, rigid = _of_lightest(segments, at)
            own += max(max(1.0, ratio) * deformable, ratio * rigid)
    own[own == 0] = 1.0
    return own


def _of_lightest(surface: Surface, at: NodalProperties) -> tuple[float, float]:
    """Inverse masses of the lightest deformable and rigid nodes of a surface [1/kg]. Collective."""
    mass, is_rigid = at.mass[surface.nodes], at.is_rigid[surface.nodes]
    lightest = [mass[flags].min(initial=np.inf) for flags in (~is_rigid, is_rigid)]
    deformable, rigid = reductions.least(surface.V.mesh.comm, np.array(lightest, dtype=float))
    return 1 / float(deformable), 1 / float(rigid)
