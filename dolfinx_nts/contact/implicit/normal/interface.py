"""Interface of normal contact in a step."""

from abc import ABC, abstractmethod

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints, indices
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.friction.interface import Friction
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.parallel import reductions

__all__ = ["NormalContact", "eligible_or_excluded", "start_normal_contact"]

# Largest number of times in a step that excluded nodes become eligible [-].
_MOST_CHOICES = 2


class NormalContact(ABC):
    """Base class of normal contact by multipliers or springs.

    Common arguments: ``pairs`` are the ``m`` pairs, ``x`` positions with ghosts, shape ``(l, 3)``
    [m], and ``friction`` is the friction of the pairs.

    Args:
        state: State of the contact pair.
        search: Segments of the nodes.

    Attributes:
        nodes: Eligible nodes, as indices among the nodes of the surface, shape ``(e,)``.
        active: Whether a node transmits force, shape ``(n,)``.
        lambda_N: Normal multipliers, shape ``(n,)`` [N, <= 0].
        flips: Number of changes of the active state of each node, shape ``(n,)``.
        soft_depth: Compression beyond which springs are stiffer, shape ``(n,)`` [m].
        stiffness_fraction: Fraction of the stiffness of each spring that acts, ``(n,)`` [-].
    """

    def __init__(self, state: PairState | JointState, search: LocalSearch) -> None:
        self._state, self._search, history = state, search, state.history
        self._comm: MPI.Comm = state.nodes.V.mesh.comm
        self.flips: Ints = np.zeros(len(history.active), dtype=np.int32)
        self.soft_depth: Floats = np.full(len(history.active), np.inf)
        self.stiffness_fraction: Floats = np.ones(len(history.active))
        # Nodes excluded because of eligible neighbours.
        self._barred: Flags = np.zeros(len(history.active), dtype=bool)
        self._admitted: Flags = np.zeros_like(self._barred)
        # Excluded nodes that penetrated, and how often nodes may still become eligible in the step.
        self._sunk: Flags = np.zeros_like(self._barred)
        self._choices = _MOST_CHOICES
        # Nodes whose constraints are replaced by those of vertices.
        self._replaced: Flags = np.zeros_like(self._barred)
        self._begin(history.active, history.lambda_N)

    def _begin(self, active: Flags, lambda_N: Floats) -> None:
        """Choose the eligible nodes, and deactivate all others. Collective."""
        self._eligible = self.choose() & ~self._replaced
        self.nodes: Ints = indices(self._eligible)
        self.active: Flags = active & self._eligible
        self.lambda_N: Floats = np.where(self.active, lambda_N, 0.0)

    def renew(self, x: Floats, *, moved: bool) -> int:
        """Update eligible nodes in an equilibrium x. Collective.

        ``moved`` is whether contact points have changed. Returns the number of nodes of this
        rank whose eligibility has changed.
        """
        if moved:
            self._begin(self.active, self.lambda_N)
        return 0

    def choose(self) -> Flags:
        """Flags of nodes that may transmit force, shape ``(n,)``. Collective."""
        return self._faces_by_law()

    def _faces_by_law(self) -> Flags:
        """Flags of nodes that have a segment and are eligible by the law, shape ``(n,)``. Local."""
        return self._search.approach.segment >= 0

    def _admit_penetrating(self, node: Ints, segment: Ints, gap: Floats) -> int:
        """Make nodes eligible on the segments that they have penetrated. Collective.

        Arguments have the shape ``(m,)``. Returns the number of nodes of this rank.
        """
        if not reductions.anywhere(self._comm, len(node) > 0):
            return 0
        self._choices -= 1
        search, approach = self._search, self._search.approach
        self._sunk[node] = True
        search.segment[node], search.gap[node] = segment, gap
        faces = (self._eligible | self._sunk) & (search.segment >= 0)
        approach.segment[faces] = search.segment[faces]
        self._begin(self.active, self.lambda_N)
        return len(node)

    def may_activate(self, node: Ints, gap_n: Floats, gap: Floats) -> Flags | bool:
        """Whether the law makes nodes eligible, by their gaps at both ends of the step. Local.

        Args:
            node: Indices among the nodes of the surface, shape ``(m,)``.
            gap_n: Gaps at t_n, shape ``(m,)`` [m].
            gap: Gaps at the end of the step, shape ``(m,)`` [m].
        """
        return True

    def largest_gaps(self, pairs: PairKinematics) -> Floats:
        """Largest gaps at which pairs may transmit force, shape ``(m,)`` [m]. Local."""
        return np.zeros(len(pairs.node))

    def replace(self, nodes: Flags, own: slice) -> int:
        """Exclude nodes whose constraints are replaced by constraints of vertices. Collective.

        Args:
            nodes: Flags of all excluded nodes of a pair, shape ``(n,)``.
            own: Range of the nodes of this pair.

        Returns:
            Number of nodes of this rank that become excluded or eligible.
        """
        changed = self._replaced[own] != nodes
        if reductions.anywhere(self._comm, bool(changed.any())):
            self._replaced[own] = nodes
            self._begin(self.active, self.lambda_N)
        return int(np.count_nonzero(changed))

    def admit(self, nodes: Flags) -> None:
        """Make nodes eligible that were eligible in an earlier solution of the step. Collective.

        ``nodes`` are flags, shape ``(n,)``.
        """
        self._admitted = nodes
        self._begin(self.active, self.lambda_N)

    def _begin_in_touch(self) -> None:
        """Initially activate nodes that lie on their segments. Local."""
        self.active |= self._eligible & self._search.touches

    @property
    def may_touch(self) -> Flags:
        """Whether a node may touch within the step, shape ``(n,)``. Local."""
        flags: Flags = self._search.may_close | self._state.history.active | self.active
        return flags

    def needs(self, x: Floats, node: Ints) -> Flags | None:
        """Flags of nodes whose kinematics are needed, shape ``(m,)``; None for all. Local."""
        return None

    def gaps(self, x: Floats, node: Ints) -> Floats:
        """Gaps of nodes to their segments at x, shape ``(m,)`` [m]. Local."""
        search = self._search
        if not search.pairing.follows:  # points that keep their segment need no projection
            search.gap[node] = search.pairing.gaps(x, node, search.segment[node])
        return search.gap[node]

    @abstractmethod
    def update(
        self, pairs: PairKinematics, x: Floats, R: Floats | None, friction: Friction, iteration: int
    ) -> int:
        """Update active set and normal forces, with friction. Collective.

        ``R`` is the residual without contact at the owned nodes, shape ``(n, 3)`` [N]; None keeps
        the multipliers. ``iteration`` is the number of the Newton iteration, from 0. Returns the
        number of pairs of this rank that changed or violate a condition.
        """

    def close_gaps(  # noqa: B027 (springs want no gap)
        self, pairs: PairKinematics, x: Floats, u: Floats, friction: Friction
    ) -> None:
        """Move nodes to satisfy the constraints. Collective.

        ``x`` are the positions of the owned nodes only, shape ``(n, 3)`` [m], ``u`` their
        displacements, changed in place, which have more digits than positions.
        """

    @abstractmethod
    def rank(self, active: Flags) -> Ints:
        """Number of normal constraints of each pair, shape ``(m,)``. Local."""

    def tangent(self, node: Ints) -> tuple[Floats, Floats | float]:
        """Multipliers in the geometric tangent of the last pairs, ``(m,)`` [N], and slopes. Local.

        The slopes are the derivatives of multipliers with respect to gaps, ``(m,)`` [N/m].
        """
        return self.lambda_N[node], 0.0

    def energy(self, pairs: PairKinematics) -> tuple[Floats, Floats]:
        """Energy of springs [J] and the gap at which they begin [m], both ``(m,)``. Local."""
        zero = np.zeros(len(pairs.node))
        return zero, zero

    def stored(self, pairs: PairKinematics) -> Floats | float:
        """Energy stored in the springs in the step, shape ``(m,)`` [J]. Local."""
        return 0.0

    def surplus_energy(self, pairs: PairKinematics) -> Floats:
        """Energy of springs at t_n minus their energy with new contact points, ``(m,)`` [J].

        Local.
        """
        return np.zeros(len(pairs.node))

    def released_energy(self, node: Ints) -> Floats:
        """Energy at t_n of the normal springs of all other nodes, ``(n,)`` [J]. Local."""
        return np.zeros(len(self.active))


def eligible_or_excluded(contact: NormalContact) -> Flags:
    """Flags of eligible and of excluded nodes, shape ``(n,)``. Local."""
    return contact._eligible | contact._barred


def start_normal_contact(contact: NormalContact, other: NormalContact) -> None:
    """Start from the active set and multipliers of another attempt at the step. Local."""
    contact.active = other.active & contact._eligible
    contact.lambda_N = np.where(contact.active, other.lambda_N, 0.0)
