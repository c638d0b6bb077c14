"""State of a contact pair in one stepper."""

import logging
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, Ints, indices
from dolfinx_nts.contact.cell_stiffness import SOFT, Layers
from dolfinx_nts.contact.enforcement import Penalty, Tied
from dolfinx_nts.contact.history import NEVER, ContactHistory, reloaded
from dolfinx_nts.contact.method import EDGES, MORTAR
from dolfinx_nts.contact.nodes_of_pairs import NodesOfPairs
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.passes import ForcesOfNodes, Passes
from dolfinx_nts.contact.springs import STIFFER
from dolfinx_nts.contact.tractions import Tractions
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.obstacles.rigid_shapes import RigidSphere
from dolfinx_nts.model.obstacles.rigid_surface import RigidSurface
from dolfinx_nts.model.segments import diameters
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.model.thickness import wall_thickness
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import Candidates, Search
from dolfinx_nts.search.edges.edge_search import EdgeSearch
from dolfinx_nts.search.edges.rigid_edge_search import RigidEdgeSearch
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.mortar.mortar_search import MortarSearch
from dolfinx_nts.search.obstacle_candidates import ObstacleSearch
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.self_contact import SelfContactSearch
from dolfinx_nts.search.shared_segments import SharedSegments
from dolfinx_nts.search.smooth.smooth_patches import SmoothPatches
from dolfinx_nts.search.smooth.smooth_search import SmoothSearch
from dolfinx_nts.search.spheres.sphere_search import SphereSearch

__all__ = ["PairState", "keep_springs", "springs_of"]

_logger = logging.getLogger("dolfinx_nts")

# Size of the facets of nodes relative to the smallest segment [-] above which nodes may be deeper
# than half of a segment. Smaller: thickness is measured for more pairs. At this ratio, nodes have
# segments up to a quarter of their own facets.
_FINE = 2.0


