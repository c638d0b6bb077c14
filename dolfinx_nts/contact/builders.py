"""Surfaces and contact pairs of whole bodies, for scenes without named surfaces."""

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import chain
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arguments import instances, label
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.enforcement import LagrangeMultiplier, Penalty
from dolfinx_nts.contact.friction.laws import FrictionLaw
from dolfinx_nts.contact.method import EDGES, MORTAR, NODES, Method
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import geometry_unchanged
from dolfinx_nts.model.bodies import Body, common_space
from dolfinx_nts.model.connected_bodies import connected, log_shared_nodes
from dolfinx_nts.model.moduli import least_moduli
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.surfaces import (
    FINE,
    Smooth,
    Surface,
    boundary_facets,
    facing_segments,
)
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.search.edges.rigid_edge_search import num_sharp_edges
from dolfinx_nts.search.kinks import arc_length

__all__ = ["all_pairs", "boundary_of", "two_half_passes"]

_logger = logging.getLogger("dolfinx_nts")

# Exponent of the stiffness in the coarseness of bodies, and largest factor due to stiffness [-].
# Size has priority, since small segments pass between the nodes of larger facets.
_BY_STIFFNESS, _SIMILAR = 0.15, 1.5


def boundary_of(
    *bodies: Body,
    where: Callable[[Any], Any] | None = None,
    smooth: Smooth = False,
    name: str = "",
) -> Surface:
    """Surface of the boundary of one or several bodies, or of a part of it. Collective.

    Args:
        *bodies: Bodies of one space. Facets between two bodies that share nodes are not on the
            boundary.
        where: Function of the reference positions, shape ``(3, n)`` [m], that returns booleans,
            shape ``(n,)``. A facet is selected if it is true at all its vertices.
        smooth: See `Surface`.
        name: Name in messages, columns and legends; empty for "the boundary of" the bodies.

    Returns:
        The surface.

    Raises:
        TypeError: An argument is not a body, or the function does not return booleans.
        ValueError: No bodies, several spaces, a wrong shape of the result, or no facet is
            selected.

    Example:
        >>> top = nts.boundary_of(body, where=lambda x: x[2] > 0.49)
        >>> round(float(top.area.sum()), 3)  # m^2
        1.0
    """
    if any(isinstance(body, list | tuple) for body in bodies):
        raise TypeError("expected bodies one by one, as in boundary_of(*bodies), given a list")
    V = common_space(bodies)
    facets = _exterior_facets(V, np.concatenate([body.cells for body in bodies]))
    automatic = f"the boundary of {' and '.join(body.name for body in bodies)}"
    if where is not None:
        facets = np.intersect1d(facets, boundary_facets(V, where))
        automatic = f"a part of {automatic}"
    return Surface.of(V, facets, label(name) or automatic, smooth=smooth)


