"""One attempt at a step of a contact pair: pairing, forces, active set.

A `ContactStep` never touches the pair. Evaluating it gives a
`ContactState`, from which residual and tangent are assembled. No PETSc here.
"""

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_nts.contact import ContactHistory, ContactPair, ContactWork
from dolfinx_nts.contact_rows import ContactState, Rows
from dolfinx_nts.enforcement import LagrangeMultiplier, Penalty
from dolfinx_nts.friction import transport
from dolfinx_nts.obstacles import ObstacleNeighbourhood
from dolfinx_nts.search import Neighbourhood

__all__ = ["ContactStep"]

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int32]

_MOST_MOVES = 2  # a node that changed its segment this often keeps it
_RESTLESS = 4  # changes of state after which a node is named if the step fails
_PATIENCE = 3  # iterations without fewer changes until one node changes at a time


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
        sliding: Active nodes that slide, shape ``(n,)``.
        lambda_N: Normal multipliers, shape ``(n,)`` [N].
        traction: Tractions in the frames of the segments at t_n, shape
            ``(n, 2)`` [N].
        num_active: Active pairs on all ranks.
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
        pair.fix_stiffness(self._stiffness)

        step = np.linalg.norm(x_trial - x_n, axis=1).max(initial=0.0)
        step = self.comm.allreduce(step, op=MPI.MAX)
        # Both surfaces may move, Newton iterates overshoot, and a node up
        # to half a segment deep still belongs to its segment.
        self._reach = 3 * step + 0.5 * pair.segment_size
        here: Neighbourhood | ObstacleNeighbourhood
        here, _ = pair.search.update(x_n, self._reach)
        self.neighbourhood = here
        self._free = None if free is None else here.with_ghosts(free)
        self._x_n = self._x = here.with_ghosts(x_n[: here.index_map.size_local])
        trial = here.with_ghosts(x_trial[: here.index_map.size_local])

        at_n = here.pair(self._x_n, nodes, here.find(history.key), self._reach)
        at_trial = here.pair(trial, nodes, at_n[0], self._reach)
        # The gap at t_n counts on the segment that the trial state meets.
        segment = np.where(at_trial[0] >= 0, at_trial[0], at_n[0])
        gap_n = at_n[1].copy()
        moved = np.flatnonzero((segment >= 0) & (segment != at_n[0])).astype(np.int32)
        gap_n[moved] = here.gap(self._x_n, nodes[moved], segment[moved])
        eligible = segment >= 0
        if isinstance(law, LagrangeMultiplier) and self._holds:
            size = here.size[segment] if len(here.size) else np.ones(len(nodes))
            eligible &= law.eligible(gap_n, at_trial[1], size, history.active)
        self._eligible = np.flatnonzero(eligible).astype(np.int32)
        self._segment: Ints = at_n[0]
        self._gap: Floats = at_n[1]
        self._moves, self._flips = np.zeros((2, len(nodes)), dtype=np.int32)
        self.num_active = 0
        self._fewest: float = np.inf
        self._patience = _PATIENCE
        self.active = history.active & eligible
        # A node that arrives slides until it is found to stick.
        self.sliding = history.sliding | ~history.active
        self.lambda_N = np.where(self.active, history.lambda_N, 0.0)
        n = len(nodes)
        self.traction = np.zeros((n, 2))
        # Model of the traction and slip of the last iteration.
        self._explicit, self._direction, self._slip = np.zeros((3, n, 2))
        self._turn_stiffness = np.zeros((n, 2, 2))

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
        x = self._x = self.neighbourhood.with_ghosts(x)
        node, changed = self._find_pairs(x, iteration)
        rows = self._rows(x, node)
        slope: Floats = np.zeros(len(node))
        R = None if R_bulk is None else R_bulk[rows.dofs[:, 0]]
        if isinstance(self.pair.enforcement, Penalty):
            slope = self._push(rows)
            changed += self._rub(rows, iteration)
        else:
            # Decisions follow from multipliers, multipliers from decisions.
            self._balance(rows, R)
            changed += self._update_active(rows, iteration) + self._rub(rows, iteration)
            self._balance(rows, R)
        active = self.active[node]
        self.num_active = self.comm.allreduce(int(np.count_nonzero(active)))
        if iteration == 0:
            # Without a previous iteration the set of active pairs is new.
            changed = int(np.count_nonzero(active))
        return self._state(rows, slope, changed)

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
        self.traction[state.node] += values[:, 1:]

    @property
    def restless(self) -> npt.NDArray[np.int64]:
        """Numbers of the nodes here that kept changing segment or state."""
        many = (self._moves >= _MOST_MOVES) | (self._flips >= _RESTLESS)
        ids: npt.NDArray[np.int64] = self.pair.nodes.node_ids[many]
        return ids

    def accepted(self, state: ContactState) -> ContactHistory:
        """What is to become the pair's history, from the last evaluation."""
        here, pair, old = self.neighbourhood, self.pair, self.pair.history
        node, n = state.node, len(self._segment)
        rows = self._rows(self._x, node)
        key = np.full(n, -1, dtype=np.int64)
        found = self._segment >= 0
        key[found] = here.key[self._segment[found]]
        force, normal, traction = np.zeros((3, n, 3))
        force[node] = -state.force[:, :3]
        offset, energy, dissipation = np.zeros((3, n))
        slip = old.slip.copy()
        spring = np.zeros(n)
        if pair.friction is not None:
            t = self.traction[node]
            traction[node] = np.einsum("mi,mij->mj", t, rows.slip.frame)
            normal[node] = rows.slip.normal
            length = np.linalg.norm(rows.slip.value, axis=1)
            slip[node] += np.where(self.active[node] & self.sliding[node], length, 0.0)
            dissipation[node] = np.einsum("mi,mi->m", t, rows.slip.value)
            if pair.has_slip_spring:
                assert pair.eps_T is not None
                spring = np.einsum("ni,ni->n", traction, traction) / (2 * pair.eps_T)
                stored = np.einsum("ni,ni->n", old.traction, old.traction) / (2 * pair.eps_T)
                dissipation -= spring - stored
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
            sliding=self.active & self.sliding,
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
        rows = self._rows(self._x, node)
        dx = (self._x - self._x_n)[state.dofs].reshape(rows.force[:, 0].shape)
        work = -self.lambda_N[node] * np.einsum("ij,ij->i", rows.force[:, 0], dx)
        if isinstance(self.pair.enforcement, Penalty):
            work[:] = 0.0
        before = old.active[node]
        same = old.key[node] == self.neighbourhood.key[state.segment]
        parts = np.array(
            [
                work[before & same].sum(),
                work[~before].sum(),
                work[before & ~same].sum(),
                old.energy.sum() - new.energy.sum(),
                -new.dissipation.sum(),
            ]
        )
        return ContactWork(*(float(part) for part in self.comm.allreduce(parts)))

    def _find_pairs(self, x: Floats, iteration: int) -> tuple[Ints, int]:
        """Nodes that may transmit force; how many changed their segment."""
        node = self._eligible
        previous = self._segment[node]
        free = node[self._moves[node] < _MOST_MOVES]
        self._segment[free], self._gap[free] = self.neighbourhood.pair(
            x, self.pair.nodes.nodes[free], self._segment[free], self._reach
        )
        segment = self._segment[node]
        if iteration:
            self._moves[node] += segment != previous
        near = segment >= 0
        if isinstance(self.pair.enforcement, LagrangeMultiplier) and not self._holds:
            # All others are open and stay inactive.
            near &= self.active[node] | (self._gap[node] < 0)
        lost = node[~near & self.active[node]]
        self.active[lost] = False
        self.lambda_N[lost] = 0.0
        self.traction[lost] = 0.0
        moved = int(np.count_nonzero(segment[near] != previous[near]))
        return node[near], moved + len(lost)

    def _rows(self, x: Floats, node: Ints) -> Rows:
        """Kernels of nodes on their present segments."""
        here, segment, nodes = self.neighbourhood, self._segment[node], self.pair.nodes.nodes[node]
        dofs = here.dofs(nodes, segment)
        values = here.contact(self._scheme, self._x_n, x, nodes, segment)
        free = np.ones((*dofs.shape, 3)) if self._free is None else self._free[dofs]
        rows = Rows(node, segment, dofs, free.reshape(values[2].shape), values)
        if self.pair.friction is not None:
            rows.add_slip(here.slip(self._x_n, x, nodes, segment))
        self._gap[node] = rows.gap
        if isinstance(self.pair.enforcement, LagrangeMultiplier):
            rows.excess[:, 0] = rows.gap - (rows.gap_n if self._holds else 0.0)
        return rows

    def _offset(self, rows: Rows) -> Floats:
        """Gap at which springs start on the present segments.

        On a new segment it moves by the difference of the gaps at t_n, so
        that the energy of the spring is continuous.
        """
        old = self.pair.history
        moved = old.active[rows.node] & (old.key[rows.node] != self.neighbourhood.key[rows.segment])
        shift = np.where(moved, rows.gap_n - old.gap[rows.node], 0.0)
        offset: Floats = old.offset[rows.node] + shift
        return offset

    def _push(self, rows: Rows) -> Floats:
        """Normal forces of springs; returns their derivatives by the gap."""
        assert isinstance(self.pair.enforcement, Penalty) and self.pair.eps_N is not None
        offset = self._offset(rows)
        eps_N = self.pair.eps_N[rows.node]
        lambda_N, slope = self.pair.enforcement.force(rows.gap_n - offset, rows.gap - offset, eps_N)
        self.lambda_N[rows.node] = lambda_N
        self.active[rows.node] = lambda_N < 0
        return slope

    def _rub(self, rows: Rows, iteration: int) -> int:
        """Stick or slip and the model of the traction; returns changes."""
        friction, node = self.pair.friction, rows.node
        if friction is None:
            return 0
        p, slip = -self.lambda_N[node], rows.slip.value
        if self.pair.has_slip_spring:
            assert self.pair.eps_T is not None
            old = self.pair.history
            t_n = transport(
                old.traction[node], old.normal[node], rows.slip.frame_n, rows.slip.normal_n
            )
            model = friction.spring(t_n, slip, p, self.pair.eps_T[node])
            sliding = model.sliding
        elif iteration == 0:
            # Multipliers of the starting guess mean nothing yet.
            model = friction.exact(np.zeros_like(slip), slip, np.zeros_like(p), self._weight(node))
            sliding = self.sliding[node]
        else:
            model = friction.exact(self.traction[node], slip, p, self._weight(node))
            sliding = model.sliding
        flips = self.active[node] & (sliding != self.sliding[node])
        self._flips[node] += flips
        self.sliding[node] = sliding
        self._slip[node] = slip
        self._explicit[node] = model.explicit
        self._direction[node] = model.direction
        self._turn_stiffness[node] = model.stiffness
        self.traction[node] = np.where(
            (sliding | self.pair.has_slip_spring)[:, None],
            model.explicit + p[:, None] * model.direction,
            self.traction[node],
        )
        self.traction[node[~self.active[node]]] = 0.0
        return int(np.count_nonzero(flips))

    def _weight(self, node: Ints) -> Floats:
        return self._stiffness[node]

    def _sticks(self, node: Ints) -> Flags:
        """Active nodes held by multipliers in the tangent plane."""
        exact = self.pair.friction is not None and not self.pair.has_slip_spring
        flags: Flags = self.active[node] & ~self.sliding[node] & exact
        return flags

    def _balance(self, rows: Rows, R: Floats | None) -> None:
        """Multipliers that balance the residual at the nodes."""
        if R is None:
            return
        node, active = rows.node, self.active[rows.node]
        rest: Floats = R
        if self.pair.friction is None:
            column = rows.columns[:, 0, :3]
        else:
            tangential = rows.columns[:, 1:, :3]
            direction: Floats = self._direction[node]
            explicit: Floats = self._explicit[node]
            if not self.pair.has_slip_spring:
                turned = rows.slip.value - self._slip[node]
                explicit = explicit + np.einsum("mij,mj->mi", self._turn_stiffness[node], turned)
            stick = self._sticks(node) & rows.eliminable
            explicit = np.where(stick[:, None], 0.0, explicit)
            rest = R + np.einsum("mi,mij->mj", explicit, tangential)
            column = rows.columns[:, 0, :3] - np.einsum("mi,mij->mj", direction, tangential)
        response = np.einsum("mi,mi->m", rows.normal, column)
        response = np.where(np.abs(response) > 1e-3, response, np.inf)
        lambda_N = -np.einsum("mi,mi->m", rows.normal, rest) / response
        if self.pair.friction is not None:
            traction: Floats = explicit - lambda_N[:, None] * direction
            A = rows.columns[stick, :, :3].transpose(0, 2, 1)
            solution = np.linalg.solve(A, -rest[stick][:, :, None])[:, :, 0]
            lambda_N[stick], traction[stick] = solution[:, 0], solution[:, 1:]
            self.traction[node] = np.where(active[:, None], traction, 0.0)
        self.lambda_N[node] = np.where(active, lambda_N, 0.0)

    def _update_active(self, rows: Rows, iteration: int) -> int:
        """Active set of this iteration; returns how many nodes changed."""
        assert isinstance(self.pair.enforcement, LagrangeMultiplier)
        node, excess = rows.node, rows.excess[:, 0]
        before = self.active[node]
        if iteration == 0:
            after = before | (excess < 0)
        else:
            after = self.pair.enforcement.active(self.lambda_N[node], excess, self._weight(node))
        changes = after != before
        # Block pivoting (Judice, Pires 1994): all violators change while
        # they become fewer; Murty's rule, only the lowest, ends cycles.
        count = self.comm.allreduce(int(np.count_nonzero(changes)))
        if count < self._fewest:
            self._fewest, self._patience = count, _PATIENCE
        elif count and self._patience:
            self._patience -= 1
        elif count:
            ids = self.pair.nodes.node_ids[node]
            last = np.iinfo(np.int64).max
            lowest = ids[changes].min(initial=last)
            changes &= ids == self.comm.allreduce(lowest, op=MPI.MIN)
        self.active[node] = before ^ changes
        self._flips[node] += changes
        released = node[~self.active[node]]
        self.lambda_N[released] = 0.0
        self.traction[released] = 0.0
        self.sliding[node[changes & ~before]] = True
        return int(np.count_nonzero(changes))

    def _state(self, rows: Rows, slope: Floats, changed: int) -> ContactState:
        """Residual and tangent from the multipliers and tractions."""
        node, columns, gradients = rows.node, rows.columns, rows.gradients
        active = self.active[node]
        lambda_N, multiplier = (
            self.lambda_N[node],
            isinstance(self.pair.enforcement, LagrangeMultiplier),
        )
        rank = np.where(active, 1 if multiplier else 0, 0)
        force = lambda_N[:, None] * rows.force[:, 0]
        tangent = lambda_N[:, None, None] * rows.tangent
        if self.pair.friction is not None:
            t, direction = self.traction[node], self._direction[node]
            stick = self._sticks(node)
            rank = np.where(stick, 3, rank)
            force += np.einsum("mi,mij->mj", t, rows.force[:, 1:])
            tangent += rows.slip.hessian(t) / 2
            model = np.where((active & ~stick)[:, None, None], self._turn_stiffness[node], 0.0)
            tangent += np.einsum(
                "mia,mij,mjb->mab", rows.force[:, 1:], model, rows.slip.gradient, optimize=True
            )
            slides = np.where((active & ~stick)[:, None], direction, 0.0)
            columns = columns.copy()
            columns[:, 0] -= np.einsum("mi,mij->mj", slides, columns[:, 1:])
        free = rows.free
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
            residual=force * free,
            tangent=tangent,
            normal=rows.normal,
            eliminable=rows.eliminable,
            force=force,
            changed=changed,
            failed=int(np.count_nonzero(active & ~rows.valid)),
        )
