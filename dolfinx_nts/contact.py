"""Contact of one pair of surfaces: local search, kernels, active set.

The pair keeps what has been accepted; a `ContactStep` works on one attempt
at a step and never touches the pair; evaluating it gives a `ContactState`,
the arrays from which residual and tangent are assembled. No PETSc here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_nts import _kernels
from dolfinx_nts.enforcement import LagrangeMultiplier
from dolfinx_nts.search import Neighbourhood, Search
from dolfinx_nts.surfaces import Surface

__all__ = ["ContactHistory", "ContactPair", "ContactState", "ContactStep", "ContactWork"]

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int32]
GlobalInts = npt.NDArray[np.int64]

# Contact kernel of a scheme: (x_pair_n, x_pair, orientation) -> arrays.
Kernel = Callable[[Floats, Floats, Floats], tuple[npt.NDArray[Any], ...]]

_LAST_PAIRING = 12  # from this iteration on, nodes keep their segment
_LEAST_INDEX = 8  # from this iteration on, one node changes at a time
_TOUCHING = 1e-3  # excess gap, relative to the segment, of a node still active


@dataclass(frozen=True)
class ContactHistory:
    """Accepted contact of the owned nodes of a pair at t_n.

    Attributes:
        key: Segment of each node, -1 without, shape ``(n,)``.
        active: Whether the node transmits force, shape ``(n,)``.
        lambda_N: Multiplier of the last step, shape ``(n,)`` [N, <= 0].
        force: Contact force on the node in it, shape ``(n, 3)`` [N].
    """

    key: GlobalInts
    active: Flags
    lambda_N: Floats
    force: Floats


@dataclass(frozen=True)
class ContactWork:
    """Energy that contact gave to the bodies in a step, by cause [J].

    Attributes:
        persistent: Nodes that were active on the same segment before.
        activation: Nodes that were not active before.
        facet_change: Nodes that were active on another segment.
    """

    persistent: float
    activation: float
    facet_change: float

    @classmethod
    def zero(cls) -> "ContactWork":
        """No work."""
        return cls(0.0, 0.0, 0.0)

    def __add__(self, other: "ContactWork") -> "ContactWork":
        """Sum by cause."""
        return ContactWork(
            self.persistent + other.persistent,
            self.activation + other.activation,
            self.facet_change + other.facet_change,
        )


@dataclass(frozen=True)
class ContactState:
    """Pairs that may transmit force, evaluated between x_n and x.

    Attributes:
        node: Position in the surface's nodes, shape ``(m,)``.
        segment: Segment in the neighbourhood, shape ``(m,)``.
        dofs: Nodes of the pair in the neighbourhood's index map, shape
            ``(m, 1+k)``.
        gap: Gap at x [m].
        excess: Gap minus its reference [m].
        force: Contact force per multiplier, shape ``(m, 3(1+k))``.
        free_force: The same, 0 where the displacement is given.
        gradient: Gradient of the gap at x, shape ``(m, 3(1+k))``, 0 where
            the displacement is given.
        tangent: Derivative of ``force``, shape ``(m, 3(1+k), 3(1+k))``,
            rows and columns 0 where the displacement is given.
        normal: Free part of the node's normal, unit, shape ``(m, 3)``.
        free_normal: Whether most of the normal is free, shape ``(m,)``.
        active: Whether the pair transmits force, shape ``(m,)``.
        lambda_N: Multiplier, 0 where inactive, shape ``(m,)`` [N].
        changed: Pairs that became active, inactive or changed segment.
        failed: Pairs that could not be evaluated, or whose normal has
            turned by more than 90 degrees.
    """

    node: Ints
    segment: Ints
    dofs: Ints
    gap: Floats
    excess: Floats
    force: Floats
    free_force: Floats
    gradient: Floats
    tangent: Floats
    normal: Floats
    free_normal: Flags
    active: Flags
    lambda_N: Floats
    changed: int
    failed: int

    def nodal_forces(self, num_nodes: int) -> Floats:
        """Sum of lambda_N free_force on the index map's nodes [N]."""
        forces = np.zeros((num_nodes, 3))
        values = self.lambda_N[:, None] * self.free_force
        np.add.at(forces, self.dofs.ravel(), values.reshape(-1, 3))
        return forces