@geometry_unchanged()
def all_pairs(
    bodies: Sequence[Body],
    *,
    obstacles: Sequence[Obstacle] = (),
    self_contact: Sequence[Body] = (),
    enforcement: LagrangeMultiplier | Penalty | None = None,
    friction: FrictionLaw | float | None = None,
    method: Method | None = None,
    edges: bool = False,
    smooth: bool = False,
    exchange: bool = True,
) -> list[ContactPair]:
    """Contact pairs between all bodies, and with obstacles. Collective.

    n bodies need n - 1 pairs, and more if round rigid bodies give nodes. Bodies are sorted by the
    lower quartile of the diameters of their facets that face other bodies, since meshes are refined
    where contact is expected. The first pair has the nodes of the finer half and the segments of
    the coarser half; further pairs divide each half again. Of two meshes whose facets differ by
    less than half, the mesh of a body fifteen times as stiff counts as coarser: its nodes would
    have alternating pressures, and its vertices would penetrate between the nodes of the softer
    body. Rigid bodies, and round bodies fifteen times as stiff, provide segments. They provide
    nodes instead if a facet of the soft bodies covers more than a quarter radian of their round
    surface, as it would only see a mean gap there. Of two rigid bodies the finer one provides the
    nodes. Pairs with nodes of rigid bodies have node-to-segment contact, unless ``method`` is
    given. Bodies that share nodes count as one; a warning names bodies that share nodes but no
    facet. There is one pair for each obstacle, and one for each self contact. The name of a pair of
    two bodies contains their names; pairs of more bodies are numbered. Names depend neither on
    stiffness nor on facet sizes. The pairs are logged, and `Diagnostics.between` has the forces
    between any two bodies.

    Args:
        bodies: Bodies of one space.
        obstacles: Rigid obstacles.
        self_contact: Bodies with self contact.
        enforcement: Enforcement, as in `ContactPair`.
        friction: Law of friction; None for none.
        method: Method of contact between bodies, as in `ContactPair`. Pairs with obstacles and
            self contact are always node-to-segment.
        edges: Whether to add pairs of method ``"edge-to-edge"`` for groups of bodies and each
            `RigidSurface` with sharp edges. Edges then touch at once, not after crossing by a
            hundredth of a facet.
        smooth: Whether segments between bodies are smooth, as in `Surface`; with method "mortar"
            both surfaces are smooth. Self contact and edges always use facets.
        exchange: Whether vertices on edges and corners have contact, as in `ContactPair`.

    Returns:
        The pairs.

    Raises:
        TypeError: An argument is neither a body nor an obstacle.
        ValueError: No bodies, several spaces, or self contact of a body that is not among them;
            edges in the plane; or as in `ContactPair`.

    Example:
        >>> floor = nts.RigidPlane(point=(0, 0, -1), normal=(0, 0, 1))
        >>> pairs = nts.all_pairs([body, other], obstacles=[floor], friction=nts.Coulomb(mu=0.3))
        >>> [type(pair.segments).__name__ for pair in pairs]
        ['Surface', 'RigidPlane']
    """
    bodies, self_contact = instances(Body, bodies), instances(Body, self_contact)
    common_space([*bodies, *self_contact])
    if others := [body for body in self_contact if body not in bodies]:
        raise ValueError(
            f"expected bodies of the scene as self_contact, given {len(others)} other bodies"
        )
    if edges and dimension(bodies[0].V) < 3:
        raise ValueError("expected edges=True for bodies in space only, given a mesh of the plane")
    log_shared_nodes(bodies)
    surface = cache(boundary_of)
    separate = connected(bodies)
    coarse, round_rigid = _coarseness(separate, least_moduli(bodies), surface, method)
    groups = sorted(separate, key=lambda group: coarse[id(group)])
    pairs: list[ContactPair] = []

    def add(
        nodes: Sequence[Body], segments: Sequence[Body] | Obstacle, by: Method | None = NODES
    ) -> None:
        target: Surface | Obstacle
        if isinstance(segments, Obstacle):
            target, text = segments, f"{'edges of ' * (by == EDGES)}{type(segments).__name__}"
        elif segments is nodes:
            target, text = surface(*segments), "their own segments"
        else:
            what = "edges" if by == EDGES else "segments"
            is_smooth = smooth and by != EDGES
            target = surface(*segments, smooth=True) if is_smooth else surface(*segments)
            text = f"the {'smooth ' * is_smooth}{what} of {names(segments)}"
        # In surface-to-surface contact both surfaces may be smooth.
        are_both = smooth and by == MORTAR and isinstance(segments, Sequence)
        from_nodes = surface(*nodes, smooth=True) if are_both else surface(*nodes)
        name = ""
        if not isinstance(segments, Obstacle) and segments is not nodes:
            # With more than two bodies, the bodies of a pair depend on stiffness and facet size.
            two = len(bodies) == 2
            name = " and ".join(b.name for b in bodies) if two else f"{len(pairs) + 1}"
            name += " edges" if by == EDGES else ""
        laws = enforcement, friction, by
        pairs.append(ContactPair(from_nodes, target, *laws, name=name, exchange=exchange))
        if bodies[0].V.mesh.comm.rank == 0:
            own = "edges" if by == EDGES else "nodes"
            _logger.info("pair %d: %s of %s against %s", len(pairs), own, names(nodes), text)

    def names(some: Sequence[Body]) -> str:
        if len(some) == len(bodies) > 1:
            return "all bodies"
        return ", ".join(body.name for body in bodies if body in some)

    halves = list(_halves(groups))
    for finer, coarser in halves:
        for is_round, by in ((False, method), (True, NODES)):
            some = list(
                chain(*(group for group in finer if (id(group) in round_rigid) == is_round))
            )
            if some:
                # As steppers do with pairs whose method was not given.
                nodal = by is None and any(body.is_rigid for body in some)
                add(some, list(chain(*coarser)), NODES if nodal else by)
    for two in halves if edges else []:
        finer, coarser = (list(chain(*some)) for some in two)
        if num_sharp_edges(surface(*finer)) and num_sharp_edges(surface(*coarser)):
            add(finer, coarser, EDGES)
    for obstacle in instances(Obstacle, obstacles):
        add(bodies, obstacle)
        if edges and num_sharp_edges(obstacle) and num_sharp_edges(surface(*bodies)):
            add(bodies, obstacle, EDGES)
    for group in groups:
        if not set(group).isdisjoint(self_contact):
            add(group, group)
    return pairs


