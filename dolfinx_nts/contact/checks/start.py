"""Checks of an initial state: penetration of obstacles and bodies, bodies without a pair."""

import logging
from collections.abc import Collection, Sequence
from itertools import product

import numpy as np

from dolfinx_nts import _kernels, compat
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.contact.method import NODES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import input_ids, listed, reference_positions
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.closed_boundaries import outward_triangles
from dolfinx_nts.model.connected_bodies import connected
from dolfinx_nts.model.obstacles.distance_check import check_distance
from dolfinx_nts.model.obstacles.exact_obstacle import ExactObstacle
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.obstacles.rigid_surface import RigidSurface
from dolfinx_nts.model.obstacles.rims import FACET_EDGES
from dolfinx_nts.model.segments import area_vectors, diameters
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.parallel.errors import agreed
from dolfinx_nts.search.overlap.overlaps import OverlapSearch

__all__ = [
    *("check_rigid_facets", "check_start", "deepen_search", "warn_of_bodies_without_pair"),
]

_logger = logging.getLogger("dolfinx_nts")

# Depth relative to the size of a facet [-] that exceeds round-off.
_DEEP = 1e-6
# Distance of test points from a node relative to its facets [-]: larger than round-off, and far
# smaller than any detail of the shape.
_NEAR = 1e-3


def check_start(state: PairState, t: float, x: Floats, x_before: Floats | None = None) -> None:
    """Check that no node of a pair is initially inside its rigid obstacle. Collective.

    Initial penetration of another deformable body is allowed, see `OverlapWatch`.

    Args:
        state: State of the contact pair.
        t: Time, for the positions of moving obstacles [s].
        x: Positions of the local nodes of the space, shape ``(l, 3)`` [m].
        x_before: Positions before the user displaced bodies: nodes that were as deep before are
            allowed. None at the first step.

    Raises:
        ValueError: Nodes are deeper than a millionth of the size of the surface's facets; or the
            distance of an obstacle of the user is wrong, see `check_distance`.
    """
    pair = state.pair
    if not isinstance(pair.segments, Obstacle):
        return
    obstacle, comm, nodes = pair.segments, pair.nodes.V.mesh.comm, pair.nodes.nodes
    place = obstacle.motion.frame(t, t, obstacle.dim).at_end
    if isinstance(obstacle, ExactObstacle) and x_before is None:
        with agreed(comm, "check an obstacle"):
            check_distance(obstacle, place(x[nodes]), pair.segment_size)
    depth = obstacle.depth(place(x[nodes]))
    allowed = _DEEP * pair.segment_size
    new = depth > allowed
    if x_before is not None:
        new &= ~(depth <= obstacle.depth(place(x_before[nodes])) + allowed)
    own = pair.nodes.node_ids[new], depth[new], x[nodes[new]]
    ids, depth, ends = (joined(comm, part) for part in own)
    if len(ids):
        seen = ", or deeper, as facets are seen to half of their size"
        on_chords = reductions.everywhere(comm, _are_on_chords(pair.nodes, nodes[new]))
        given = seen * isinstance(obstacle, RigidSurface), on_chords
        raise _inside(pair, ids, depth, ends, *given)


def _are_on_chords(surface: Surface, nodes: Ints) -> bool:
    """Whether nodes are midpoints of straight edges, which may be chords of arcs. Local."""
    element = Element.of(surface.V)
    if element.degree == 1 or compat.geometry_degree(surface.V.mesh) > 1:
        return False
    is_corner = [len(pairs) == 1 and pairs[0, 0] == pairs[0, 1] for pairs in element.diagonals]
    return not np.isin(nodes, surface.V.dofmap.list[:, is_corner]).any()