class ContactPair:
    """Nodes of one surface against segments of another.

    Collective.

    Args:
        nodes: Surface whose nodes may touch.
        segments: Surface whose segments are touched.
        enforcement: How contact is enforced; by default multipliers
            with elastic impact.

    Attributes:
        history: Accepted contact.

    Raises:
        TypeError: An argument has the wrong type.
        ValueError: The surfaces belong to different spaces, or share
            nodes.
    """

    def __init__(
        self,
        nodes: Surface,
        segments: Surface,
        enforcement: LagrangeMultiplier | None = None,
    ) -> None:
        """Check the surfaces and start without contact."""
        for name, surface in (("nodes", nodes), ("segments", segments)):
            if not isinstance(surface, Surface):
                raise TypeError(f"expected a Surface as {name}, given {type(surface).__name__}")
        enforcement = LagrangeMultiplier() if enforcement is None else enforcement
        if not isinstance(enforcement, LagrangeMultiplier):
            raise TypeError(
                f"expected LagrangeMultiplier as enforcement, given {type(enforcement).__name__}"
            )
        if nodes.V != segments.V:
            raise ValueError("expected nodes and segments in one function space, given two")
        shared = nodes.V.mesh.comm.allreduce(len(np.intersect1d(nodes.nodes, segments.nodes)))
        if shared:
            raise ValueError(
                "expected surfaces without common nodes in a contact pair, "
                f"given {shared} nodes on both sides"
            )
        self.nodes, self.segments, self.enforcement = nodes, segments, enforcement
        self.search = Search(nodes, segments)
        n = len(nodes.nodes)
        self.history = ContactHistory(
            key=np.full(n, -1, dtype=np.int64),
            active=np.zeros(n, dtype=bool),
            lambda_N=np.zeros(n),
            force=np.zeros((n, 3)),
        )

    @property
    def pressure(self) -> Floats:
        """Contact pressure of the last step at the nodes, ``(n,)`` [Pa]."""
        return -self.history.lambda_N / self.nodes.area

    def gap(self, x: Floats) -> Floats:
        """Gap of every node, NaN where it faces no segment. Collective.

        Args:
            x: Positions of the local nodes of the space, owned and
                ghost, shape ``(l, 3)`` [m].

        Returns:
            Gap, shape ``(n,)`` [m], > 0 open.
        """
        everywhere, _ = Search(self.nodes, self.segments).update(x, np.inf)
        found = _pair_nodes(
            everywhere,
            everywhere.with_ghosts(x[: everywhere.index_map.size_local]),
            self.nodes.nodes,
            everywhere.find(self.history.key),
            np.inf,
        )
        return found[2]


