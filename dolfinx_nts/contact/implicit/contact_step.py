"""One attempt at a step of a contact pair: forces and tangents of its nodes.

A `ContactStep` never touches the pair. Evaluating it gives a
`ContactContribution`, from which residual and tangent are assembled. No PETSc here.
"""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.history import ContactHistory, ContactWork
from dolfinx_nts.contact.implicit.active_set import ActiveSet
from dolfinx_nts.contact.implicit.contributions import ContactContribution, PairKinematics
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.implicit.penalty import NormalSprings
from dolfinx_nts.contact.implicit.stick_slip import StickSlip
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.slip import ConvectiveSlip, Slip
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import SegmentCandidates
from dolfinx_nts.search.obstacle_candidates import ObstacleCandidates
from dolfinx_nts.search.self_contact import independent_nodes

__all__ = ["ContactStep", "contact_residual"]


_CLOSE = 0.01  # of a segment: gaps that are closed between Newton iterations
_RESTLESS = 4  # changes of state after which a node is named if the step fails


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
        pairing: Segments of the nodes.
        active: Active nodes of this rank, shape ``(n,)``.
        lambda_N: Normal multipliers, shape ``(n,)`` [N].
        num_active: Active pairs on all ranks.
        may_touch: Whether a node can become active, on any rank.
        touched: Whether one was, in any iteration.
        x: Positions of the nodes that the neighbourhood knows in the last
            evaluation, shape ``(l, 3)`` [m].
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
        nodes, history, law = pair.nodes.nodes, pair.history, pair.enforcement
        stiffness_there = stiffness[nodes]
        pair.derive_stiffness(stiffness)
        self.local_search = pairing = LocalSearch(pair, x_n, x_trial)
        self.x, candidates = pairing.x_n, pairing.candidates
        self._free = None if free is None else candidates.with_ghosts(free)
        if self._free is not None and _all_free(self._free, nodes, candidates):
            self._free = None

        # Elastic impact holds gaps; in statics there is no impact.
        exact = law if isinstance(law, LagrangeMultiplier) else None
        self._holds = exact is not None and exact.impact == "elastic" and scheme != "static"
        eligible = pairing.met >= 0
        if exact is not None and self._holds:
            size = candidates.size[pairing.met] if len(candidates.size) else np.ones(len(nodes))
            eligible &= exact.eligible(pairing.gap_n, pairing.gap_trial, size, history.active)
            may_touch = eligible
        else:
            # A gap that may close within the step.
            least = np.fmin(pairing.gap_n, pairing.gap_trial)
            may_touch = (least < pairing.way) | history.active
        if pair.touches_itself and exact is not None:
            assert isinstance(candidates, SegmentCandidates)
            urgency = 2 * history.active + (np.fmin(pairing.gap_n, pairing.gap_trial) < 0)
            eligible &= independent_nodes(candidates, pair.nodes, pairing.met, eligible, urgency)
        self.may_touch = reductions.anywhere(self.comm, bool(may_touch.any()))
        self._eligible = eligible.nonzero()[0].astype(np.int32)
        self.active = history.active & eligible
        self.lambda_N = np.where(self.active, history.lambda_N, 0.0)
        self.num_active, self.touched = 0, False
        self._flips = np.zeros(len(nodes), dtype=np.int32)
        self._set = self._springs = None
        if isinstance(law, LagrangeMultiplier):
            self._set = ActiveSet(pair, law, stiffness_there, self.comm)
        else:
            self._springs = NormalSprings(pair, law, pairing)
        self._friction = (
            None if pair.friction is None else StickSlip(pair, stiffness_there, self.comm)
        )

    @property
    def candidates(self) -> SegmentCandidates | ObstacleCandidates:
        """Segments in reach."""
        return self.local_search.candidates

    @property
    def sliding(self) -> Flags:
        """Active nodes that slide, shape ``(n,)``."""
        flags: Flags = self.active.copy()
        return flags if self._friction is None else flags & self._friction.sliding

    def evaluate(self, x: Floats, R_bulk: Floats | None, iteration: int) -> ContactContribution:
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
        x = self.x = self.candidates.with_ghosts(x)
        rows, changed = self._rows(x, iteration)
        self._evaluated = rows
        node, slope = rows.node, None
        if self._springs is not None:
            lambda_N, active, slope = self._springs.push(rows, x)
            changed += self._update_friction(rows, lambda_N, active, iteration)
        else:
            R = None if R_bulk is None else R_bulk[rows.dofs[:, 0]]
            lambda_N, active, changes = self._update_multipliers(rows, R, iteration)
            changed += changes
        self.active[node], self.lambda_N[node] = active, lambda_N
        num_active = int(np.count_nonzero(active))
        self.num_active = reductions.total(self.comm, num_active)
        self.touched |= self.num_active > 0
        if iteration == 0:
            # Without a previous iteration the set of active pairs is new.
            changed = num_active
        return self._state(rows, lambda_N, active, slope, changed)

    def settle(self) -> int:
        """Find the segments anew in the equilibrium of the last evaluation. Local.

        Returns:
            How many nodes got another: with any, it has to be found again.
        """
        return self.local_search.settle(self.x, self._eligible)

    def close_gaps(self, x: Floats, u: Floats) -> None:
        """Move nodes held by a normal multiplier alone to where it wants them.

        Along the normals of the last evaluation. Otherwise the linear system
        has to do so, which takes an action of the tangent. Collective.

        Args:
            x: Positions of the owned nodes, shape ``(n, 3)`` [m].
            u: Their displacements, shape ``(n, 3)`` [m], changed. They are
                known to more digits than positions.
        """
        if not self.num_active or self._set is None:
            return
        rows, candidates = self._evaluated, self.candidates
        held = self.active[rows.node] & ~rows.fixed
        if self._friction is not None:
            held &= ~self._friction.sticks(rows.node, held)
        nodes = rows.dofs[:, 0]
        gap = candidates.gap(candidates.with_ghosts(x), nodes, rows.segment)
        if self._holds:
            gap -= rows.gap_n
        # Nodes far from where the normals hold are left to the linear system.
        farthest = _CLOSE * self.pair.segment_size
        _kernels.close_gaps(nodes, held, gap, rows.normal, rows.gradients, farthest, u)

    def add_multipliers(self, state: ContactContribution, increments: Floats) -> None:
        """Add increments of the multipliers, pair by pair. Local.

        Args:
            state: The pairs.
            increments: One for each constraint, in the order of pairs.
        """
        rows = np.arange(3) < state.rank[:, None]
        values = np.zeros(rows.shape)
        values[rows] = increments
        self.lambda_N[state.node] += values[:, 0]
        if self._friction is not None:
            self._friction.traction[state.node] += values[:, 1:]

    @property
    def restless(self) -> GlobalInts:
        """Numbers of the nodes here that kept changing segment or state."""
        many = self.local_search.restless | (self._flips >= _RESTLESS)
        ids: GlobalInts = self.pair.nodes.node_ids[many]
        return ids

    def accepted(self, state: ContactContribution) -> ContactHistory:
        """What is to become the pair's history, from the last evaluation."""
        pairing, old = self.local_search, self.pair.history
        node, n = state.node, len(self.active)
        rows = self._evaluated
        key = np.full(n, -1, dtype=np.int64)
        found = pairing.segment >= 0
        key[found] = pairing.candidates.key[pairing.segment[found]]
        force, normal, traction = np.zeros((3, n, 3))
        force[node] = -state.force[:, :3]
        offset, energy, spring, dissipation = np.zeros((4, n))
        slip = old.slip.copy()
        if self._friction is not None:
            t = self._friction.traction[node]
            traction[node] = np.einsum("mi,mij->mj", t, rows.slip.frame)
            normal[node] = rows.slip.normal
            length = np.linalg.norm(rows.slip.value, axis=1)
            slip[node] += np.where(self.sliding[node], length, 0.0)
            dissipation[node] = rows.slip.work(t, (self.x - pairing.x_n)[state.dofs])
            spring = self._friction.energy(traction)
            dissipation -= spring - self._friction.energy(old.traction)
        if self._springs is not None:
            energy[node], offset[node] = self._springs.accepted(rows)
        return ContactHistory(
            key=key,
            active=self.active.copy(),
            sliding=self.sliding,
            lambda_N=self.lambda_N.copy(),
            force=force,
            gap=pairing.gap.copy(),
            offset=offset,
            normal=normal,
            traction=traction,
            slip=slip,
            energy=energy + spring,
            dissipation=dissipation,
        )

    def work(self, state: ContactContribution, new: ContactHistory) -> ContactWork:
        """Energy given by the contact of the step, by cause.

        Args:
            state: The last evaluation.
            new: What `accepted` made of it.
        """
        old, node = self.pair.history, state.node
        rows = self._evaluated
        dx = self.x.take(state.dofs, axis=0) - self.local_search.x_n.take(state.dofs, axis=0)
        F = rows.force[:, 0]
        work = -self.lambda_N[node] * (F * dx.reshape(F.shape)).sum(axis=1)
        before = old.active[node]
        if self._springs is not None:
            # Only what the springs do not account for.
            work += self._springs.stored(rows)
        same = old.key[node] == self.candidates.key[state.segment]
        parts = np.array(
            [
                work[before & same].sum(),
                work[~before].sum(),
                work[before & ~same].sum() - self._lost_energy(node),
                old.energy.sum() - new.energy.sum(),
                -new.dissipation.sum(),
            ]
        )
        return ContactWork(*reductions.total(self.comm, parts).tolist())

    def _lost_energy(self, node: Ints) -> float:
        """Energy of normal springs at nodes that have no pair any more [J]."""
        if self._springs is None:
            return 0.0
        old = self.pair.history
        energy = old.energy.copy()
        if self._friction is not None:
            energy -= self._friction.energy(old.traction)
        energy[node] = 0.0
        return float(energy.sum())

    def _rows(self, x: Floats, iteration: int) -> tuple[PairKinematics, int]:
        """Kernels of the nodes that may transmit force; how many moved or got lost."""
        candidates, node = self.local_search.candidates, self._eligible
        segment, moved = self.local_search.find(x, node, iteration)
        near, lost = segment >= 0, 0
        if self._set is not None and not self._holds:
            # All others are open and stay inactive.
            near &= self.active[node] | (self.local_search.gap[node] < 0)
        if not near.all():
            far = node[~near]
            lost = int(np.count_nonzero(self.active[far]))
            self._release(far)
            node, segment, moved = node[near], segment[near], moved[near]
        dofs = candidates.dofs(self.pair.nodes.nodes[node], segment)
        values = candidates.contact(self._scheme, self.local_search.x_n, x, dofs, segment)
        free = None if self._free is None else self._free[dofs].reshape(values[2].shape)
        rows = PairKinematics(node, segment, dofs, free, values)
        if self.pair.is_convective:
            assert isinstance(candidates, SegmentCandidates)
            slip = candidates.convective_slip(self.local_search.x_n, x, dofs, segment)
            rows.add_slip(ConvectiveSlip(slip))
        elif self.pair.friction is not None:
            rows.add_slip(Slip(candidates.slip(self.local_search.x_n, x, dofs, segment)))
        self.local_search.gap[node] = rows.gap
        if self._set is not None:
            rows.excess[:, 0] = rows.gap - rows.gap_n if self._holds else rows.gap
        return rows, int(np.count_nonzero(moved)) + lost

    def _update_multipliers(
        self, rows: PairKinematics, R: Floats | None, iteration: int
    ) -> tuple[Floats, Flags, int]:
        """Multipliers, active pairs, and how many do not fit."""
        assert self._set is not None
        node, tangential = rows.node, self._friction
        before, lambda_N = self.active[node], self.lambda_N[node]
        # Decisions follow from multipliers, multipliers from decisions.
        lambda_N = self._balance(rows, R, lambda_N, before)
        active, changes = self._set.update(rows, before, lambda_N, iteration)
        lambda_N = np.where(active, lambda_N, 0.0)
        if changes:
            self._flips[node] += active != before
        if tangential is not None:
            tangential.release(node[before & ~active])
            tangential.arrive(node[active & ~before])
            changes += self._update_friction(rows, lambda_N, active, iteration)
        if changes or tangential is not None:
            lambda_N = self._balance(rows, R, lambda_N, active)
        return lambda_N, active, changes

    def _balance(
        self, rows: PairKinematics, R: Floats | None, lambda_N: Floats, active: Flags
    ) -> Floats:
        """Multipliers that balance the residual at the nodes, if given; tractions with them."""
        tangential = self._friction
        if R is None:
            if tangential is not None:
                tangential.follow(rows, lambda_N, active)
            return lambda_N
        if tangential is None:
            lambda_N = _kernels.balance(rows.normal, R, rows.columns)
        else:
            rest, column = tangential.reduced(rows, R, active)
            lambda_N = _kernels.balance(rows.normal, rest, column[:, None])
            lambda_N = tangential.balance(rows, rest, lambda_N, active)
        return np.where(active, lambda_N, 0.0)

    def _update_friction(
        self, rows: PairKinematics, lambda_N: Floats, active: Flags, iteration: int
    ) -> int:
        """Decide on stick and slip; returns how many nodes do not fit."""
        if self._friction is None:
            return 0
        before = self._friction.sliding[rows.node]
        violators = self._friction.update(rows, -lambda_N, active, iteration)
        self._flips[rows.node] += before != self._friction.sliding[rows.node]
        return violators

    def _release(self, node: Ints) -> None:
        self.active[node] = False
        self.lambda_N[node] = 0.0
        if self._friction is not None:
            self._friction.release(node)

    def _state(
        self,
        rows: PairKinematics,
        lambda_N: Floats,
        active: Flags,
        slope: Floats | None,
        changed: int,
    ) -> ContactContribution:
        """Residual and tangent from the multipliers and tractions."""
        columns, gradients = rows.columns, rows.gradients
        force = lambda_N[:, None] * rows.force[:, 0]
        tangent = lambda_N[:, None, None] * rows.tangent
        rank = (active if slope is None else np.zeros_like(active)).astype(np.int32)
        if self._friction is not None:
            rank[self._friction.sticks(rows.node, active)] = 3
            columns = self._friction.add_to(rows, active, force, tangent)
        residual, free = force, rows.free
        if free is not None:
            residual = force * free
            tangent *= free[:, :, None] * free[:, None, :]
        if slope is not None:
            tangent += slope[:, None, None] * columns[:, 0, :, None] * gradients[:, 0, None, :]
        return ContactContribution(
            node=rows.node,
            segment=rows.segment,
            dofs=rows.dofs,
            active=active,
            rank=rank,
            excess=rows.excess,
            gradients=gradients,
            columns=columns,
            residual=residual,
            tangent=tangent,
            normal=rows.normal,
            fixed=rows.fixed,
            force=force,
            changed=changed,
            failed=_failures(rows, active),
        )


def _failures(rows: PairKinematics, active: Flags) -> int:
    """Pairs that cannot be evaluated where they transmit force or have no gap. Local."""
    if rows.valid.all():
        return 0
    return int(np.count_nonzero(~rows.valid & (active | np.isnan(rows.gap))))


def _all_free(
    free: Floats, nodes: Ints, candidates: SegmentCandidates | ObstacleCandidates
) -> bool:
    """Whether pairs have no given displacements. Local."""
    there = isinstance(candidates, ObstacleCandidates) or free[candidates.segments].all()
    return bool(there and free[nodes].all())


def contact_residual(
    steps: Sequence[ContactStep], states: Sequence[ContactContribution], num_owned: int
) -> Floats:
    """Sum of lambda_N F on the owned dofs, shape (num_owned,) [N]. Collective."""
    total: Floats = np.zeros((num_owned // 3, 3))
    for step, state in zip(steps, states, strict=True):
        if step.num_active:
            forces = state.residual.reshape(*state.dofs.shape, 3)
            step.candidates.add_to_owners(total, state.dofs, forces)
    return total.ravel()
