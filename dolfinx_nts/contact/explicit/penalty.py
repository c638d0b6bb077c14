"""Penalty contact of explicit steps.

The force is minus the gradient of the spring energy at the current state, which conserves both
momenta. There is no iteration.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.cell_stiffness import SOFT, Layers
from dolfinx_nts.contact.checks.passage import Passage, passing_nodes_message, shortest_passage_of
from dolfinx_nts.contact.checks.soft_springs import deep_from
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.explicit.compliance import NodalProperties, compliance
from dolfinx_nts.contact.explicit.friction import Friction, SpringFriction
from dolfinx_nts.contact.explicit.neighbour_list import NeighbourList, under_load
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import Candidates, lost_depth
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["ContactSprings", "SpringForces"]


_NO_DISSIPATION: Floats = np.empty(0)
_NO_WORK = (0.0,) * 6
_NO_SPRINGS = _kernels.Springs(
    np.empty(0, dtype=np.int32),
    np.empty(0, dtype=np.int64),
    np.empty((0, 1), dtype=np.int32),
    np.empty((0, 1, 3)),
    np.empty(0),
)


class SpringForces(NamedTuple):
    """Forces of the springs of a pair at one state.

    Attributes:
        scatter: Scatter of the forces to their owners; None if no rank has a node near a segment.
        springs: Springs of the active nodes, by indices among the nodes of the surface.
        dissipation: Energy dissipated by friction in the step at all nodes of the surface,
            shape ``(n,)`` [J]; empty without friction.
        history: Returns the contact history of the state.
    """

    scatter: NodalScatter | None
    springs: _kernels.Springs
    dissipation: Floats
    history: Callable[[], ContactHistory]

    def add_to(self, total: Floats) -> None:
        """Add the forces to the nodal forces, shape ``(n, d)`` [N]. Collective."""
        if self.scatter is not None:
            forces = total if total.shape[1] == 3 else np.zeros((len(total), 3))
            self.scatter.add(forces, self.springs.dofs, self.springs.force)
            if forces is not total:
                total += forces[:, : total.shape[1]]

    @property
    def stored(self) -> float:
        """Energy of all springs on this rank [J]. Local."""
        return float(self.springs.energy.sum())


class ContactSprings:
    """Springs of one contact pair by penalty, for explicit steps. Collective.

    Args:
        state: State of the contact pair.
        at: Properties of the owned nodes.

    Attributes:
        num_lost: Number of nodes of this rank that were too deep inside to find a segment in the
            last evaluation.
        num_deep: Number of nodes of this rank that were deep inside, see `SoftSprings`.
        shortest_passage: Relative displacement in a step below which no node passes through a
            surface [m].

    Raises:
        ValueError: The pair is enforced by multipliers.
    """

    _acts_on_areas = True

    def __init__(self, state: PairState, at: NodalProperties) -> None:
        pair = state.pair
        if not isinstance(pair.enforcement, Penalty):
            raise ValueError(
                "expected contact by Penalty for an explicit step, "
                f"given {type(pair.enforcement).__name__}: use enforcement=Penalty()"
            )
        self._state, law = state, pair.friction
        self._friction = Friction() if law is None else SpringFriction(state, law)
        self._share, given = float(pair.enforcement.share), pair.enforcement.eps_N
        self._penalty = None if given is None else self._share * given
        self._comm: MPI.Comm = pair.nodes.V.mesh.comm
        # If nodes of both sides have springs, each spring acts on half of the mass.
        sides = (2 if pair.touches_itself else 1) / self._share
        self._reduced_mass: Floats = 1 / (sides * compliance(pair, at))
        self._cells = np.full(len(self._reduced_mass), np.inf)
        # Edges touch at points; their springs have no area by which cells could limit their
        # stiffness.
        layers = None
        if given is None and pair.method != EDGES:
            layers = Layers.of(pair, at.modulus, at.density)
            self._cells[:] = layers.stiffness(in_series=True) / sides
        self._no_contact = ContactHistory.none(len(self._reduced_mass))
        of_areas = self._acts_on_areas and pair.method != EDGES
        of_cells = self._cells / SOFT if of_areas else None
        self._neighbours = NeighbourList(state, of_cells, layers)
        self.shortest_passage = shortest_passage_of(pair)
        self._deep = deep_from(pair)
        self.num_lost = self.num_deep = 0
        # Nodes of the springs of the last evaluation, and their gaps [m].
        self._pressed: tuple[Ints, Floats] = np.empty(0, dtype=np.int32), np.empty(0)

    @property
    def _num_own(self) -> int:
        """Number of nodes of the surface in each pair: two for an edge."""
        return 2 if self._state.pair.method == EDGES else 1

    @property
    def compression(self) -> Floats:
        """Compression of the springs in the last evaluation, shape ``(n,)`` [m]. Local."""
        node, gap = self._pressed
        depth: Floats = np.zeros(len(self._reduced_mass))
        depth[node] = -gap
        return depth

    def forget(self) -> None:
        """Discard the neighbour list after the state was set. Local."""
        self._neighbours.forget()

    def serialize(
        self, archive: Archive, name: str, forces: SpringForces | None, x: Floats
    ) -> SpringForces:
        """Serialize the last evaluation and the neighbour list. Collective.

        Call it after `PairState.serialize`. ``forces`` is the last evaluation, if any, not needed
        for reading; ``x`` are the positions of the local nodes in it, shape ``(l, 3)`` [m]. Returns
        the evaluation.
        """
        state, neighbours = self._state, self._neighbours
        neighbours.serialize(archive, f"{name}/neighbours", x)
        candidates, n = neighbours.candidates, len(state.nodes.nodes)
        counts = np.bincount(neighbours.number, minlength=n)
        width = int(reductions.largest(self._comm, float(counts.max(initial=1))))
        force: Floats = np.zeros((n, width, 1 + candidates.segments.shape[1], 3))
        if forces is not None:
            node = forces.springs.node
            force[node, np.arange(len(node)) - np.searchsorted(node, node)] = forces.springs.force
        force = archive.nodal(f"{name}/force", state.nodes.node_ids, force)
        if forces is not None and not archive.restores:
            return forces
        history = state.history
        dissipation = _NO_DISSIPATION if state.pair.friction is None else history.dissipation
        if neighbours.is_idle:
            return SpringForces(None, _NO_SPRINGS, dissipation, lambda: history)
        (row,) = history.active[neighbours.number].nonzero()
        node, segment = neighbours.number[row], neighbours.current[row]
        dofs = NodalPoints(state.nodes.nodes[node]).dofs(candidates.segments.take(segment, axis=0))
        force = force[node, np.arange(len(node)) - np.searchsorted(node, node)]
        energy = history.energy[node] / counts[node]
        springs = _kernels.Springs(node, candidates.key[segment], dofs, force, energy)
        return SpringForces(candidates.scatter, springs, dissipation, lambda: history)

    @property
    def lacks_penalty(self) -> bool:
        """Whether the default penalty is not chosen yet. Local."""
        return self._state.eps_N is None and self._penalty is None

    @property
    def squared_frequency(self) -> float:
        """Highest squared angular frequency of the springs chosen so far [1/s^2]. Collective."""
        state, friction = self._state, self._state.pair.friction
        normal = self._penalty if state.eps_N is None else state.eps_N
        if (stiffest := self._neighbours.stiffest) is not None and normal is not None:
            normal = under_load(normal, stiffest)
        given = None if friction is None else friction.eps_T
        tangential = given if state.eps_T is None else state.eps_T
        highest = 0.0
        for stiffness in (normal, tangential):
            if stiffness is not None:
                highest = max(highest, (stiffness / self._reduced_mass).max(initial=0.0))
        return float(reductions.largest(self._comm, highest))

    def choose_penalty(self, squared_frequency: float) -> None:
        """Choose the default stiffness of springs. Collective.

        ``squared_frequency`` is the largest squared angular frequency of normal springs with the
        reduced mass of a node and a vertex of a segment [1/s^2]. Springs are as stiff as cells, or
        as this frequency allows; under loads larger than those of waves they are stiffer than cells
        if the frequency allows it.
        """
        stiffest: Floats = squared_frequency * self._reduced_mass
        penalty = tangential = np.minimum(stiffest, self._cells / SOFT)
        if self._penalty is not None:
            penalty = tangential = np.full_like(penalty, self._penalty)
        elif self._state.pair.method != EDGES:
            self._neighbours.stiffest = stiffest
            # As stiff as loaded normal springs: with softer ones slip reverses too late in an
            # oblique impact.
            tangential = under_load(penalty, stiffest)
        # `PairState.choose_penalty` multiplies by the share.
        self._state.choose_penalty(penalty / self._share, tangential / self._share)

    @property
    def num_segments(self) -> int:
        """Number of candidate segments of this rank. Local."""
        return len(self._neighbours.candidates.size)

    def passing(self, x_n: Floats, x: Floats, moved: float, dt: float) -> str:
        """Message naming nodes that pass through a surface in a step, or "".

        Args:
            x_n: Positions of the local nodes of the space at its start, ``(l, 3)`` [m].
            x: Positions at its end, shape ``(l, 3)`` [m].
            moved: Half the bound on the approach of nodes and segments [m].
            dt: Length of the step [s].
        """
        state, reach = self._state, 2 * moved + self._neighbours.reach
        frame = state.search.frame
        x_n, x = frame.at_start(x_n), frame.at_end(x)
        candidates, _ = state.search.update(x_n, reach)
        points, forward = state.facets.points(x_n), candidates.scatter.forward
        ends = forward(x_n), forward(x)
        start = candidates.pair(points, ends[0], candidates.find(state.history.key), reach)
        passage = Passage.through(candidates, points, ends, start, reach)
        return passing_nodes_message(state.nodes, passage, dt)

    def _count_lost(self, x: Floats, before: Ints, after: Ints) -> int:
        """Number of listed nodes that lost their segments as they are too deep. Local."""
        lost = _kernels.lost(before, after)
        if not len(lost):
            return 0
        candidates, segment = self._neighbours.candidates, before[lost]
        gap = candidates.gap(self._neighbours.points.take(lost), x, segment)
        (deep,) = (gap < -lost_depth(candidates, segment)).nonzero()
        if not len(deep):
            return 0
        points = self._neighbours.points.take(lost[deep])
        return int(np.count_nonzero(~candidates.is_at_rim(points, x, segment[deep])))

    def evaluate(self, x_n: Floats, x: Floats, step: float, dt: float) -> SpringForces:
        """Forces at x, without a change of the accepted contact. Collective.

        Args:
            x_n: Accepted positions of the local nodes, owned and ghost, shape ``(l, 3)`` [m];
                only used with friction.
            x: Positions at the end of the step, shape ``(l, 3)`` [m].
            step: Half the bound on the approach of nodes and segments since the last evaluation
                [m].
            dt: Length of the step [s].
        """
        # Local copies, so that the history does not keep the springs alive.
        seen, nothing, num_own = self._neighbours, self._no_contact, self._num_own
        frame = self._state.search.frame
        seen.update(x, step)
        x_n, x = frame.at_start(x_n), frame.at_end(x)
        self.num_lost = self.num_deep = 0
        self._pressed = np.empty(0, dtype=np.int32), np.empty(0)
        if seen.is_idle:
            values = self._friction.without_contact()
            return SpringForces(
                None,
                _NO_SPRINGS,
                values.get("dissipation", _NO_DISSIPATION),
                lambda: replace(nothing, **values),
            )
        candidates = seen.candidates
        x = candidates.scatter.forward(x)
        begin_at = self._begin_at(x)
        begin, segment, gap, springs = self._springs(x, begin_at)
        self.num_lost = self._count_lost(x, seen.current, segment)
        if seen.change(x, segment, gap, begin, dt):
            # Nodes away from free edges keep all new segments.
            begin, segment, gap, springs = self._springs(x, begin_at, np.inf)
            seen.keep(segment, gap)
        seen.remember(begin, gap)
        number, stiffness, shared = seen.number, seen.secant(gap), nothing.shared
        if seen.start is not None:
            shared = seen.shared.sums(candidates.key)
        fraction, soft_depth = seen.stiffness_fraction, seen.soft_depth
        self.num_deep = int(np.count_nonzero(gap < -self._deep))
        self._pressed = number[gap < 0], gap[gap < 0]
        lambda_N = stiffness * gap
        slip = self._friction.add_to(
            springs, candidates, x_n, x, segment, lambda_N, dt, seen.area_fraction
        )
        on_nodes = self._on_own_side(springs, candidates)

        def history() -> ContactHistory:
            # Without friction the force is along the normal.
            key, active, multiplier, force, gaps, normal, energy = _kernels.contact_of_springs(
                springs, num_own, len(nothing.key), number, segment, gap, candidates.key, stiffness
            )
            values: dict[str, Any] = {
                "key": key,
                "shared": shared,
                "active": active,
                "lambda_N": multiplier,
                "force": force if on_nodes is None else on_nodes,
                "gap": gaps if begin_at is None else gaps + begin_at,
                "offset": nothing.offset if begin_at is None else np.where(active, begin_at, 0.0),
                "part": fraction,
                "soft_depth": soft_depth,
                "normal": normal,
                "energy": energy,
            }
            return ContactHistory(**vars(nothing) | values | slip)

        dissipation = slip.get("dissipation", _NO_DISSIPATION)
        return SpringForces(candidates.scatter, springs, dissipation, history)

    def _springs(
        self, x: Floats, begin_at: Floats | None, slack: float = _kernels.HYSTERESIS
    ) -> tuple[Floats | float, Ints, Floats, _kernels.Springs]:
        """Gaps at which springs of the rows begin, and results of `Candidates.penalty_forces`.

        ``begin_at`` are gaps at which springs begin, see `_begin_at`.
        """
        seen = self._neighbours
        of_rows = seen.number, seen.secant, seen.start
        begin = 0.0 if begin_at is None else begin_at[seen.number]
        segment, gap, springs = seen.candidates.penalty_forces(
            seen.points, x, seen.current, seen.reach, *of_rows, slack, begin
        )
        energy = springs.energy
        energy -= seen.missing_energy(gap)[gap < 0]
        return begin, segment, gap, springs

    def _begin_at(self, x: Floats) -> Floats | None:
        """Gaps at which springs begin, shape ``(n,)`` [m]; None if they begin at 0. Local.

        ``x`` are positions with ghosts, shape ``(l, 3)`` [m].
        """
        return None

    def _on_own_side(self, springs: _kernels.Springs, candidates: Candidates) -> Floats | None:
        """Forces on the nodes of the surface, ``(n, 3)`` [N]; None if springs act on single nodes.

        Collective.
        """
        if self._num_own == 1:
            return None
        own, total = slice(self._num_own), np.zeros((candidates.scatter.index_map.size_local, 3))
        candidates.scatter.add(total, springs.dofs[:, own], springs.force[:, own])
        on_nodes: Floats = total[self._state.nodes.nodes]
        return on_nodes

    def work(
        self, old: SpringForces, new: SpringForces, x: Floats, du: Floats
    ) -> tuple[float, ...]:
        """Work of the mean of two forces on this rank, as in `ContactWork` [J]. Collective.

        ``du`` is the displacement increment of the owned nodes, shape ``(n, d)`` [m], and ``x`` are
        their final positions, shape ``(n, 3)`` [m].
        """
        if old.scatter is None and new.scatter is None:
            return _NO_WORK
        du = in_space(du)
        frame, obstacle = self._state.search.frame, 0.0
        if frame.moves:
            carried = frame.carried(frame.at_start(x - du), frame.at_end(x))
            du = du - carried
            for scatter, springs in ((old.scatter, old.springs), (new.scatter, new.springs)):
                on_map = (lambda y: y) if scatter is None else scatter.forward
                own = slice(self._num_own)
                displacement = on_map(carried)[springs.dofs[:, own]]
                obstacle += float(np.vdot(springs.force[:, own], displacement)) / 2
        du_old = du if old.scatter is None else old.scatter.forward(du)
        du_new = du_old
        if new.scatter is not old.scatter:
            du_new = du if new.scatter is None else new.scatter.forward(du)
        causes = _kernels.work_by_cause(old.springs, new.springs, du_old, du_new, new.dissipation)
        return *causes, obstacle
