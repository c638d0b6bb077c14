"""Contact by springs, evaluated at one state: for explicit steps.

The force is minus the gradient of the springs' energy at that state, so
that every evaluation leaves both momenta alone. Nothing is iterated.

Forces of the springs of a contact pair at one state, and their work.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.explicit.neighbour_list import NeighbourList
from dolfinx_nts.contact.friction import transport
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.slip import Slip
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import SegmentCandidates
from dolfinx_nts.search.obstacle_candidates import ObstacleCandidates

__all__ = ["ContactSprings", "SpringState"]


_NONE: Floats = np.empty(0)
_NO_WORK = (0.0,) * 5


_NO_SPRINGS = _kernels.Springs(
    np.empty(0, dtype=np.int32),
    np.empty(0, dtype=np.int64),
    np.empty((0, 1), dtype=np.int32),
    np.empty((0, 1, 3)),
    np.empty(0),
)


class SpringState(NamedTuple):
    """Forces of the springs of a pair at one state.

    Attributes:
        candidates: Owned nodes and ghosts of the forces; None where no
            rank has a node near a segment.
        springs: Springs of the active nodes, by their positions in the
            surface's nodes.
        dissipation: Lost by friction in the step at all nodes of the surface,
            ``(n,)`` [J]; None without friction.
        history: Makes what the pair remembers of the state.
    """

    candidates: SegmentCandidates | ObstacleCandidates | None
    springs: _kernels.Springs
    dissipation: Floats | None
    history: Callable[[], ContactHistory]

    @classmethod
    def none(
        cls, history: Callable[[], ContactHistory], dissipation: Floats | None = None
    ) -> "SpringState":
        """No forces."""
        return cls(None, _NO_SPRINGS, dissipation, history)

    def add_to(self, total: Floats) -> None:
        """Add the forces to those of the owned nodes. Collective.

        Args:
            total: Shape ``(n, 3)`` [N].
        """
        if self.candidates is not None:
            self.candidates.add_to_owners(total, self.springs.dofs, self.springs.force)

    @property
    def stored(self) -> float:
        """Energy of all springs on this rank [J]."""
        return float(self.springs.energy.sum())

    def displacement(self, du: Floats) -> Floats:
        """Displacement also of the ghosts, shape ``(l, 3)`` [m]. Collective.

        Args:
            du: That of the owned nodes, shape ``(n, 3)`` [m].
        """
        return du if self.candidates is None else self.candidates.with_ghosts(du)


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
            counts = reductions.total(self._comm, counts)
            lightest = mass[pair.segments.nodes].min(initial=np.inf)
            lightest = reductions.least(self._comm, lightest)
            compliance += max(1.0, counts[0] / counts[1]) / lightest
        # Where both sides are nodes, there are springs from both.
        sides = (2 if pair.touches_itself else 1) / self._share
        self._reduced_mass: Floats = 1 / (sides * compliance)
        self._neighbours = NeighbourList(pair)

    def forget(self) -> None:
        """Look at all nodes again: the state was set."""
        self._neighbours.forget()

    def serialize(
        self, archive: Archive, name: str, state: SpringState | None, x: Floats
    ) -> SpringState:
        """Serialize the last evaluation and the nodes that are looked at.

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
        self._neighbours.serialize(archive, f"{name}/looked", x)
        k = pair.segments.segments.shape[1] if isinstance(pair.segments, Surface) else 0
        force: Floats = np.zeros((len(pair.nodes.nodes), 1 + k, 3))
        if state is not None:
            force[state.springs.node] = state.springs.force
        force = archive.nodal(f"{name}/force", pair.nodes.node_ids, force)
        if state is not None and not archive.giving:
            return state
        history, candidates = pair.history, self._neighbours.candidates
        lost = None if pair.friction is None else history.dissipation
        if self._neighbours.is_idle:
            return SpringState.none(lambda: history, lost)
        node = np.flatnonzero(history.active).astype(np.int32)
        key = history.key[node]
        dofs = candidates.dofs(pair.nodes.nodes[node], candidates.find(key))
        springs = _kernels.Springs(node, key, dofs, force[node], history.energy[node])
        return SpringState(candidates, springs, lost, lambda: history)

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
        return float(reductions.largest(self._comm, highest))

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

    @property
    def num_segments(self) -> int:
        """Segments that this rank looks at."""
        return len(self._neighbours.candidates.size)

    def evaluate(self, x_n: Floats, x: Floats, step: float) -> SpringState:
        """Forces at x; never changes the pair.

        Args:
            x_n: Accepted positions of the local nodes, owned and ghost,
                shape ``(l, 3)`` [m]; only used with friction.
            x: Positions at the end of the step, shape ``(l, 3)`` [m].
            step: Largest motion of any node since the last evaluation,
                the same on all ranks [m].
        """
        pair, seen = self.pair, self._neighbours
        seen.update(x, step)
        if seen.is_idle:
            return self._nothing()
        candidates, number, stiffness = seen.candidates, seen.number, seen.stiffness
        x = candidates.with_ghosts(x[: candidates.index_map.size_local])
        nodes, current = seen.nodes, seen.current
        segment, gap, springs = candidates.penalty_forces(
            x, number, nodes, current, seen.reach, stiffness
        )
        seen.current = segment
        rubbed: dict[str, Any] = {}
        if pair.friction is not None:
            x_n = candidates.with_ghosts(x_n[: candidates.index_map.size_local])
            inside = gap < 0
            rubbed = self._friction_forces(
                x_n, x, springs, segment[inside], (stiffness * gap)[inside]
            )

        def history() -> ContactHistory:
            history, node = ContactHistory.none(len(self._reduced_mass)), springs.node
            paired, inside = segment >= 0, gap < 0
            history.key[number[paired]] = candidates.key[segment[paired]]
            history.gap[number] = gap
            history.active[node] = True
            history.lambda_N[node] = (stiffness * gap)[inside]
            history.energy[node], history.force[node] = springs.energy, springs.force[:, 0]
            return replace(history, **rubbed)

        return SpringState(candidates, springs, rubbed.get("dissipation"), history)

    def work(self, old: SpringState, new: SpringState, du: Floats) -> tuple[float, ...]:
        """Work of the mean of two forces on a displacement, on this rank. Collective.

        Args:
            old: Springs at the start of the step.
            new: Springs at its end.
            du: Displacement of the owned nodes, shape ``(n, 3)`` [m].

        Returns:
            Work by the causes of `ContactWork` [J].
        """
        if old.candidates is None and new.candidates is None:
            return _NO_WORK
        du_old = old.displacement(du)
        du_new = du_old if new.candidates is old.candidates else new.displacement(du)
        lost = _NONE if new.dissipation is None else new.dissipation
        return _kernels.work_by_cause(old.springs, new.springs, du_old, du_new, lost)

    def _nothing(self) -> SpringState:
        """No forces; what friction remembers is lost."""
        n = len(self._reduced_mass)
        if self.pair.friction is None:
            return SpringState.none(lambda: ContactHistory.none(n))
        slip, lost = self.pair.history.slip, self._slip_energy()
        return SpringState.none(
            lambda: replace(ContactHistory.none(n), slip=slip, dissipation=lost), lost
        )

    def _slip_energy(self) -> Floats:
        """Energy of the tangential springs at t_n, lost where a node leaves."""
        t, eps_T = self.pair.history.traction, self.pair.eps_T
        assert eps_T is not None
        energy: Floats = np.einsum("ni,ni->n", t, t) / (2 * eps_T)
        return energy

    def _friction_forces(
        self,
        x_n: Floats,
        x: Floats,
        springs: _kernels.Springs,
        segments: Ints,
        lambda_N: Floats,
    ) -> dict[str, Any]:
        """Add friction to force and energy; returns what the pair remembers of it."""
        pair, node = self.pair, springs.node
        assert pair.friction is not None and pair.eps_T is not None
        old, n, eps_T = pair.history, len(pair.eps_T), pair.eps_T[node]
        slip = Slip(self._neighbours.candidates.slip(x_n, x, springs.dofs, segments))
        t_n = transport(old.traction[node], old.normal[node], slip.frame_n, slip.normal_n)
        trial, p = t_n + eps_T[:, None] * slip.value, -lambda_N
        slides = pair.friction.slides(trial, trial, p, trial, np.zeros(len(node), dtype=bool))
        law = pair.friction.spring(trial, p, eps_T, trial, slides)
        t = law.explicit + p[:, None] * law.direction
        force, energy = springs.force, springs.energy
        force -= np.einsum("mi,mij->mj", t, slip.gradient).reshape(force.shape)
        lasting = slip.value - (t - t_n) / eps_T[:, None]
        energy += np.einsum("mi,mi->m", t, t) / (2 * eps_T)
        length, dissipation, sliding = old.slip.copy(), self._slip_energy(), np.zeros(n, dtype=bool)
        normal, traction = np.zeros((2, n, 3))
        length[node] += np.where(slides, np.linalg.norm(lasting, axis=1), 0.0)
        dissipation[node] = np.einsum("mi,mi->m", t_n + t, lasting) / 2
        sliding[node], normal[node] = slides, slip.normal
        traction[node] = np.einsum("mi,mij->mj", t, slip.frame)
        return {
            "slip": length,
            "dissipation": dissipation,
            "sliding": sliding,
            "normal": normal,
            "traction": traction,
        }