def _inside(
    pair: ContactPair,
    ids: GlobalInts,
    depth: Floats,
    x: Floats,
    more: str,
    on_chords: bool = False,
) -> ValueError:
    """Error for nodes of all ranks inside an obstacle, with their depths [m] and positions [m].

    ``on_chords`` is whether all of them are midpoints of straight edges.
    """
    deepest, found = depth.argmax(), np.unique(ids)
    remedy = "move"
    if on_chords:
        remedy = (
            "they are midpoints of straight edges, which are chords of a round surface: "
            "gmsh.model.mesh.setOrder(2), called after the mesh is made, puts them on the arc; "
            "otherwise move"
        )
    place = ", ".join(f"{coordinate:.3g}" for coordinate in x[deepest] + 0.0)
    return ValueError(
        f"expected bodies outside of obstacles, given {len(found)} nodes of {pair.nodes.name} "
        f"up to {depth[deepest]:.3g} inside {pair.segments.name}{more}, deepest at ({place}): "
        f"{listed(found)}; {remedy} the two apart before the first step, and let a Motion or "
        "supports bring them together in steps"
    )


def deepen_search(state: PairState, inside: OverlapSearch, body: str, x: Floats) -> None:
    """Increase the search depth of initially penetrating nodes. Collective.

    In a run a node more than half a facet below a segment is not paired with it, as it may belong
    to another side of the body. Initially a node inside the closed boundary is paired with the
    segment above it. Along the normal, this must be nearer than the opposite side of the body.

    Args:
        state: State of a contact pair whose segments belong to the body.
        inside: Overlap search at the same positions.
        body: Name of the body, as in `Overlap`.
        x: Positions of the local nodes of the space, shape ``(l, 3)`` [m].

    Raises:
        ValueError: Nodes are deeper than half of the thickness of the body.
    """
    surface, comm = state.pair.nodes, state.nodes.V.mesh.comm
    node, depth, normal = state.nodes_inside(x)
    number = surface.V.dofmap.index_map.local_to_global
    own = number(surface.nodes[node]), depth, normal, surface.node_ids[node]
    deep, depth, normal, ids = (joined(comm, part) for part in own)
    if not len(deep):
        return
    # Lateral faces of both bodies may lie in one plane, so that nodes are on the boundary: a node
    # is inside if points around it on its facets are inside.
    corners = x[surface.segments]
    near = corners + _NEAR * (corners.mean(axis=1, keepdims=True) - corners)
    at, points = number(surface.segments.ravel()), near.reshape(-1, 3)
    mine = np.isin(at, deep)
    at, points = joined(comm, at[mine]), joined(comm, points[mine])
    order = np.argsort(deep)
    of = order[np.searchsorted(deep, at, sorter=order)]
    is_inside, beyond = inside.below(points, -normal[of], body)
    deeper = is_inside & (depth[of] > beyond)
    if deeper.any():
        deepest, thickness = depth[of][deeper].max(), (depth[of] + beyond)[deeper].min()
        nodes = np.unique(ids[of][deeper])
        raise ValueError(
            "expected bodies that start at most half of their thickness inside each other, given "
            f"{len(nodes)} nodes of {surface.name} up to {deepest:.3g} m inside {body}, which is "
            f"{thickness:.3g} m thick there: {listed(nodes)}; move the two apart before the first "
            "step, and let supports bring them together in steps"
        )
    if is_inside.any():
        usual = _kernels.DEEPEST * state.pair.segment_size
        state.set_initial_depth(
            max(state.search.initial_depth, float(depth[of][is_inside].max()) + usual)
        )


