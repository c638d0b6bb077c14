"""Initial adjustment: nodes are moved onto adjacent segments without stress.

Meshes of touching bodies seldom agree exactly. The mesh itself is moved, so that the new position
is the undeformed one.
"""

import logging

import numpy as np
from dolfinx import la

from dolfinx_nts import compat
from dolfinx_nts.common.arguments import kind_of, positive
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.pair import ContactPair, is_in_use
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.obstacles.rigid_shapes import RigidSphere
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.collective_calls import meet
from dolfinx_nts.parallel.errors import agreed
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.nodal_facets import NodalFacets
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.smooth.smooth_patches import SmoothPatches
from dolfinx_nts.search.smooth.smooth_search import SmoothSearch

__all__ = ["close_gaps"]

_logger = logging.getLogger("dolfinx_nts")

# Largest adjustment relative to the least height of the cells behind the nodes [-]. Larger values
# would change the shape of bodies.
_SHARE = 0.25
# Distance relative to a cell [-] that counts as round-off.
_ROUND_OFF = 1e-14


def close_gaps(pair: ContactPair, within: float) -> tuple[int, float]:
    """Move nodes of a pair onto the adjacent segments, without stress. Collective.

    Nodes with a gap of at most ``within`` in magnitude are moved along the normal of the segment.
    The mesh itself changes (``mesh.geometry.x``), so that the undeformed bodies touch there.
    Segments are not moved. Call it after the pair and before steppers are created: areas and cell
    heights that surfaces have already computed are not updated. The result is logged.

    Args:
        pair: Pair of two surfaces that no stepper uses yet.
        within: Largest gap that is closed [m], at most a quarter of the height of any cell
            behind the nodes.

    Returns:
        Number of moved nodes, and largest distance [m].

    Raises:
        TypeError: ``pair`` is not a ContactPair, or ``within`` not a number.
        ValueError: ``within`` is not positive or too large; ``segments`` are an obstacle or the
            surface of the nodes; the pair is in use; the space has degree 2, the mesh has curved
            cells or is axisymmetric; or a cell would be inverted. The mesh is then unchanged.

    Example:
        >>> pair = nts.ContactPair(nodes=bottom, segments=top)
        >>> moved, farthest = nts.close_gaps(pair, within=0.02)  # m
        >>> moved, round(farthest, 3)
        (4, 0.01)
    """
    reach = _checked(pair, within)
    nodes, mesh = pair.nodes, pair.nodes.V.mesh
    V, comm = nodes.V, mesh.comm
    in_geometry = np.empty(len(reference_positions(V)), dtype=np.int32)
    in_geometry[V.dofmap.list] = compat.geometry_nodes(mesh)
    node, shift = _shifts(pair, mesh.geometry.x[in_geometry], reach)
    moves = la.vector(V.dofmap.index_map, 3)
    moves.array.reshape(-1, 3)[node] = shift
    moves.scatter_forward()
    x = mesh.geometry.x.copy()
    x[in_geometry] += moves.array.reshape(-1, 3)
    with agreed(comm, "adjust the mesh of a contact pair"):
        _check_cells(pair, x)
    mesh.geometry.x[:] = x
    distance = np.linalg.norm(shift, axis=1)
    moved = int(reductions.total(comm, int(np.count_nonzero(distance > _ROUND_OFF * nodes.size))))
    farthest = float(reductions.largest(comm, float(distance.max(initial=0.0))))
    if comm.rank == 0:
        _logger.info(
            "%d nodes of %s were moved onto %s, by %.3g at most",
            moved,
            nodes.name,
            pair.segments.name,
            farthest,
        )
    return moved, farthest