class PairState(Tractions, NodesOfPairs):
    """Contact of one pair in one stepper: search, springs and accepted contact. Collective.

    Only an accepted step replaces its `history`.

    Args:
        pair: The pair.
        passes: Passes of the stepper, to which this pair is added; None for a single pair.

    Attributes:
        pair: The argument.
        search: Global search of the candidates.
        accepted: Last accepted contact, see `accept`.
        eps_N: Stiffness of the penalty springs, of default ones on the stiffest segment, shape
            ``(n,)`` [N/m]; None before the first step, or without springs.
        layers: Layers of cells on which default springs depend in steps with inertia; None for
            springs of constant stiffness.
        eps_T: Stiffness of the tangential springs, shape ``(n,)`` [N/m], or None.
        vertices: States of vertices on convex edges and corners, see `VertexState`, whose forces
            belong to this pair.
        is_reverse: Whether this is contact of vertices of the segments of another pair, so that the
            reactions to its forces act on the nodes of that pair.
    """

    vertices: "tuple[PairState, ...]" = ()
    is_reverse = False

    def __init__(self, pair: ContactPair, passes: Passes | None = None) -> None:
        NodesOfPairs.__init__(self, [pair])
        at_rest = Passes(partial(reference_positions, pair.nodes.V), lambda: 0.0)
        Tractions.__init__(self, pair, _search(pair), at_rest if passes is None else passes)
        self.passes.join(pair, self._forces_on_segments)
        if isinstance(self.search, GlobalSearch):
            self.search.in_dents = isinstance(pair.enforcement, Penalty)
        # Separate search for the method `gap`, which must not change the candidates of steps.
        self._far_search = _search(pair)
        self._least_depth = self._extended_depth()
        self.set_initial_depth(0.0)
        self.eps_N: Floats | None = None
        self.layers: Layers | None = None
        self.eps_T: Floats | None = None
        # Smallest and largest stiffness by name, once the stiffness is chosen.
        self._ranges: dict[str, tuple[float, float]] | None = None
        self._logged = ""
        self.accepted: ContactHistory | Callable[[], ContactHistory]
        self.accepted = reloaded(ContactHistory.none(len(pair.nodes.nodes)))
        # Last function that was accepted in place of a history, and the history it returned.
        self._made: tuple[Any, ContactHistory] | None = None
        pair.attach(self)

    @property
    def segments(self) -> Surface | Obstacle:
        """Surface of the segments, or a rigid obstacle. Local."""
        return self.pair.segments

    @property
    def history(self) -> ContactHistory:
        """Contact of the last accepted step. Local."""
        accepted = self.accepted
        if isinstance(accepted, ContactHistory):
            return accepted
        if self._made is None or self._made[0] is not accepted:
            self._made = accepted, accepted()
        return self._made[1]

    @property
    def may_penetrate_initially(self) -> bool:
        """Whether nodes may initially penetrate deeply: only between meshed bodies. Local."""
        pair = self.pair
        others = pair.touches_itself or pair.method == EDGES or isinstance(pair.enforcement, Tied)
        return isinstance(self.search, GlobalSearch) and not others

    def _extended_depth(self) -> float:
        """Depth up to which nodes get segments smaller than half of their facets [m]. Collective.

        It is 0 without such segments. Facets of a `RigidSurface` get it by `RigidSurface.deepen`.
        Springs are compressed by a part of the height of the cells behind the nodes, which may be
        more than half of a small segment. The depth is at most half of the least thickness behind
        the segments.
        """
        nodes, segments, comm = self.pair.nodes, self.pair.segments, self.pair.nodes.V.mesh.comm
        depth = _kernels.DEEPEST * nodes.size
        if isinstance(segments, RigidSurface):
            if nodes.size > _FINE * float(diameters(segments.corners).min()):
                segments.deepen(depth)
            return 0.0
        if not self.may_penetrate_initially or isinstance(segments, Obstacle):
            return 0.0
        x = reference_positions(nodes.V)
        smallest = float(diameters(x[segments.segments]).min(initial=np.inf))
        if nodes.size <= _FINE * reductions.least(comm, smallest):
            return 0.0
        thickness = float(wall_thickness(segments, 2 * depth).min(initial=np.inf))
        return float(min(depth, reductions.least(comm, thickness) / 2))

    def set_initial_depth(self, depth: float) -> None:
        """Set the depth up to which initially penetrating nodes get segments [m]. Local.

        Nodes with facets larger than segments get these at larger depths in any case.
        """
        for search in (self.search, self._far_search):
            if self.may_penetrate_initially and isinstance(search, GlobalSearch):
                search.set_initial_depth(max(depth, self._least_depth))

    def reduce_initial_depth(self) -> None:
        """Reduce the initial depth to the current penetration. Collective."""
        if self.search.initial_depth <= self._least_depth:
            return
        comm: MPI.Comm = self.pair.nodes.V.mesh.comm
        if not reductions.anywhere(comm, bool(np.any(self.history.key > NEVER))):
            return  # before the first step
        held = -float(np.nan_to_num(self.history.gap).min(initial=0.0))
        held = reductions.largest(comm, held)
        usual = _kernels.DEEPEST * self.pair.segment_size
        self.set_initial_depth(
            min(self.search.initial_depth, held + usual) if held > usual / 2 else 0.0
        )

    def accept(self, history: ContactHistory | Callable[[], ContactHistory]) -> None:
        """Accept the contact of a step, or a function that computes it on demand. Local."""
        self.accepted, self.search.was_displaced = history, False

    def derive_penalty(
        self,
        stiffness: Callable[[], tuple[Floats, Floats]],
        stiffer: float,
        cells: Callable[[], tuple[Floats, Floats, Floats]] | None = None,
    ) -> None:
        """Choose the default stiffness of springs once, from the softer side. Collective.

        Args:
            stiffness: Returns two stiffnesses of all owned nodes of the space, ``(n,)`` [N/m], see
                `spring_stiffness`: the static one, and that of springs between nodes and segments
                that both do not deform. Called only if a default is needed.
            stiffer: Stiffness of springs relative to their nodes [-].
            cells: Returns three values of the owned nodes of the space, each of shape ``(n,)``:
                P-wave modulus, infinite at prescribed displacements and in rigid bodies [Pa];
                density [kg/m^3]; and ratio of shear to P-wave modulus [-]. With these, the default
                stiffness of springs follows from the cells where they deform; without, from the
                nodes.
        """
        if self._ranges is not None:
            return
        pair = self.pair
        normal: Floats = np.ones(len(pair.nodes.nodes))
        tangential = normal
        if _needs_default_stiffness(pair):
            softer, in_place = map(self._softer_side, stiffness())
            softer = np.where(np.isinf(softer), in_place, softer)
            normal = tangential = stiffer * softer
            if cells is not None:
                moduli, densities, shear = cells()
                of_cells = Layers.of(pair, moduli, densities)
                of_layers = of_cells.stiffness()
                if pair.is_convective or not _takes_default(pair):
                    # No fraction acts at edges: the mean layers of the nodes count.
                    of_layers = of_layers * of_cells.stiffness_fraction(None, None)
                normal = np.where(of_cells.deforms, of_layers / SOFT, normal)
                # Relative to the cells in shear as stiff as loaded normal springs in compression,
                # as no impact arrives along the surface. Stiffer by M/G: a sliding block that stops
                # takes 12.5 instead of 8 iterations a step. Softer: slip reverses too late in an
                # oblique impact.
                along = STIFFER * self._least(shear) * normal
                tangential = np.where(of_cells.deforms, np.fmax(along, softer), normal)
                if _takes_default(pair):
                    self.layers = of_cells
        self.choose_penalty(normal, tangential)

    def _least(self, of_all: Floats) -> float:
        """Smallest of the values of owned nodes, ``(n,)``, on both surfaces. Collective."""
        sides = (self.pair.nodes, self.pair.segments)
        own = [
            of_all[side.nodes].min(initial=np.inf) for side in sides if isinstance(side, Surface)
        ]
        return float(reductions.least(self.pair.nodes.V.mesh.comm, float(min(own))))

    def _softer_side(self, of_all: Floats) -> Floats:
        """Smaller stiffness of each node and of the stiffest vertex, ``(m,)`` [N/m]. Collective.

        ``of_all`` has the stiffness of all owned nodes of the space, shape ``(n,)`` [N/m]. A
        prescribed node (NaN) has the largest stiffness of its surface, or is rigid if all nodes are
        prescribed.
        """
        sides = (self.pair.nodes, self.pair.segments)
        values = [of_all[side.nodes] for side in sides if isinstance(side, Surface)]
        comm = self.pair.nodes.V.mesh.comm
        own = [float(np.fmax.reduce(each, initial=0.0)) for each in values]
        stiffest = reductions.largest(comm, np.array(own))
        stiffest[stiffest == 0] = np.inf
        of_nodes = np.where(np.isnan(values[0]), stiffest[0], values[0])
        return np.minimum(of_nodes, stiffest[1]) if len(values) > 1 else of_nodes

    def choose_penalty(self, normal: Floats, tangential: Floats) -> None:
        """Set and log the stiffness of springs once. Collective.

        ``normal`` and ``tangential`` are the default values before the factor ``share``, shape
        ``(n,)`` [N/m].
        """
        if self._ranges is not None:
            return
        self._ranges, share, pair = {}, 1.0, self.pair
        if isinstance(pair.enforcement, Penalty):
            given, share = pair.enforcement.eps_N, pair.enforcement.share
            self.eps_N = share * (normal if given is None else np.full_like(normal, given))
            self._ranges["eps_N"] = self._range(self.eps_N)
        if pair.friction is not None and pair.has_slip_spring:
            given = pair.friction.eps_T
            self.eps_T = share * (tangential if given is None else np.full_like(normal, given))
            self._ranges["eps_T"] = self._range(self.eps_T)
        # A first step that is repeated with another length chooses the stiffness again.
        if pair.nodes.V.mesh.comm.rank == 0 and (text := str(self)) != self._logged:
            self._logged = text
            _logger.info("%s", text)

    def gap(self, x: Floats, reach: float = np.inf) -> Floats:
        return self._faced(x, reach)[2]

    def _faced(self, x: Floats, reach: float) -> tuple[Candidates, Ints, Floats]:
        """Candidates within reach, candidate of each node, and gap. Collective.

        Arguments as for `gap`.
        """
        search, t = self._far_search, self.passes.time()
        search.begin(t, t)
        x = search.frame.at_end(x)
        candidates, _ = search.update(x, np.inf)
        current = candidates.find(self.history.key)
        points, x = self.facets.points(x), candidates.scatter.forward(x)
        return candidates, *candidates.pair(points, x, current, reach)

    def nodes_inside(self, x: Floats) -> tuple[Ints, Floats, Floats]:
        """Find initially penetrating nodes, also at larger depths than in a run. Collective.

        Args:
            x: Positions of the local nodes of the space, owned and ghost, shape ``(l, 3)`` [m].

        Returns:
            Indices among the nodes of the surface, shape ``(m,)``, depths, ``(m,)`` [m], and unit
            normals of the segments, ``(m, 3)``.
        """
        before = self.search.initial_depth
        self.set_initial_depth(np.inf)
        candidates, segment, gap = self._faced(x, np.inf)
        node = indices(gap < 0)
        node = node[gap[node] < -_kernels.DEEPEST * candidates.size[segment[node]]]
        points, there = self.facets.points(x).take(node), candidates.scatter.forward(x)
        gradient = candidates.contact("static", points, there, there, segment[node]).gradient
        self.set_initial_depth(before)
        return node, -gap[node], gradient[:, :3]

    def _forces_on_segments(self, of_nodes: ForcesOfNodes) -> Floats:
        """Reactions on the vertices of the segments. Collective.

        Args:
            of_nodes: Returns the forces on the nodes, shape ``(n, 3)`` [N].

        Returns:
            Values at the owned nodes of the space, shape ``(n, 3)`` [N].
        """
        candidates, segment, _ = self._faced(self.passes.positions(), np.inf)
        x = candidates.scatter.forward(self.passes.positions())
        node = indices(self.history.active & (segment >= 0))
        points, segment = NodalPoints(self.pair.nodes.nodes[node]), segment[node]
        row, segment, parts = self._shares(points, x, node, segment, candidates)
        points = points.take(row)
        gradient = candidates.contact("static", points, x, x, segment).gradient
        gradient = gradient.reshape(len(row), 1 + candidates.segments.shape[1], 3)
        # The gradient of the gap is the normal at the node, and -phi times the normal at a vertex.
        phi = -np.einsum("mki,mi->mk", gradient[:, 1:], gradient[:, 0])
        forces = -(parts[:, None] * phi)[..., None] * of_nodes(self.history)[node[row], None]
        total = np.zeros((self.pair.nodes.V.dofmap.index_map.size_local, 3))
        candidates.scatter.add(total, candidates.segments[segment], forces)
        return total

    def _shares(
        self, points: NodalPoints, x: Floats, node: Ints, segment: Ints, candidates: Candidates
    ) -> tuple[Ints, Ints, Floats]:
        """Segments that share the force of a node, node by node. Local.

        Returns indices of the nodes, segments and fractions of the force [-], all ``(i,)``.
        """
        shared = SharedSegments(len(node))
        several = indices(self.history.shared[node] != 0)
        if len(several) and (around := candidates.adjacent(x)) is not None:
            (adjacent, vertices), own = around, segment[several]
            there, size = points.take(several).of(x), candidates.size[own]
            shared.replace(several, *adjacent.as_near(there, vertices, own, size))
        row, segment, start = shared.entries(np.arange(len(node), dtype=np.int32), segment)
        return row, segment, (1 / np.diff(start))[row]

    def _forces_of_reverse_passes(self, of_nodes: ForcesOfNodes) -> Floats:
        """Forces of opposite passes and vertices on the nodes of this pair, see `Tractions`."""
        total, nodes = super()._forces_of_reverse_passes(of_nodes), self.nodes.nodes
        comm: MPI.Comm = self.nodes.V.mesh.comm
        for each in self.vertices:
            if not each.is_reverse:
                total[np.searchsorted(nodes, each.nodes.nodes)] += of_nodes(each.history)
            elif reductions.anywhere(comm, bool(each.history.active.any())):
                total += each._forces_on_segments(of_nodes)[nodes]
        return total

    def serialize(self, archive: Archive, name: str) -> None:
        """Serialize the accepted contact and springs, but not the search. Collective.

        Args:
            archive: Archive that stores or returns the values.
            name: Prefix of the names of the values.
        """
        ids = self.pair.nodes.node_ids
        stored: dict[str, Any] = {
            f.name: archive.nodal(f"{name}/{f.name}", ids, getattr(self.history, f.name))
            for f in fields(ContactHistory)
        }
        self.accept(ContactHistory(**stored))
        self.set_initial_depth(archive.same(f"{name}/sunk", self.search.initial_depth))
        for spring in ("eps_N", "eps_T"):
            value = getattr(self, spring)
            if archive.same(f"{name}/has_{spring}", value is not None):
                value = np.zeros(len(ids)) if value is None else value
                setattr(self, spring, archive.nodal(f"{name}/{spring}", ids, value))
            else:
                setattr(self, spring, None)
        self.layers = Layers.serialized(archive, f"{name}/layers", self.pair, self.layers)
        chosen = archive.same(f"{name}/springs_are_chosen", self._ranges is not None)
        if archive.restores:
            springs = (("eps_N", self.eps_N), ("eps_T", self.eps_T))
            ranges = {name: self._range(values) for name, values in springs if values is not None}
            self._ranges = ranges if chosen else None
        number = archive.same(f"{name}/num_vertices", len(self.vertices))
        for i, vertices in enumerate(self.vertices[:number], start=1):
            vertices.serialize(archive, f"{name}/vertices_{i}")

    def _range(self, stiffness: Floats) -> tuple[float, float]:
        """Smallest and largest value on all ranks. Collective."""
        comm = self.pair.nodes.V.mesh.comm
        least = reductions.least(comm, float(stiffness.min(initial=np.inf)))
        return least, reductions.largest(comm, float(stiffness.max(initial=0.0)))

    def __str__(self) -> str:
        """Laws, and the stiffness of springs after the first step. Local."""
        text = self.pair.describe()
        for name, (least, greatest) in (self._ranges or {}).items():
            values = f"{least:.3g}" + (f" to {greatest:.3g}" if greatest > least else "")
            text += f", {name} = {values} N/m"
        return text