def _coarseness(
    groups: Sequence[Sequence[Body]],
    moduli: Floats,
    surface: Callable[..., Surface],
    method: Method | None,
) -> tuple[dict[int, tuple[bool, float]], set[int]]:
    """Order of groups of bodies, of which the last should provide segments. Collective.

    Args:
        groups: Bodies that are connected.
        moduli: Least modulus at each local node, infinite in rigid bodies, shape ``(l,)`` [Pa].
        surface: Returns the boundary of bodies.
        method: Method of contact, see `all_pairs`.

    Returns:
        By the `id` of a group, whether it is rigid and provides segments to deformable ones, and
        the size of its facets [m], increased if it should provide segments; and the round rigid
        groups that provide nodes to deformable ones.
    """
    comm = groups[0][0].V.mesh.comm
    softest = reductions.least(comm, float(moduli.min(initial=np.inf)))
    surfaces = [surface(*group) for group in groups]

    def facing(own: Surface) -> list[Surface]:
        return [own, *(each for each in surfaces if each is not own)]

    def size_and_weight(own: Surface) -> tuple[float, float]:
        lengths, faces = facing_segments(*facing(own))
        # Of connected bodies, only those whose facets face other bodies determine the size.
        of_facets = joined(comm, moduli[own.segments].max(axis=1))
        modulus = float(np.median(of_facets[faces]))
        size = float(np.quantile(lengths[faces], FINE))
        if modulus == np.inf:
            return size, math.inf
        weight = min((modulus / softest) ** _BY_STIFFNESS, _SIMILAR) if softest > 0 else 1.0
        return size, weight

    found = [size_and_weight(own) for own in surfaces]
    coarse, round_rigid = dict[int, tuple[bool, float]](), set[int]()
    for group, own, (size, weight) in zip(groups, surfaces, found, strict=True):
        arc = arc_length(*facing(own)) if weight >= _SIMILAR else math.inf
        softer = max((other for other, less in found if less < weight), default=0.0)
        if arc < softer and (weight < math.inf or method != MORTAR):
            # Facets of softer bodies do not resolve the round body: they would only see a mean gap.
            if weight == math.inf:
                size = arc
                round_rigid.add(id(group))
            else:
                size = min(size, arc)
        elif weight < math.inf:
            # Nodes of a stiff round body would have alternating pressures.
            size = weight * (max(size, softer) if arc < math.inf else size)
        # Rounded, so that equal bodies keep their order in the list.
        is_last = weight == math.inf and id(group) not in round_rigid
        coarse[id(group)] = is_last, float(f"{size:.6g}")
    return coarse, round_rigid


def two_half_passes(
    first: Surface,
    second: Surface,
    enforcement: Penalty | None = None,
    friction: FrictionLaw | float | None = None,
) -> list[ContactPair]:
    """Two contact pairs with exchanged roles (two half passes). Collective.

    Each pair has springs of half the stiffness. No side is preferred, and nodes of neither surface
    penetrate the other. Use it for similar meshes, or if it is unknown which one is finer.

    Args:
        first: Surface of one body.
        second: Surface of another one.
        enforcement: Springs; each pair gets half of their given or default stiffness.
            Multipliers on both sides would be linearly dependent constraints.
        friction: Law of friction; None for none.

    Returns:
        Nodes of the first against segments of the second, and the reverse.

    Raises:
        TypeError: The enforcement is not `Penalty`, or as in `ContactPair`.
        ValueError: As in `ContactPair`.

    Example:
        >>> pairs = nts.two_half_passes(top, bottom, nts.Penalty(eps_N=1.0e5))
        >>> pairs[0].nodes is pairs[1].segments, pairs[0].enforcement
        (True, Penalty(eps_N=100000, share=0.5))
    """
    enforcement = Penalty() if enforcement is None else enforcement
    if not isinstance(enforcement, Penalty):
        raise TypeError(
            "expected Penalty with both sides as contact nodes, given "
            f"{type(enforcement).__name__}: multipliers on both sides are too many constraints"
        )
    half = enforcement.halved()
    surfaces = ((first, second), (second, first))
    return [ContactPair(nodes, segments, half, friction, NODES) for nodes, segments in surfaces]


def _exterior_facets(V: fem.FunctionSpace, cells: Ints) -> Ints:
    """Owned facets of cells on the boundary of the mesh, sorted, ``(s,)``. Collective.

    Unlike `dolfinx.mesh.exterior_facet_indices` it only checks facets of the given cells.
    """
    topology, tdim = V.mesh.topology, V.mesh.topology.dim
    both = (tdim - 1, tdim), (tdim, tdim - 1)
    for dims in both:
        topology.create_connectivity(*dims)
    to_cell, to_facet = (topology.connectivity(*dims) for dims in both)
    of_cells = to_facet.array.reshape(-1, len(Element.of(V).sides))
    facets: Ints = np.unique(of_cells[cells])
    facets = facets[facets < topology.index_map(tdim - 1).size_local]
    facets = facets[to_cell.offsets[facets + 1] - to_cell.offsets[facets] == 1]
    return np.setdiff1d(facets, topology.interprocess_facets(), assume_unique=True)


def _halves(items: Sequence[Any]) -> Iterator[tuple[Sequence[Any], Sequence[Any]]]:
    """Recursive bisections of a list, which separate any two items exactly once."""
    if len(items) > 1:
        middle = len(items) // 2
        yield items[:middle], items[middle:]
        yield from _halves(items[:middle])
        yield from _halves(items[middle:])
