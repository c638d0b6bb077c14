"""Default stiffness of contact springs in explicit steps."""

import numpy as np
from dolfinx import la

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["SOFT", "compliance", "stiffness_of_cells"]

# Compliance of a default spring relative to that of the layers of cells between which it acts [-].
# Light nodes on a stiffer spring vibrate above all frequencies of the cells, so that cells cannot
# carry the vibration away: the contact force of colliding rods then scatters by 15 % (1), 9 %
# (1.25), 4 % (5/3), 3 % (2) of its mean for ever. A softer spring closes by more, and the force
# needs more cells to rise. Measured on the rods of tests/verification/test_rods.py with 40 cells,
# at the default step.
SOFT = 5 / 3

# Number of edge springs that may act on one node [-]: one for each adjacent edge.
_EDGES_PER_NODE = 2.0


def compliance(pair: ContactPair, mass: Floats) -> Floats:
    """Inverse effective masses of the springs of a pair, of both sides. Collective.

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


def stiffness_of_cells(pair: ContactPair, modulus: Floats) -> Floats:
    """Stiffness of the layers of cells on both sides of a pair at its springs. Collective.

    A layer of height h, between nodes, and modulus M has the stiffness M/h per area. Layers of both
    sides are in series; for that of the segments the mean is taken.

    Args:
        pair: The pair.
        modulus: P-wave modulus at the owned nodes, shape ``(n,)`` [Pa]; infinite in bodies that do
            not deform, and where it vanishes, so that cells say nothing of the springs.

    Returns:
        At each node of the surface of nodes, shape ``(m,)`` [N/m]; infinite where nothing deforms.
    """
    nodes, segments = pair.nodes, pair.segments
    area, closing = _layers(nodes, modulus)
    if isinstance(segments, Surface):
        of_nodes, other = _layers(segments, modulus)
        sums = np.array([of_nodes @ other, of_nodes.sum()])
        sums = reductions.total(nodes.V.mesh.comm, sums)
        closing += sums[0] / sums[1]
    with np.errstate(divide="ignore"):
        stiffness: Floats = area / closing
    return stiffness


def _layers(surface: Surface, modulus: Floats) -> tuple[Floats, Floats]:
    """Layers of cells behind the nodes of a surface. Collective.

    Returns:
        Reference areas of the nodes, positive at any degree, shape ``(m,)`` [m^2], and compression
        of the layer per pressure, shape ``(m,)`` [m/Pa].
    """
    V = surface.V
    X, height = reference_positions(V)[surface.segments], surface.thickness / Element.of(V).degree
    area = np.linalg.norm(area_vectors(X, surface.orientation), axis=1) / X.shape[1]
    if is_axisymmetric(V.mesh):
        area *= 2 * np.pi * X[:, :, 0].mean(axis=1)
    sums = la.vector(V.dofmap.index_map, 2)
    for vertex in surface.segments.T:
        np.add.at(sums.array.reshape(-1, 2), vertex, np.column_stack([area, area * height]))
    sums.scatter_reverse(la.InsertMode.add)
    of_nodes, volume = sums.array.reshape(-1, 2)[surface.nodes].T
    return of_nodes, volume / of_nodes / modulus[surface.nodes]


def _of_lightest(surface: Surface, mass: Floats) -> float:
    """Inverse mass of the lightest node of a surface [1/kg]. Collective."""
    lightest = float(mass[surface.nodes].min(initial=np.inf))
    return 1 / float(reductions.least(surface.V.mesh.comm, lightest))