def springs_of(state: PairState) -> tuple[Any, ...]:
    """Stiffness of the springs that a pair has chosen, for `keep_springs`. Local."""
    return state.eps_N, state.layers, state.eps_T, state._ranges


def keep_springs(state: PairState, known: tuple[Any, ...]) -> None:
    """Give a pair springs that were chosen in another run. Local."""
    state.eps_N, state.layers, state.eps_T, state._ranges = known


def _takes_default(pair: ContactPair) -> bool:
    """Whether a pair has normal springs without a given stiffness. Local."""
    return isinstance(pair.enforcement, Penalty) and pair.enforcement.eps_N is None


def _needs_default_stiffness(pair: ContactPair) -> bool:
    """Whether a pair needs a default stiffness. Local."""
    normal = _takes_default(pair)
    slip = pair.friction is not None and pair.has_slip_spring and pair.friction.eps_T is None
    return normal or slip


def _search(pair: ContactPair) -> Search:
    """Global search of a pair. Collective."""
    if isinstance(pair.segments, RigidSurface) and pair.method == EDGES:
        return RigidEdgeSearch(pair.segments, pair.nodes)
    if isinstance(pair.segments, Obstacle):
        return ObstacleSearch(pair.segments, pair.nodes)
    if pair.touches_itself:
        return SelfContactSearch(pair.nodes, pair.segments)
    if pair.method == EDGES:
        return EdgeSearch(pair.nodes, pair.segments)
    if pair.method == MORTAR:
        return MortarSearch(pair.nodes, pair.segments)
    if isinstance(pair.segments.smooth, RigidSphere):
        return SphereSearch(pair.nodes, pair.segments)
    if pair.segments.smooth:
        return SmoothSearch(pair.nodes, pair.segments, SmoothPatches.of(pair.segments))
    return GlobalSearch(pair.nodes, pair.segments)