class ContactStep:
    """One attempt at a step; collective, as all its methods.

    Args:
        pair: The contact pair.
        kernel: Contact kernel of the scheme.
        x_n: Accepted positions of the local nodes of the space, owned
            and ghost, shape ``(l, 3)`` [m].
        x_trial: The same for the ballistic state x_n + h v_n.
        stiffness: Weight of the gap in the active-set test at each
            owned node of the space, shape ``(n,)`` [N/m].
        free: 1 where the displacement of an owned node is unknown, 0
            where it is given, shape ``(n, 3)``; None if all are unknown.

    Attributes:
        pair: The contact pair.
        neighbourhood: Segments in reach.
        active: Active nodes of this rank, shape ``(n,)``.
        lambda_N: Their multipliers, shape ``(n,)`` [N].
        num_active: Active pairs on all ranks.
    """

    def __init__(
        self,
        pair: ContactPair,
        kernel: Kernel,
        x_n: Floats,
        x_trial: Floats,
        stiffness: Floats,
        free: Floats | None = None,
    ) -> None:
        """Find the segments in reach and the nodes that may touch."""
        self.pair, self._kernel = pair, kernel
        self._stiffness = stiffness[pair.nodes.nodes]
        self.comm: MPI.Comm = pair.nodes.V.mesh.comm
        history = pair.history

        step = np.linalg.norm(x_trial - x_n, axis=1).max(initial=0.0)
        step = self.comm.allreduce(step, op=MPI.MAX)
        # Both surfaces may move, Newton iterates overshoot, and a node up
        # to half a segment deep still belongs to its segment.
        self._reach = 3 * step + 0.5 * pair.segments.size
        self.neighbourhood, _ = pair.search.update(x_n, self._reach)
        here = self.neighbourhood
        self._x_n = self._x = here.with_ghosts(x_n[: here.index_map.size_local])
        trial = here.with_ghosts(x_trial[: here.index_map.size_local])

        nodes = pair.nodes.nodes
        at_n = _pair_nodes(here, self._x_n, nodes, here.find(history.key), self._reach)
        at_trial = _pair_nodes(here, trial, nodes, at_n[0], self._reach)
        # The gap at t_n counts on the segment that the trial state meets.
        segment = np.where(at_trial[0] >= 0, at_trial[0], at_n[0])
        gap_n = at_n[2].copy()
        moved = np.flatnonzero((segment >= 0) & (segment != at_n[0])).astype(np.int32)
        gap_n[moved] = _kernels.project(*self._pairs(self._x_n, moved, segment[moved]))[1]
        size = here.size[segment] if len(here.size) else np.ones(len(nodes))
        eligible = pair.enforcement.eligible(gap_n, at_trial[2], size, history.active)
        self._eligible = np.flatnonzero(eligible & (segment >= 0)).astype(np.int32)
        self._segment, self._gap = at_n[0], at_n[2]
        self._free = None if free is None else here.with_ghosts(free)
        self.num_active = 0
        self.active = history.active & eligible
        self.lambda_N = np.where(self.active, history.lambda_N, 0.0)

    def evaluate(self, x: Floats, R_bulk: Floats | None, iteration: int) -> ContactState:
        """Pair, evaluate the kernel, update multipliers and active set.

        Args:
            x: Positions of the owned nodes, shape ``(n, 3)`` [m].
            R_bulk: Residual without contact at the owned nodes, shape
                ``(n, 3)`` [N]: the multipliers balance its normal part
                at the nodes. None: they stay as they are.
            iteration: Number of the Newton iteration, from 0.

        Returns:
            The pairs that may transmit force.
        """
        here, enforcement = self.neighbourhood, self.pair.enforcement
        x = self._x = here.with_ghosts(x)
        node = self._eligible
        previous = self._segment[node]
        if iteration < _LAST_PAIRING:
            nodes = self.pair.nodes.nodes[node]
            self._segment[node], _, self._gap[node], _ = _pair_nodes(
                here, x, nodes, previous, self._reach
            )
        segment = self._segment[node]
        if enforcement.impact == "plastic":
            # All others are open and stay inactive.
            near = self.active[node] | (self._gap[node] < 0)
        else:
            near = np.ones(len(node), dtype=bool)
        near &= segment >= 0
        lost = node[~near & self.active[node]]
        self.active[lost] = False
        self.lambda_N[lost] = 0.0
        moved = int(np.count_nonzero(segment[near] != previous[near]))
        node, segment = node[near], segment[near]

        x_pair_n, orientation = self._pairs(self._x_n, node, segment)
        x_pair, _ = self._pairs(x, node, segment)
        gap_n, gap, force, gradient, tangent, turn, status = self._kernel(
            x_pair_n, x_pair, orientation
        )
        self._gap[node] = gap
        excess = gap - enforcement.reference(gap_n)
        dofs = np.column_stack([self.pair.nodes.nodes[node], here.segments[segment]])
        free_force = force
        if self._free is not None:
            free = self._free[dofs].reshape(force.shape)
            free_force, gradient = force * free, gradient * free
            tangent = tangent * free[:, :, None] * free[:, None, :]
        normal = gradient[:, :3]
        length = np.linalg.norm(normal, axis=1)
        normal = normal / np.where(length > 0, length, 1.0)[:, None]

        if R_bulk is not None:
            balance = np.einsum("ij,ij->i", normal, R_bulk[dofs[:, 0]])
            response = np.einsum("ij,ij->i", normal, free_force[:, :3])
            balanced = -balance / np.where(response > 0, response, 1.0)
            self.lambda_N[node] = np.where(self.active[node], balanced, 0.0)
        flipped = self._update_active(node, excess, here.size[segment], iteration)
        active = self.active[node]
        if R_bulk is not None:
            self.lambda_N[node] = np.where(active, balanced, 0.0)
        self.num_active = self.comm.allreduce(int(np.count_nonzero(active)))
        changed = moved + flipped + len(lost)
        if iteration == 0:
            # Without a previous iteration the set of active pairs is new.
            changed = int(np.count_nonzero(active))
        return ContactState(
            node=node,
            segment=segment,
            dofs=dofs,
            gap=gap,
            excess=excess,
            force=force,
            free_force=free_force,
            gradient=gradient,
            tangent=tangent,
            normal=normal,
            free_normal=length > 0.5,
            active=active,
            lambda_N=self.lambda_N[node],
            changed=changed,
            failed=int(np.count_nonzero(active & ((status != 0) | (turn < 0)))),
        )

    def accepted(self, state: ContactState) -> ContactHistory:
        """What is to become the pair's history, from the last evaluation."""
        here = self.neighbourhood
        key = np.full(len(self._segment), -1, dtype=np.int64)
        found = self._segment >= 0
        key[found] = here.key[self._segment[found]]
        force = np.zeros((len(key), 3))
        force[state.node] = -state.lambda_N[:, None] * state.force[:, :3]
        return ContactHistory(key, self.active.copy(), self.lambda_N.copy(), force)

    def work(self, state: ContactState) -> ContactWork:
        """Energy given by the contact forces of the step, by cause."""
        history, active = self.pair.history, state.active
        node, segment = state.node[active], state.segment[active]
        x_n, _ = self._pairs(self._x_n, node, segment)
        x, _ = self._pairs(self._x, node, segment)
        dx = (x - x_n).reshape(state.force[active].shape)
        work = -state.lambda_N[active] * np.einsum("ij,ij->i", state.force[active], dx)
        old = history.active[node]
        same = history.key[node] == self.neighbourhood.key[segment]
        parts = np.array([work[old & same].sum(), work[~old].sum(), work[old & ~same].sum()])
        return ContactWork(*(float(part) for part in self.comm.allreduce(parts)))

    def _pairs(self, x: Floats, node: Ints, segment: Ints) -> tuple[Floats, Floats]:
        """Coordinates (m, 1+k, 3) and orientations of pairs."""
        here = self.neighbourhood
        dofs = np.column_stack([self.pair.nodes.nodes[node], here.segments[segment]])
        return x[dofs], here.orientation[segment]

    def _update_active(self, node: Ints, excess: Floats, size: Floats, iteration: int) -> int:
        """Active set of this iteration; returns how many nodes changed."""
        before = self.active[node]
        if iteration == 0:
            after = (excess < 0) | (before & (excess < _TOUCHING * size))
        else:
            stiffness = self._stiffness[node]
            after = self.pair.enforcement.active(self.lambda_N[node], excess, stiffness)
        changes = after != before
        if iteration >= _LEAST_INDEX:
            # Murty's rule ends cycles: only the lowest violator changes.
            ids = self.pair.nodes.node_ids[node]
            last = np.iinfo(np.int64).max
            lowest = ids[changes].min(initial=last)
            changes &= ids == self.comm.allreduce(lowest, op=MPI.MIN)
        self.active[node] = before ^ changes
        self.lambda_N[node] = np.where(self.active[node], self.lambda_N[node], 0.0)
        return int(np.count_nonzero(changes))


def _pair_nodes(
    here: Neighbourhood, x: Floats, nodes: Ints, current: Ints, reach: float
) -> tuple[Ints, Floats, Floats, Floats]:
    """Segment, xi, gap and normal of nodes at positions x."""
    return _kernels.pair_nodes(
        x[nodes], current, reach, x[here.segments], here.orientation, here.key
    )