def _checked(pair: ContactPair, within: float) -> float:
    """Check the pair and the distance [m]; returns the distance. Collective."""
    if not isinstance(pair, ContactPair):
        raise TypeError(f"expected a ContactPair, given {kind_of(pair)}")
    positive("the distance within which gaps are closed", within)
    comm = pair.nodes.V.mesh.comm
    meet(comm, f"close the gaps between {pair.between} within {within!r} m")
    if not isinstance(pair.segments, Surface) or pair.touches_itself:
        raise ValueError(
            f"expected a pair of two surfaces, whose gaps can be closed, given {pair.between}"
        )
    if isinstance(pair.segments.smooth, RigidSphere):
        raise ValueError(
            "expected segments with flat facets or smooth=True, whose gaps can be closed, given "
            f"{pair.segments.smooth!r}"
        )
    if is_in_use(pair):
        raise ValueError(
            "expected a pair that no stepper uses yet, as gaps are closed before all steps"
        )
    V = pair.nodes.V
    if (degree := Element.of(V).degree) > 1:
        raise ValueError(
            "expected displacements of degree 1 on straight cells, whose vertices alone are "
            f"moved, given degree {degree}"
        )
    if is_axisymmetric(V.mesh):
        raise ValueError(
            "expected a mesh in space or in the plane to close gaps, given an axisymmetric mesh"
        )
    height = reductions.least(comm, float(pair.nodes.thickness.min(initial=np.inf)))
    if within > _SHARE * height:
        raise ValueError(
            f"expected a distance of at most {_SHARE * height:.4g}, a quarter of the height of the "
            f"flattest cell behind {pair.nodes.name}, given {within:g}: mesh the bodies closer to "
            "each other, or shift one as a whole"
        )
    return float(within)


def _shifts(pair: ContactPair, X: Floats, reach: float) -> tuple[Ints, Floats]:
    """Owned nodes within reach of their segments, ``(m,)``, and their shifts, ``(m, 3)`` [m].

    ``X`` are positions of the local nodes, shape ``(l, 3)`` [m]. Collective.
    """
    nodes, segments = pair.nodes, pair.segments
    assert isinstance(segments, Surface)
    # Flat facets are used, since smooth patches would change with the mesh.
    search = (
        SmoothSearch(nodes, segments, SmoothPatches(segments))
        if segments.smooth
        else GlobalSearch(nodes, segments)
    )
    candidates, _ = search.update(X, reach)
    x = candidates.scatter.forward(X)
    none = np.full(len(nodes.nodes), -1, dtype=np.int32)
    segment, gap = candidates.pair(NodalFacets.of(nodes).points(X), x, none, reach)
    found = np.flatnonzero((segment >= 0) & (np.abs(gap) <= reach))
    node, segment = nodes.nodes[found], segment[found]
    points = NodalPoints(node)
    gradient = candidates.contact("static", points, x, x, segment).gradient
    # The gradient of the gap with respect to the position of the node is the normal.
    normal = gradient.reshape(len(node), 1 + candidates.segments.shape[1], 3)[:, 0]
    return node, -gap[found, None] * normal


def _check_cells(pair: ContactPair, x: Floats) -> None:
    """Check that no cell is inverted at one of its corners, for positions ``(g, 3)`` [m]."""
    V = pair.nodes.V
    mesh, element = V.mesh, Element.of(V)
    cells = compat.geometry_nodes(mesh)
    slopes = element.basix.tabulate(1, element.points)[1:, :, :, 0]
    before, after = (
        np.linalg.det(np.einsum("jqv,cvi->cqij", slopes, at[cells][:, :, : len(slopes)]))
        for at in (mesh.geometry.x, x)
    )
    # Cells with zero initial volume are refused elsewhere.
    turned = np.flatnonzero(np.any((after * before <= 0) & (before != 0), axis=1))
    if len(turned):
        number = mesh.topology.original_cell_index[turned[0]]
        raise ValueError(
            f"expected no inverted cells after nodes of {pair.nodes.name} are moved, given "
            f"{len(turned)}, such as cell {number}: use a smaller distance, or smooth the mesh"
        )
