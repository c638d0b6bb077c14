"""Contact of sharp edges and their vertices, in addition to the constraints of a pair.

Contact constrains gaps of the nodes of one surface, node by node or as means over facets. An edge
or a corner of the other surface may penetrate faces between these nodes, and edges of both may
cross between nodes. In mortar contact an edge of the nodes also penetrates until the mean gap next
to it is closed. It penetrates without limit if the facets next to it do not face the other surface.
In statics a node opposite another node touches several facets, but only one of them constrains it.
`add_vertices` adds contact of vertices with faces, and of edges with edges.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from itertools import permutations
from typing import cast

import numpy as np

from dolfinx_nts._kernels import HYSTERESIS
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.contact.enforcement import Penalty, Tied
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.joint_state import JointState, members
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.contact.method import EDGES, MORTAR, NODES, may_be_smooth
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.obstacles.rigid_shapes import RigidSphere
from dolfinx_nts.model.obstacles.rigid_surface import RigidSurface
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.edges.rigid_edge_search import num_sharp_edges
from dolfinx_nts.search.kinks import nodes_on_kinks

__all__ = [
    *("VertexState", "add_vertices", "release_vertices", "released", "vertex_tolerance"),
]

# Number larger than all node numbers [-], and empty array of nodes.
_NO_NODE, _NONE = 2**31, np.empty(0, dtype=np.int32)


class VertexState(PairState):
    """Contact of vertices with faces, or of edges, beyond that of a pair, see `add_vertices`.

    Args:
        parent: State of the pair given by the user.
        pair: Vertices on convex edges and corners of one side and the other side, or, with method
            ``"edge-to-edge"``, both sides.
        tolerance: Depth at which each node of ``pair`` is activated, shape ``(n,)`` [m].
        is_reverse: See `PairState`.

    Attributes:
        parent, tolerance, is_reverse: The arguments.
    """

    def __init__(
        self, parent: PairState, pair: ContactPair, tolerance: Floats, *, is_reverse: bool = False
    ) -> None:
        self.parent, self.tolerance, self.is_reverse = parent, tolerance, is_reverse
        # Remaining number of steps without contact of the vertices, and number of such steps at the
        # next release.
        self._pauses = 0, 1
        super().__init__(pair, parent.passes)

    @property
    def is_released(self) -> bool:
        """Whether the vertices are released, as a step had no solution with them. Local."""
        return self._pauses[0] > 0

    def release(self) -> int:
        """Release the vertices for one step, and each later time for twice as many. Local.

        Returns the number of steps.
        """
        _, number = self._pauses
        self._pauses = number, 2 * number
        return number

    def accept(self, history: ContactHistory | Callable[[], ContactHistory]) -> None:
        super().accept(history)
        now, later = self._pauses
        self._pauses = max(now - 1, 0), later

    def serialize(self, archive: Archive, name: str) -> None:
        now, later = archive.same(f"{name}/pauses", np.array(self._pauses))
        self._pauses = int(now), int(later)
        super().serialize(archive, name)


def vertex_tolerance(state: PairState | JointState) -> Floats | None:
    """Depths at which vertices are activated, ``(n,)`` [m]; None for other contact. Local."""
    found = [each.tolerance for each in members(state) if isinstance(each, VertexState)]
    return np.concatenate(found) if found else None


def released(state: PairState | JointState) -> Flags:
    """Flags of released vertices, see `VertexState`, shape ``(n,)``. Local."""
    found = [
        np.full(len(each.nodes.nodes), isinstance(each, VertexState) and each.is_released)
        for each in members(state)
    ]
    return np.concatenate(found)


def release_vertices(steps: Iterable[tuple[PairState | JointState, Flags]]) -> list[str]:
    """Release the vertices of pairs with active vertices in a failed step. Collective.

    Args:
        steps: States of the pairs in the step, and which of their nodes are active.

    Returns:
        Names of the sides of these pairs, and number of steps without the vertices.
    """
    found: list[str] = []
    for state, active in steps:
        for each, start, end in zip(members(state), state.ends[:-1], state.ends[1:], strict=True):
            if not isinstance(each, VertexState) or each.is_released:
                continue
            holds = bool(active[start:end].any() or each.history.active.any())
            if reductions.anywhere(each.nodes.V.mesh.comm, holds):
                number = each.release()
                when = "in this step" if number == 1 else f"in {number} steps from this one on"
                found.append(f"{each.parent.pair.between} {when}")
    return found


def add_vertices(
    contacts: Sequence[PairState], excluded: Sequence[Body], *, is_static: bool
) -> list[VertexState]:
    """Add contact of vertices on convex edges and corners, and of edges, to each pair. Collective.

    Vertices of the segments touch the facets of the nodes. With mortar contact or in statics,
    vertices of the nodes also touch the segments. In space sharp edges of both sides touch each
    other, also those of a `RigidSurface`. The laws are those of the pair. A vertex becomes active
    if in a solution it is deeper below a face than a hundredth of the smallest facet at the vertex.
    An edge becomes active if another edge crosses it so deeply. Both stay active as long as a force
    acts on them. Without such penetration, the solution is the same as without vertices and edges.

    In dynamics multipliers keep the gap of the vertex, as pushing it out would do work. A vertex of
    the segments opposite an active node stays inactive. In dynamics springs begin without energy,
    at a depth larger than the compression of the springs of the pair there; in statics they begin
    at that compression.

    Vertices and edges are not used in edge contact, self contact, ties, massless nodes, convective
    friction and with ``exchange=False``. Vertices do not touch obstacles, and vertices of the
    segments are not used if another pair has the segments as nodes. Edges are not used if another
    pair has them.

    Args:
        contacts: States of all pairs of a stepper. The new states are added to their `vertices`.
        excluded: Rigid bodies whose vertices are not used; deformable ones among them are ignored.
        is_static: Whether there is no inertia.

    Returns:
        The states of the vertices and edges.
    """
    pairs = [contact.pair for contact in contacts]
    if any(map(is_resolved, pairs)):
        return []
    roles, kinks = _Roles(pairs), cache(nodes_on_kinks)
    rigid = np.concatenate([_NONE, *(body.nodes for body in excluded if body.is_rigid)])
    for contact in contacts:
        pair = contact.pair
        if not _has_vertices(pair):
            continue
        laws, exchanged = (pair.enforcement, pair.friction), roles.exchanged(pair)
        sides = _sides(pair, is_static=is_static, is_exchanged=bool(exchanged))
        for surface, faces in sides:
            is_kink, facet = kinks(surface)
            vertices, tolerance = surface.with_nodes(is_kink), HYSTERESIS * facet[is_kink]
            if not _may_touch(vertices, rigid):
                continue
            each = ContactPair(vertices, faces, *laws, NODES, exchange=False)
            # A vertex opposite a node touches several facets; smooth patches have one normal there.
            if is_static and may_be_smooth(each):
                each = ContactPair(vertices, faces.smoothed(), *laws, NODES, exchange=False)
            is_reverse = faces is pair.nodes
            state = VertexState(contact, each, tolerance, is_reverse=is_reverse)
            contact.vertices = (*contact.vertices, state)
        # Surfaces without vertices on edges need no search for edges.
        are_sharp = all(_may_touch(s.with_nodes(kinks(s)[0]), rigid) for s in _surfaces(pair))
        is_first = all(pairs.index(pair) < pairs.index(other) for other in exchanged)
        if are_sharp and is_first and not roles.have_edges(pair) and (edges := _edges(pair)):
            tolerance = HYSTERESIS * kinks(pair.nodes)[1]
            contact.vertices = (*contact.vertices, VertexState(contact, edges, tolerance))
    return [cast(VertexState, each) for contact in contacts for each in contact.vertices]


def _sides(
    pair: ContactPair, *, is_static: bool, is_exchanged: bool
) -> list[tuple[Surface, Surface]]:
    """Surfaces whose vertices touch, each with the surface that it touches. Local."""
    if not isinstance(pair.segments, Surface):
        return []
    sides = [] if is_exchanged else [(pair.segments, pair.nodes)]
    if is_static or pair.method == MORTAR:
        sides.append((pair.nodes, pair.segments))
    return sides


def _edges(pair: ContactPair) -> ContactPair | None:
    """Edge-to-edge contact of the sides of a pair; None without sharp edges. Collective."""
    if dimension(pair.nodes.V) < 3 or not all(map(num_sharp_edges, (pair.nodes, pair.segments))):
        return None
    nodes, segments = (
        each.smoothed(smooth=False) if isinstance(each, Surface) and each.smooth else each
        for each in (pair.nodes, pair.segments)
    )
    assert isinstance(nodes, Surface)
    laws = pair.enforcement, pair.friction
    return ContactPair(nodes, segments, *laws, EDGES, exchange=False)


def _surfaces(pair: ContactPair) -> list[Surface]:
    return [side for side in (pair.nodes, pair.segments) if isinstance(side, Surface)]


def _may_touch(surface: Surface, rigid: Ints) -> bool:
    """Whether a surface has nodes, and no node belongs to an excluded body. Collective."""
    counts = [len(surface.nodes), np.isin(surface.nodes, rigid).any()]
    number, num_excluded = reductions.total(surface.V.mesh.comm, counts)
    return bool(number and not num_excluded)


class _Roles:
    """Nodes and vertices of the segments of all pairs that have both. Local.

    Args:
        pairs: All pairs of a stepper.
    """

    def __init__(self, pairs: Sequence[ContactPair]) -> None:
        self._of_edges = [pair for pair in pairs if pair.method == EDGES]
        self._pairs = [
            (pair, pair.nodes, pair.segments)
            for pair in pairs
            if pair.method != EDGES and isinstance(pair.segments, Surface)
        ]
        # Range of node numbers of each side, by which most pairs are excluded.
        self._ends: GlobalInts = np.array(
            [[_ends(side.nodes) for side in sides] for _, *sides in self._pairs], dtype=np.int64
        ).reshape(-1, 2, 2)

    def have_edges(self, pair: ContactPair) -> bool:
        """Whether another pair has edge-to-edge contact of both sides of a pair. Collective."""
        return any(
            _meet(pair.nodes, one) and _meet(pair.segments, other)
            for edges in self._of_edges
            for one, other in permutations((edges.nodes, edges.segments))
        )

    def exchanged(self, pair: ContactPair) -> list[ContactPair]:
        """Other pairs with nodes and segments in exchanged roles. Collective.

        The nodes of such a pair include the nodes of the segments of ``pair``, and its segments the
        nodes of ``pair``.
        """
        if not isinstance(pair.segments, Surface):
            return []
        own = pair.segments.nodes, pair.nodes.nodes
        has_both: Flags = np.ones(len(self._pairs), dtype=bool)
        for number, nodes in enumerate(own):
            least, largest = _ends(nodes)
            ends = self._ends[:, number]
            has_both &= (ends[:, 0] <= least) & (largest <= ends[:, 1])
        for i in np.flatnonzero(has_both):
            other, *sides = self._pairs[i]
            has_both[i] = other is not pair and all(
                bool(np.isin(nodes, side.nodes).all())
                for nodes, side in zip(own, sides, strict=True)
            )
        found = reductions.everywhere(pair.nodes.V.mesh.comm, has_both)
        return [self._pairs[i][0] for i in np.flatnonzero(found)]


def _meet(one: Surface | Obstacle, other: Surface | Obstacle) -> bool:
    """Whether two sides of pairs are the same obstacle or have common nodes. Collective."""
    if not (isinstance(one, Surface) and isinstance(other, Surface)):
        return one is other
    return reductions.anywhere(one.V.mesh.comm, bool(np.isin(one.nodes, other.nodes).any()))


def _ends(nodes: Ints) -> tuple[int, int]:
    """First and last of sorted node numbers; without nodes an empty range."""
    return (int(nodes[0]), int(nodes[-1])) if len(nodes) else (_NO_NODE, -1)


def _has_vertices(pair: ContactPair) -> bool:
    """Whether a pair supports contact of vertices. Local."""
    law = pair.enforcement
    if not pair.exchange or pair.touches_itself or pair.method not in (NODES, MORTAR):
        return False
    if isinstance(law, Tied) or (isinstance(law, Penalty) and pair.is_convective):
        return False
    if not isinstance(pair.segments, Surface | RigidSurface):
        return False
    return not any(isinstance(each.smooth, RigidSphere) for each in _surfaces(pair))