def check_rigid_facets(
    state: PairState, inside: OverlapSearch, bodies: Collection[str], t: float, x: Floats
) -> None:
    """Check that no body starts so deep in a `RigidSurface` that no force acts. Collective.

    A body may be completely within a closed surface. Nodes more than half a facet behind the facets
    have no segment. An open surface does not define an interior: a body is inside if the inward
    rays of its nodes enter the facets.

    Args:
        state: State of a contact pair.
        inside: Overlap search at the same positions.
        bodies: Names of the bodies of the nodes, as in `Overlap`.
        t: Time, for the positions of moving obstacles [s].
        x: Positions of the local nodes of the space, shape ``(l, 3)`` [m].

    Raises:
        ValueError: A body is within a closed surface, or the surface of the nodes is too deep
            inside.
    """
    surface, obstacle, comm = state.pair.nodes, state.pair.segments, state.nodes.V.mesh.comm
    if not isinstance(obstacle, RigidSurface) or state.pair.method != NODES:
        return
    place = obstacle.motion.frame(t, t, obstacle.dim).at_end
    numbers, some = inside.boundaries_and_nodes(surface)
    within = joined(comm, numbers[_are_enclosed(obstacle, place(x[some]))])
    if len(within):
        raise ValueError(
            f"expected bodies outside of obstacles, given {inside.names[within[0]]} inside the "
            f"closed surface of {obstacle.name}, where no force acts; move the two apart before "
            "the first step, or, for a container, let the points `outside` be within it"
        )
    corners = x[surface.segments]
    normal = area_vectors(corners, surface.orientation)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    # A test point for each node of each rank, just inside its body.
    near = corners + _NEAR * (corners.mean(axis=1, keepdims=True) - corners)
    near -= _NEAR * (diameters(corners)[:, None] * normal)[:, None]
    nodes, first = np.unique(surface.segments, return_index=True)
    inward = -np.repeat(normal, corners.shape[1], axis=0)[first]
    own = near.reshape(-1, 3)[first], inward, x[nodes], input_ids(surface.V)[nodes]
    for name in sorted(bodies):
        box = inside.box(name)
        facets = obstacle.within(place(np.array(list(product(*box.T)))))
        if not len(facets):
            continue
        diameter = float(np.linalg.norm(box[1] - box[0]))
        depth = obstacle.depth_behind(facets, place(own[0] + diameter * inward), place(own[2]))
        points, into, ends, ids = (joined(comm, each[depth != 0]) for each in own)
        if not len(points):
            continue
        is_inside, thickness = inside.below(points, into, name)
        begin = place(points + (1 - _NEAR) * thickness[:, None] * into)
        depth = obstacle.depth_behind(facets, begin, place(ends))
        deep = is_inside & (depth > 0) & (obstacle.depth(place(ends)) <= 0)
        if deep.any():
            more = ", more than half of a facet, where no force acts"
            raise _inside(state.pair, ids[deep], depth[deep], ends[deep], more)


def _are_enclosed(obstacle: RigidSurface, x: Floats) -> Flags:
    """Whether points ``(m, 3)`` [m] are within a closed surface; never in an open one. Local."""
    points, facets, orientation = obstacle.facets
    edges = np.sort(facets[:, FACET_EDGES[facets.shape[1]]].reshape(-1, 2))
    if np.any(np.unique(edges, axis=0, return_counts=True)[1] != 2):
        return np.zeros(len(x), dtype=bool)
    nodes = np.arange(len(points), dtype=np.int32)
    boundary = _kernels.Boundaries([nodes], [outward_triangles(facets, orientation)])
    boundary.move(points)
    flags: Flags = boundary.winding(x, np.zeros(len(x), dtype=np.int32)) > 0.5
    return flags


def warn_of_bodies_without_pair(bodies: Sequence[Body], pairs: Sequence[ContactPair]) -> None:
    """Warn of bodies without a contact pair with another body. Collective.

    Bodies that share nodes count as one.

    Args:
        bodies: All bodies of a stepper.
        pairs: Its contact pairs.
    """
    groups = connected(bodies)
    if len(groups) == 1:
        return
    V = bodies[0].V
    comm, group_of = V.mesh.comm, np.full(len(reference_positions(V)), -1)
    for number, group in enumerate(groups):
        group_of[np.concatenate([body.nodes for body in group])] = number
    sides = [(pair.nodes, pair.segments) for pair in pairs if isinstance(pair.segments, Surface)]
    found = np.zeros((len(sides), 2, len(groups)), dtype=bool)
    for flags, surfaces in zip(found, sides, strict=True):
        for flag, surface in zip(flags, surfaces, strict=True):
            flag[group_of[surface.segments]] = True
    found = reductions.anywhere(comm, found)
    # Number of other groups of connected bodies on the opposite side of each pair.
    others = found.sum(axis=2, keepdims=True)[:, ::-1] - found[:, ::-1]
    has_pair = (found & (others > 0)).any(axis=(0, 1))
    alone = [group for group, has in zip(groups, has_pair, strict=True) if not has]
    if alone and comm.rank == 0:
        names = ", ".join(body.name for group in alone for body in group)
        _logger.warning(
            "bodies without a contact pair with another body: %s; harmless if they never meet "
            "one; otherwise they pass through it: add pairs, or use all_pairs(bodies)",
            names,
        )
