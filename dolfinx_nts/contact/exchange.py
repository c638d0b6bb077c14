"""Contact with exchanged roles, where edges of the segments touch faces of the nodal surface.

Contact constrains gaps of the nodes of one surface. An edge or a corner of the other one penetrates
faces between these nodes. `exchange_roles` adds a pair in which the vertices of the segments are
the nodes, and the facets of the nodes the segments.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from dolfinx_nts._kernels import HYSTERESIS
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.contact.enforcement import Penalty, Tied
from dolfinx_nts.contact.joint_state import JointState, members
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.contact.method import EDGES, MORTAR, NODES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.obstacles.rigid_shapes import RigidSphere
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.kinks import nodes_on_kinks

__all__ = [
    *("ExchangedState", "exchange_roles", "exchange_tolerance", "release_vertices", "released"),
]

# Number above those of all nodes [-].
_NO_NODE = 2**31


class ExchangedState(PairState):
    """Contact of a pair with the roles exchanged, see `exchange_roles`.

    Args:
        given: State of the pair of the user.
        vertices: Surface of its segments, with the nodes on convex edges and corners only.
        tolerance: Depth from which on each of these is held, shape ``(n,)`` [m].

    Attributes:
        given, tolerance: The arguments.
        is_released: Whether no vertex is held any more, as a step had no solution with them.
    """

    def __init__(self, given: PairState, vertices: Surface, tolerance: Floats) -> None:
        pair, self.given, self.tolerance = given.pair, given, tolerance
        laws = pair.enforcement, pair.friction, NODES
        self.is_released = False
        super().__init__(ContactPair(vertices, pair.nodes, *laws, exchange=False), given.passes)

    def serialize(self, archive: Archive, name: str) -> None:
        self.is_released = archive.same(f"{name}/is_released", self.is_released)
        super().serialize(archive, name)


def exchange_tolerance(state: PairState | JointState) -> Floats | None:
    """Depths that activate constraints, ``(n,)`` [m]; None without exchanged roles. Local."""
    found = [each.tolerance for each in members(state) if isinstance(each, ExchangedState)]
    return np.concatenate(found) if found else None


def released(state: PairState | JointState) -> Flags:
    """Flags of released vertices, see `ExchangedState`, shape ``(n,)``. Local."""
    found = [
        np.full(len(each.nodes.nodes), isinstance(each, ExchangedState) and each.is_released)
        for each in members(state)
    ]
    return np.concatenate(found)


def release_vertices(steps: Iterable[tuple[PairState | JointState, Flags]]) -> list[str]:
    """Release all vertices of pairs with active vertices in a failed step. Collective.

    Args:
        steps: States of the pairs in the step, and which of their nodes are active.

    Returns:
        Between what these pairs are.
    """
    found: list[str] = []
    for state, active in steps:
        for each, start, end in zip(members(state), state.ends[:-1], state.ends[1:], strict=True):
            if not isinstance(each, ExchangedState) or each.is_released:
                continue
            holds = bool(active[start:end].any() or each.history.active.any())
            if reductions.anywhere(each.nodes.V.mesh.comm, holds):
                each.is_released = True
                found.append(each.given.pair.between)
    return found


def exchange_roles(
    contacts: Sequence[PairState], excluded: Sequence[Body], *, is_static: bool
) -> list[PairState]:
    """Add a pair with exchanged roles to each pair of nodes and segments. Collective.

    Its nodes are the vertices on convex edges and corners of the segments, its segments the facets
    of the nodes. Both pairs have the same laws. A vertex becomes active once a solution has it
    deeper below a face than a hundredth of the smallest facet there, and stays active as long as a
    force acts on it. Scenes in which no vertex penetrates so deep are solved as without exchanged
    roles.

    Multipliers keep its gap with inertia, as pushing it out would do work. A vertex above an active
    node stays inactive. Springs, of node-to-segment and mortar contact with inertia, begin without
    energy, at a depth that exceeds the compression of the springs at the nodes of the face.

    Roles are not exchanged for edge contact, obstacles, self contact, ties, massless nodes,
    convective friction, ``exchange=False`` and springs in statics, and if another pair has the
    vertices as nodes.

    Args:
        contacts: States of all pairs of a stepper. The new states are their `exchange`.
        excluded: Bodies; the nodes of a pair must not belong to a rigid one of them.
        is_static: Whether there is no inertia; then mortar pairs have them with ``exchange=True``
            only.

    Returns:
        The states of the new pairs.
    """
    pairs = [contact.pair for contact in contacts]
    found: list[PairState] = []
    if any(map(is_resolved, pairs)):
        return found
    roles = _Roles(pairs)
    rigid = [body.nodes for body in excluded if body.is_rigid]
    for contact in contacts:
        pair = contact.pair
        if not _may_exchange(pair, roles, is_static):
            continue
        assert isinstance(pair.segments, Surface)
        is_kink, facet = nodes_on_kinks(pair.segments)
        vertices = pair.segments.with_nodes(is_kink)
        is_excluded = bool(rigid) and bool(np.isin(vertices.nodes, np.concatenate(rigid)).any())
        comm = vertices.V.mesh.comm
        if not reductions.total(comm, len(vertices.nodes)):
            continue
        if reductions.anywhere(comm, is_excluded):
            continue
        contact.exchange = ExchangedState(contact, vertices, HYSTERESIS * facet[is_kink])
        found.append(contact.exchange)
    return found


class _Roles:
    """Nodes and vertices of the segments of all pairs that have both. Local.

    Args:
        pairs: All pairs of a stepper.
    """

    def __init__(self, pairs: Sequence[ContactPair]) -> None:
        self._pairs = [
            (pair, pair.nodes, pair.segments)
            for pair in pairs
            if pair.method != EDGES and isinstance(pair.segments, Surface)
        ]
        # Least and largest node of each side, by which most pairs are excluded.
        self._ends: GlobalInts = np.array(
            [[_ends(side.nodes) for side in sides] for _, *sides in self._pairs], dtype=np.int64
        ).reshape(-1, 2, 2)

    def are_exchanged(self, pair: ContactPair, segments: Surface) -> bool:
        """Whether another pair has the nodes of these segments as nodes, and in turn. Collective.

        Its nodes include those of the segments, and its segments the nodes of the pair.
        """
        own = segments.nodes, pair.nodes.nodes
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
        found = reductions.everywhere(segments.V.mesh.comm, has_both)
        return bool(found.any())


def _ends(nodes: Ints) -> tuple[int, int]:
    """Least and largest of sorted nodes; without any an empty range within all others."""
    return (int(nodes[0]), int(nodes[-1])) if len(nodes) else (_NO_NODE, -1)


def _may_exchange(pair: ContactPair, roles: _Roles, is_static: bool) -> bool:
    """Whether a pair supports exchanged roles and no other pair has them already. Collective."""
    law, segments = pair.enforcement, pair.segments
    if isinstance(law, Penalty):
        has_law = not (is_static or pair.is_convective or pair.method == EDGES)
    else:
        has_law = pair.method in (NODES, MORTAR) and not isinstance(law, Tied)
    by_default = not is_static or pair.method == NODES
    wanted = by_default if pair.exchange is None else pair.exchange
    if not (wanted and has_law and isinstance(segments, Surface)) or pair.touches_itself:
        return False
    if any(isinstance(each.smooth, RigidSphere) for each in (pair.nodes, segments)):
        return False
    return not roles.are_exchanged(pair, segments)
