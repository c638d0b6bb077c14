"""Contact by springs, evaluated at one state: for explicit steps.

The force is minus the gradient of the springs' energy at that state, so
that every evaluation leaves both momenta alone. Nothing is iterated.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_nts.archive import Archive
from dolfinx_nts.contact import ContactPair
from dolfinx_nts.contact_history import ContactHistory, ContactWork
from dolfinx_nts.enforcement import Penalty
from dolfinx_nts.friction import transport
from dolfinx_nts.obstacle_neighbourhood import ObstacleNeighbourhood
from dolfinx_nts.search import Neighbourhood
from dolfinx_nts.slip import Slip
from dolfinx_nts.spring_state import SpringState
from dolfinx_nts.surfaces import Surface

__all__ = ["ContactSprings"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]

# A node up to this part of a segment deep belongs to the segment; nodes are
# looked at while they are within reach or may get there soon.
_REACH, _MARGIN = 0.5, 0.25


class ContactSprings:
    """Springs of one contact pair by penalty. Collective.

    Args:
        pair: The pair.
        mass: Lumped mass of the owned nodes, shape ``(n,)`` [kg].

    Attributes:
        pair: The pair.

    Raises:
        ValueError: The pair is enforced by multipliers.
    """

    def __init__(self, pair: ContactPair, mass: Floats) -> None:
        """Compute the masses that the springs move."""
        if not isinstance(pair.enforcement, Penalty):
            raise ValueError(
                "expected contact by Penalty for an explicit step, "
                f"given {type(pair.enforcement).__name__}: use enforcement=Penalty()"
            )
        self.pair = pair
        self._share, given = float(pair.enforcement.share), pair.enforcement.eps_N
        self._penalty = None if given is None else self._share * given
        self._comm: MPI.Comm = pair.nodes.V.mesh.comm
        compliance: Floats = 1 / mass[pair.nodes.nodes]
        if isinstance(pair.segments, Surface):
            counts = np.array([len(pair.nodes.nodes), len(pair.segments.nodes)], dtype=float)
            counts = self._comm.allreduce(counts)
            lightest = mass[pair.segments.nodes].min(initial=np.inf)
            lightest = self._comm.allreduce(lightest, op=MPI.MIN)
            compliance += max(1.0, counts[0] / counts[1]) / lightest
        # Where both sides are nodes, there are springs from both.
        sides = (2 if pair.touches_itself else 1) / self._share
        self._reduced_mass: Floats = 1 / (sides * compliance)
        self._candidates: Ints
        self._idle = False
        self._neighbourhood: Neighbourhood | ObstacleNeighbourhood
        self.forget()

    def forget(self) -> None:
        """Look at all nodes again: the state was set."""
        self._travelled = np.inf

    def exchange(
        self, archive: Archive, name: str, state: SpringState | None, x: Floats
    ) -> SpringState:
        """Exchange the last evaluation and the nodes that are looked at.

        Collective, after the pair.

        Args:
            archive: Takes them or gives them.
            name: Name of the values.
            state: The last evaluation, if there is one; not needed while
                the archive gives.
            x: Its positions of the local nodes, shape ``(l, 3)`` [m].

        Returns:
            The evaluation.
        """
        pair = self.pair
        looked: Sequence[Any] | None = None
        if not archive.giving and np.isfinite(self._travelled):
            looked = [self._candidates, np.array([self._travelled, self._idle])]
        looked = archive.local(f"{name}/looked", looked)
        if archive.giving and looked is None:
            self._look_around(x)
        elif archive.giving and looked is not None:
            self._candidates, (travelled, idle) = looked
            self._travelled, self._idle = float(travelled), bool(idle)
            self._neighbourhood = pair.search.neighbourhood
        k = pair.segments.segments.shape[1] if isinstance(pair.segments, Surface) else 0
        force: Floats = np.zeros((len(pair.nodes.nodes), 1 + k, 3))
        if state is not None:
            force[state.node] = state.force
        force = archive.nodal(f"{name}/force", pair.nodes.node_ids, force)
        if state is not None and not archive.giving:
            return state
        history, here = pair.history, self._neighbourhood
        node = np.flatnonzero(history.active).astype(np.int32)
        dofs = here.dofs(pair.nodes.nodes[node], here.find(history.key[node]))
        num_active = self._comm.allreduce(len(node))
        return SpringState(here, node, dofs, force[node], history, num_active)

    @property
    def is_open(self) -> bool:
        """Whether the penalty is still to be chosen."""
        return self.pair.eps_N is None and self._penalty is None

    @property
    def squared_frequency(self) -> float:
        """Highest squared frequency of the springs [1/s^2]. Collective.

        Of those that are known: 0 while `is_open`.
        """
        friction = self.pair.friction
        normal = self._penalty if self.pair.eps_N is None else self.pair.eps_N
        given = None if friction is None else friction.eps_T
        tangential = given if self.pair.eps_T is None else self.pair.eps_T
        highest = 0.0
        for stiffness in (normal, tangential):
            if stiffness is not None:
                highest = max(highest, (stiffness / self._reduced_mass).max(initial=0.0))
        return float(self._comm.allreduce(highest, op=MPI.MAX))

    def settle(self, squared_frequency: float) -> None:
        """Settle stiffnesses that the user left open.

        Args:
            squared_frequency: Frequency of the normal springs with the
                reduced mass of a node and a segment's node, if the penalty
                is open [1/s^2].
        """
        penalty: Floats = squared_frequency * self._reduced_mass
        if self._penalty is not None:
            penalty = np.full_like(penalty, self._penalty)
        # The tangential spring; a pair makes its penalty ten times as stiff.
        self.pair.fix_stiffness((0.1 / self._share) * penalty)

    def evaluate(self, x_n: Floats, x: Floats, step: float) -> SpringState:
        """Forces at x; never changes the pair.

        Args:
            x_n: Accepted positions of the local nodes, owned and ghost,
                shape ``(l, 3)`` [m].
            x: Positions at the end of the step, shape ``(l, 3)`` [m].
            step: Largest motion of any node since the last evaluation,
                the same on all ranks [m].
        """
        self._travelled += 2 * step
        if self._travelled > _MARGIN * self.pair.segment_size:
            self._look_around(x)
        old, here = self.pair.history, self._neighbourhood
        if self._idle:
            return self._nothing()
        owned = here.index_map.size_local
        nodes, x = self.pair.nodes.nodes, here.with_ghosts(x[:owned])
        x_n = here.with_ghosts(x_n[:owned]) if self.pair.friction is not None else x
        segment = np.full(len(nodes), -1, dtype=np.int32)
        gap = np.full(len(nodes), np.nan)
        some = self._candidates
        segment[some], gap[some] = here.pair(
            x, nodes[some], here.find(old.key[some]), _REACH * self.pair.segment_size
        )
        node = np.flatnonzero(gap < 0).astype(np.int32)
        num_active = self._comm.allreduce(len(node))
        if not num_active:
            return self._nothing()
        return self._push(x_n, x, node, segment, gap, num_active)

    def work(self, old: SpringState, new: SpringState, du: Floats) -> ContactWork:
        """Work of the mean of two forces on a displacement, by cause.

        Collective.

        Args:
            old: Springs at the start of the step.
            new: Springs at its end.
            du: Displacement of the owned nodes, shape ``(n, 3)`` [m].
        """
        if not (old.num_active or new.num_active):
            return ContactWork()
        a, b = old.history, new.history
        stored = b.energy - a.energy
        # What springs and friction do not account for.
        rest = (old.work(du) + new.work(du)) / 2 + stored + b.dissipation
        same = (a.key == b.key) | ~b.active
        parts = np.array(
            [
                rest[a.active & same].sum(),
                rest[~a.active].sum(),
                rest[a.active & ~same].sum(),
                -stored.sum(),
                -b.dissipation.sum(),
            ]
        )
        return ContactWork(*(float(part) for part in self._comm.allreduce(parts)))

    def _look_around(self, x: Floats) -> None:
        """Find the nodes that may be in reach before the next look."""
        pair = self.pair
        reach = (_REACH + _MARGIN) * pair.segment_size
        here: Neighbourhood | ObstacleNeighbourhood
        here, _ = pair.search.update(x, reach)
        self._neighbourhood, self._travelled = here, 0.0
        x = here.with_ghosts(x[: here.index_map.size_local])
        self._candidates = here.near(x, pair.nodes.nodes, reach)
        self._idle = not self._comm.allreduce(len(self._candidates))

    def _nothing(self) -> SpringState:
        history = self.pair.history
        if history.active.any():
            none = ContactHistory.none(len(history.key))
            history = replace(none, slip=history.slip, dissipation=self._slip_energy())
        elif history.dissipation.any():
            history = replace(history, dissipation=np.zeros(len(history.key)))
        empty = np.empty(0, dtype=np.int32)
        return SpringState(
            self._neighbourhood, empty, empty[:, None], np.empty((0, 1, 3)), history, 0
        )

    def _slip_energy(self) -> Floats:
        """Energy of the tangential springs at t_n, lost where a node leaves."""
        t, eps_T = self.pair.history.traction, self.pair.eps_T
        if eps_T is None:
            return np.zeros(len(t))
        energy: Floats = np.einsum("ni,ni->n", t, t) / (2 * eps_T)
        return energy

    def _push(
        self, x_n: Floats, x: Floats, node: Ints, segment: Ints, gap: Floats, num_active: int
    ) -> SpringState:
        """Forces of the nodes inside."""
        pair, here, n = self.pair, self._neighbourhood, len(segment)
        assert pair.eps_N is not None and isinstance(pair.enforcement, Penalty)
        nodes, segments = pair.nodes.nodes[node], segment[node]
        gradient = here.gap_gradient(x, nodes, segments)
        lambda_N, energy = np.zeros((2, n))
        lambda_N[node] = pair.eps_N[node] * gap[node]
        energy[node] = pair.enforcement.energy(gap[node], pair.eps_N[node])
        force = -lambda_N[node, None] * gradient
        key = np.full(n, -1, dtype=np.int64)
        key[segment >= 0] = here.key[segment[segment >= 0]]
        active, sliding = gap < 0, np.zeros(n, dtype=bool)
        normal, traction, nodal = np.zeros((3, n, 3))
        length, dissipation = pair.history.slip.copy(), self._slip_energy()
        if pair.friction is not None:
            assert pair.eps_T is not None
            eps_T = pair.eps_T[node]
            slip = Slip(here.slip(x_n, x, nodes, segments))
            t_n = transport(
                pair.history.traction[node], pair.history.normal[node], slip.frame_n, slip.normal_n
            )
            trial, p = t_n + eps_T[:, None] * slip.value, -lambda_N[node]
            slides = pair.friction.slides(trial, trial, p, trial, np.zeros(len(node), dtype=bool))
            law = pair.friction.spring(trial, p, eps_T, trial, slides)
            t = law.explicit - lambda_N[node, None] * law.direction
            force -= np.einsum("mi,mij->mj", t, slip.gradient)
            lasting = slip.value - (t - t_n) / eps_T[:, None]
            dissipation[node] = np.einsum("mi,mi->m", t_n + t, lasting) / 2
            energy[node] += np.einsum("mi,mi->m", t, t) / (2 * eps_T)
            length[node] += np.where(slides, np.linalg.norm(lasting, axis=1), 0.0)
            sliding[node] = slides
            traction[node] = np.einsum("mi,mij->mj", t, slip.frame)
            normal[node] = slip.normal
        dofs = here.dofs(nodes, segments)
        force = force.reshape(*dofs.shape, 3)
        nodal[node] = force[:, 0]
        history = ContactHistory(
            key=key,
            active=active,
            sliding=sliding,
            lambda_N=lambda_N,
            force=nodal,
            gap=gap,
            offset=np.zeros(n),
            normal=normal,
            traction=traction,
            slip=length,
            energy=energy,
            dissipation=dissipation,
        )
        return SpringState(here, node, dofs, force, history, num_active)
