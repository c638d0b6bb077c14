"""One attempt at a step of a contact pair: pairing, forces, active set.

A `ContactStep` never touches the pair. Evaluating it gives a
`ContactState`, from which residual and tangent are assembled. No PETSc here.
"""

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_nts.contact import ContactPair
from dolfinx_nts.contact_history import ContactHistory, ContactWork
from dolfinx_nts.contact_rows import ContactState, Rows
from dolfinx_nts.enforcement import LagrangeMultiplier, Penalty
from dolfinx_nts.independent import independent
from dolfinx_nts.obstacle_neighbourhood import ObstacleNeighbourhood
from dolfinx_nts.pivoting import Pivoting
from dolfinx_nts.search import Neighbourhood
from dolfinx_nts.slip import ConvectiveSlip, Slip
from dolfinx_nts.tangential import Tangential

__all__ = ["ContactStep"]

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int32]

_CLOSE = 0.01  # of a segment: gaps that are closed between Newton iterations
_MOST_MOVES = 2  # a node that changed its segment this often keeps it
_RESTLESS = 4  # changes of state after which a node is named if the step fails
# Force of an active node, and gap times stiffness, that are none: of k h, as in
# the round-off of the residual.
_ROUNDING = 16 * np.finfo(np.float64).eps


class ContactStep:
    """One attempt at a step; collective, as all its methods.

    Args:
        pair: The contact pair.
        scheme: Contact kernel: ``"conserving"``, ``"midpoint"`` or
            ``"static"``.
        x_n: Accepted positions of the local nodes of the space, owned
            and ghost, shape ``(l, 3)`` [m].
        x_trial: The same for the ballistic state x_n + h v_n.
        stiffness: Stiffness of each owned node of the space, ``(n,)``
            [N/m]: the weight in the tests for contact and stick.
        free: 1 where the displacement of an owned node is unknown, 0
            where it is given, shape ``(n, 3)``; None if all are unknown.

    Attributes:
        pair: The contact pair.
        neighbourhood: Segments in reach.
        active: Active nodes of this rank, shape ``(n,)``.
        lambda_N: Normal multipliers, shape ``(n,)`` [N].
        num_active: Active pairs on all ranks.
        may_touch: Whether a node can become active, on any rank.
        touched: Whether one was, in any iteration.
        segment: Segment of each node or -1, shape ``(n,)``.
        segment_n: The same at t_n.
        reach: Largest gap of interest [m].
        x_n: Positions at t_n of the nodes that the neighbourhood knows.
        x: Their positions in the last evaluation.
    """

    def __init__(
        self,
        pair: ContactPair,
        scheme: str,
        x_n: Floats,
        x_trial: Floats,
        stiffness: Floats,
        free: Floats | None = None,
    ) -> None:
        """Find the segments in reach and the nodes that may touch."""
        self.pair, self._scheme = pair, scheme
        self.comm: MPI.Comm = pair.nodes.V.mesh.comm
        nodes, history = pair.nodes.nodes, pair.history
        self._stiffness = stiffness[nodes]
        # Elastic impact holds gaps; in statics there is no impact.
        law = pair.enforcement
        elastic = isinstance(law, LagrangeMultiplier) and law.impact == "elastic"
        self._holds = elastic and scheme != "static"
        pair.derive_stiffness(stiffness)

        step = np.linalg.norm(x_trial - x_n, axis=1).max(initial=0.0)
        step = self.comm.allreduce(step, op=MPI.MAX)
        # Both surfaces may move, Newton iterates overshoot, and a node up
        # to half a segment deep still belongs to its segment.
        self.reach = 3 * step + 0.5 * pair.segment_size
        here: Neighbourhood | ObstacleNeighbourhood
        here, _ = pair.search.update(x_n, self.reach)
        self.neighbourhood = here
        self._free = None if free is None else here.with_ghosts(free)
        self.x_n = self.x = here.with_ghosts(x_n[: here.index_map.size_local])
        trial = here.with_ghosts(x_trial[: here.index_map.size_local])

        at_n = here.pair(self.x_n, nodes, here.find(history.key), self.reach)
        at_trial = here.pair(trial, nodes, at_n[0], self.reach)
        # The gap at t_n counts on the segment that the trial state meets.
        segment = np.where(at_trial[0] >= 0, at_trial[0], at_n[0])
        gap_n = at_n[1].copy()
        moved = np.flatnonzero((segment >= 0) & (segment != at_n[0])).astype(np.int32)
        gap_n[moved] = here.gap(self.x_n, nodes[moved], segment[moved])
        eligible = segment >= 0
        if isinstance(law, LagrangeMultiplier) and self._holds:
            size = here.size[segment] if len(here.size) else np.ones(len(nodes))
            eligible &= law.eligible(gap_n, at_trial[1], size, history.active)
            may_touch = eligible
        else:
            # A gap that may close within the step.
            may_touch = (np.fmin(gap_n, at_trial[1]) < step) | history.active
        if pair.touches_itself and isinstance(law, LagrangeMultiplier):
            assert isinstance(here, Neighbourhood)
            urgency = 2 * history.active + (np.fmin(gap_n, at_trial[1]) < 0)
            eligible &= independent(here, pair.nodes, segment, eligible, urgency)
        self.may_touch = bool(self.comm.allreduce(int(may_touch.sum())))
        self._eligible = np.flatnonzero(eligible).astype(np.int32)
        self.segment: Ints = at_n[0]
        self.segment_n: Ints = at_n[0].copy()
        self._gap: Floats = at_n[1]
        self._moves, self._flips = np.zeros((2, len(nodes)), dtype=np.int32)
        self.num_active, self.touched = 0, False
        self._pivoting = Pivoting(self.comm)
        self.active = history.active & eligible
        self.lambda_N = np.where(self.active, history.lambda_N, 0.0)
        self._tangential = (
            None if pair.friction is None else Tangential(pair, self._stiffness, self.comm)
        )

    @property
    def sliding(self) -> Flags:
        """Active nodes that slide, shape ``(n,)``."""
        flags: Flags = self.active.copy()
        return flags if self._tangential is None else flags & self._tangential.sliding

    def evaluate(self, x: Floats, R_bulk: Floats | None, iteration: int) -> ContactState:
        """Pair, evaluate the kernels, update multipliers and active set.

        Args:
            x: Positions of the owned nodes, shape ``(n, 3)`` [m].
            R_bulk: Residual without contact at the owned nodes, shape
                ``(n, 3)`` [N]: the multipliers balance it at the nodes.
                None: they stay as they are.
            iteration: Number of the Newton iteration, from 0.

        Returns:
            The pairs that may transmit force.
        """
        x = self.x = self.neighbourhood.with_ghosts(x)
        node, changed = self._find_pairs(x, iteration)
        rows = self._evaluated = self._rows(x, node)
        slope: Floats = np.zeros(len(node))
        R = None if R_bulk is None else R_bulk[rows.dofs[:, 0]]
        if isinstance(self.pair.enforcement, Penalty):
            slope = self._push(rows)
            changed += self._rub(rows, iteration)
        else:
            # Decisions follow from multipliers, multipliers from decisions.
            self._balance(rows, R)
            changes = self._update_active(rows, iteration) + self._rub(rows, iteration)
            if changes or self._tangential is not None:
                self._balance(rows, R)
            changed += changes
        active = self.active[node]
        self.num_active = self.comm.allreduce(int(np.count_nonzero(active)))
        self.touched |= self.num_active > 0
        if iteration == 0:
            # Without a previous iteration the set of active pairs is new.
            changed = int(np.count_nonzero(active))
        return self._state(rows, slope, changed)

    def close_gaps(self, x: Floats, u: Floats) -> None:
        """Move nodes held by a normal multiplier alone to where it wants them.

        Along the normals of the last evaluation. Otherwise the linear system
        has to do so, which takes an action of the tangent. Collective.

        Args:
            x: Positions of the owned nodes, shape ``(n, 3)`` [m].
            u: Their displacements, shape ``(n, 3)`` [m], changed. They are
                known to more digits than positions.
        """
        if not (self.num_active and isinstance(self.pair.enforcement, LagrangeMultiplier)):
            return
        rows, here = self._evaluated, self.neighbourhood
        held = self.active[rows.node] & rows.eliminable
        if self._tangential is not None:
            held &= ~self._tangential.sticks(rows.node, held)
        nodes, normal = rows.dofs[held, 0], rows.normal[held]
        excess = here.gap(here.with_ghosts(x), nodes, rows.segment[held])
        if self._holds:
            excess -= rows.gap_n[held]
        way = excess / np.einsum("mi,mi->m", normal, rows.gradients[held, 0, :3])
        # Nodes far from where the normals hold are left to the linear system.
        near = np.abs(way) <= _CLOSE * self.pair.segment_size
        u[nodes[near]] -= way[near, None] * normal[near]

    def _rub(self, rows: Rows, iteration: int) -> int:
        """Decide on stick and slip; returns how many nodes do not fit."""
        if self._tangential is None:
            return 0
        node = rows.node
        before = self._tangential.sliding[node]
        violators = self._tangential.update(
            rows, -self.lambda_N[node], self.active[node], iteration
        )
        self._flips[node] += before != self._tangential.sliding[node]
        return violators

    def add_multipliers(self, state: ContactState, increments: Floats) -> None:
        """Add increments of the multipliers, pair by pair. Local.

        Args:
            state: The pairs.
            increments: One for each constraint, in the order of pairs.
        """
        rows = np.arange(3) < state.rank[:, None]
        values = np.zeros(rows.shape)
        values[rows] = increments
        self.lambda_N[state.node] += values[:, 0]
        if self._tangential is not None:
            self._tangential.traction[state.node] += values[:, 1:]

    @property
    def restless(self) -> npt.NDArray[np.int64]:
        """Numbers of the nodes here that kept changing segment or state."""
        many = (self._moves >= _MOST_MOVES) | (self._flips >= _RESTLESS)
        ids: npt.NDArray[np.int64] = self.pair.nodes.node_ids[many]
        return ids

    def accepted(self, state: ContactState) -> ContactHistory:
        """What is to become the pair's history, from the last evaluation."""
        here, pair, old = self.neighbourhood, self.pair, self.pair.history
        node, n = state.node, len(self.segment)
        rows = self._evaluated
        key = np.full(n, -1, dtype=np.int64)
        found = self.segment >= 0
        key[found] = here.key[self.segment[found]]
        force, normal, traction = np.zeros((3, n, 3))
        force[node] = -state.force[:, :3]
        offset, energy, spring, dissipation = np.zeros((4, n))
        slip = old.slip.copy()
        if self._tangential is not None:
            t = self._tangential.traction[node]
            traction[node] = np.einsum("mi,mij->mj", t, rows.slip.frame)
            normal[node] = rows.slip.normal
            length = np.linalg.norm(rows.slip.value, axis=1)
            slip[node] += np.where(self.sliding[node], length, 0.0)
            dissipation[node] = rows.slip.work(t, (self.x - self.x_n)[state.dofs])
            spring = self._tangential.energy(traction)
            dissipation -= spring - self._tangential.energy(old.traction)
        if isinstance(pair.enforcement, Penalty):
            assert pair.eps_N is not None
            shift = self._offset(rows)
            gap = rows.gap - shift
            energy[node] = pair.enforcement.energy(gap, pair.eps_N[node])
            # An open node forgets; one still inside must not gain energy.
            offset[node] = np.where((gap >= 0) & (rows.gap >= 0), 0.0, shift)
        return ContactHistory(
            key=key,
            active=self.active.copy(),
            sliding=self.sliding,
            lambda_N=self.lambda_N.copy(),
            force=force,
            gap=self._gap.copy(),
            offset=offset,
            normal=normal,
            traction=traction,
            slip=slip,
            energy=energy + spring,
            dissipation=dissipation,
        )

    def work(self, state: ContactState, new: ContactHistory) -> ContactWork:
        """Energy given by the contact of the step, by cause.

        Args:
            state: The last evaluation.
            new: What `accepted` made of it.
        """
        old, node = self.pair.history, state.node
        rows = self._evaluated
        dx = (self.x - self.x_n)[state.dofs].reshape(rows.force[:, 0].shape)
        work = -self.lambda_N[node] * np.einsum("ij,ij->i", rows.force[:, 0], dx)
        law = self.pair.enforcement
        before = old.active[node]
        if isinstance(law, Penalty):
            # Only what the springs do not account for.
            assert self.pair.eps_N is not None
            offset, eps_N = self._offset(rows), self.pair.eps_N[node]
            at_n = law.energy(rows.gap_n - offset, eps_N)
            # A node that starts inside its spring brings energy with it.
            work += law.energy(rows.gap - offset, eps_N) - np.where(before, at_n, 0.0)
        same = old.key[node] == self.neighbourhood.key[state.segment]
        parts = np.array(
            [
                work[before & same].sum(),
                work[~before].sum(),
                work[before & ~same].sum() - self._lost_energy(node),
                old.energy.sum() - new.energy.sum(),
                -new.dissipation.sum(),
            ]
        )
        return ContactWork(*(float(part) for part in self.comm.allreduce(parts)))

    def _lost_energy(self, node: Ints) -> float:
        """Energy of normal springs at nodes that have no pair any more [J]."""
        if not isinstance(self.pair.enforcement, Penalty):
            return 0.0
        old = self.pair.history
        energy = old.energy.copy()
        if self._tangential is not None:
            energy -= self._tangential.energy(old.traction)
        energy[node] = 0.0
        return float(energy.sum())

    def _find_pairs(self, x: Floats, iteration: int) -> tuple[Ints, int]:
        """Nodes that may transmit force; how many changed their segment."""
        node = self._eligible
        previous = self.segment[node]
        free = node[self._moves[node] < _MOST_MOVES]
        self.segment[free], self._gap[free] = self.neighbourhood.pair(
            x, self.pair.nodes.nodes[free], self.segment[free], self.reach
        )
        segment = self.segment[node]
        if iteration:
            self._moves[node] += segment != previous
        near = segment >= 0
        if isinstance(self.pair.enforcement, LagrangeMultiplier) and not self._holds:
            # All others are open and stay inactive.
            near &= self.active[node] | (self._gap[node] < 0)
        lost = node[~near & self.active[node]]
        self._release(lost)
        moved = int(np.count_nonzero(segment[near] != previous[near]))
        return node[near], moved + len(lost)

    def _rows(self, x: Floats, node: Ints) -> Rows:
        """Kernels of nodes on their present segments."""
        here, segment, nodes = self.neighbourhood, self.segment[node], self.pair.nodes.nodes[node]
        dofs = here.dofs(nodes, segment)
        values = here.contact(self._scheme, self.x_n, x, nodes, segment)
        free = None if self._free is None else self._free[dofs].reshape(values[2].shape)
        rows = Rows(node, segment, dofs, free, values)
        if self.pair.is_convective:
            assert isinstance(here, Neighbourhood)
            rows.add_slip(ConvectiveSlip(here.convective_slip(self.x_n, x, nodes, segment)))
        elif self.pair.friction is not None:
            rows.add_slip(Slip(here.slip(self.x_n, x, nodes, segment)))
        self._gap[node] = rows.gap
        if isinstance(self.pair.enforcement, LagrangeMultiplier):
            rows.excess[:, 0] = rows.gap - (rows.gap_n if self._holds else 0.0)
        return rows

    def _offset(self, rows: Rows) -> Floats:
        """Gap at which springs start on the present segments.

        On a new segment it moves by the difference of the gaps at t_n, so
        that the energy of the spring is continuous; that of a node which
        was open on the old one starts where the node is.
        """
        old, node = self.pair.history, rows.node
        moved = (old.key[node] >= 0) & (old.key[node] != self.neighbourhood.key[rows.segment])
        before = np.where(old.active[node], old.gap[node], np.maximum(rows.gap_n, 0.0))
        offset: Floats = old.offset[node] + np.where(moved, rows.gap_n - before, 0.0)
        return offset

    def _push(self, rows: Rows) -> Floats:
        """Normal forces of springs; returns their derivatives by the gap."""
        assert isinstance(self.pair.enforcement, Penalty) and self.pair.eps_N is not None
        eps_N = self.pair.eps_N[rows.node]
        if self.pair.is_convective:
            # Half-way, as everything else in (60)-(64).
            nodes = self.pair.nodes.nodes[rows.node]
            gap = self.neighbourhood.gap((self.x_n + self.x) / 2, nodes, rows.segment)
            self.lambda_N[rows.node] = eps_N * np.minimum(gap, 0.0)
            self.active[rows.node] = gap < 0
            rows.gradients[:, 0] = rows.columns[:, 0]
            return np.where(gap < 0, eps_N / 2, 0.0)
        offset = self._offset(rows)
        lambda_N, slope = self.pair.enforcement.force(rows.gap_n - offset, rows.gap - offset, eps_N)
        self.lambda_N[rows.node] = lambda_N
        self.active[rows.node] = lambda_N < 0
        return slope

    def _balance(self, rows: Rows, R: Floats | None) -> None:
        """Multipliers that balance the residual at the nodes, if given; tractions with them."""
        node, active = rows.node, self.active[rows.node]
        if R is None:
            if self._tangential is not None:
                self._tangential.follow(rows, self.lambda_N[node], active)
            return
        rest, column = R, rows.columns[:, 0, :3]
        if self._tangential is not None:
            rest, column = self._tangential.reduced(rows, R, active)
        response = np.einsum("mi,mi->m", rows.normal, column)
        response = np.where(np.abs(response) > 1e-3, response, np.inf)
        lambda_N = -np.einsum("mi,mi->m", rows.normal, rest) / response
        if self._tangential is not None:
            lambda_N = self._tangential.balance(rows, rest, lambda_N, active)
        self.lambda_N[node] = np.where(active, lambda_N, 0.0)

    def _update_active(self, rows: Rows, iteration: int) -> int:
        """Active set of this iteration; returns how many nodes changed."""
        assert isinstance(self.pair.enforcement, LagrangeMultiplier)
        node, excess = rows.node, rows.excess[:, 0]
        before = self.active[node]
        if iteration == 0:
            after = before | (excess < 0)
        else:
            lambda_N, stiffness = self.lambda_N[node], self._stiffness[node]
            after = self.pair.enforcement.active(lambda_N, excess, stiffness)
            # Vertices of triangles of degree 2 carry nothing under a uniform
            # pressure: rounding must not decide again and again.
            rounding = _ROUNDING * stiffness * self.pair.segment_size
            nothing = np.maximum(np.abs(lambda_N), stiffness * np.abs(excess)) <= rounding
            after = np.where(nothing, before, after)
        ids = self.pair.nodes.node_ids[node]
        changes, violators = self._pivoting.select(after != before, ids, iteration)
        self.active[node] = before ^ changes
        self._flips[node] += changes
        self._release(node[~self.active[node]])
        if self._tangential is not None:
            self._tangential.arrive(node[changes & ~before])
        return violators

    def _release(self, node: Ints) -> None:
        self.active[node] = False
        self.lambda_N[node] = 0.0
        if self._tangential is not None:
            self._tangential.release(node)

    def _state(self, rows: Rows, slope: Floats, changed: int) -> ContactState:
        """Residual and tangent from the multipliers and tractions."""
        node, columns, gradients = rows.node, rows.columns, rows.gradients
        active = self.active[node]
        lambda_N = self.lambda_N[node]
        multiplier = isinstance(self.pair.enforcement, LagrangeMultiplier)
        rank = np.where(active, 1 if multiplier else 0, 0)
        force = lambda_N[:, None] * rows.force[:, 0]
        tangent = lambda_N[:, None, None] * rows.tangent
        if self._tangential is not None:
            rank = np.where(self._tangential.sticks(node, active), 3, rank)
            columns = self._tangential.add_to(rows, active, force, tangent)
        residual, free = force, rows.free
        if free is not None:
            residual = force * free
            tangent *= free[:, :, None] * free[:, None, :]
        if not multiplier:
            tangent += slope[:, None, None] * columns[:, 0, :, None] * gradients[:, 0, None, :]
        return ContactState(
            node=node,
            segment=rows.segment,
            dofs=rows.dofs,
            active=active,
            rank=rank.astype(np.int32),
            excess=rows.excess,
            gradients=gradients,
            columns=columns,
            residual=residual,
            tangent=tangent,
            normal=rows.normal,
            eliminable=rows.eliminable,
            force=force,
            changed=changed,
            failed=int(np.count_nonzero(~rows.valid & (active | np.isnan(rows.gap)))),
        )
