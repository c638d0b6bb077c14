"""Normal contact in one attempt at a step: what multipliers and springs share."""

from abc import ABC, abstractmethod

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.friction import Friction
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.pair_state import PairState

__all__ = ["NormalContact", "go_on", "known_nodes"]


class NormalContact(ABC):
    """Normal forces of the nodes of a pair: by multipliers or by springs.

    In the methods ``pairs`` are the ``m`` pairs, ``x`` positions with ghosts, shape ``(l, 3)``
    [m], and ``friction`` is the friction of the pairs.

    Args:
        state: State of the contact pair.
        search: Segments of the nodes.

    Attributes:
        nodes: The eligible nodes, positions among the surface's nodes, shape ``(e,)``.
        active: Whether a node transmits force, shape ``(n,)``.
        lambda_N: Normal multipliers, shape ``(n,)`` [N, <= 0].
        flips: How often a node has changed between contact and none, shape ``(n,)``.
    """

    def __init__(self, state: PairState | JointState, search: LocalSearch) -> None:
        self._state, self._search, history = state, search, state.history
        self._comm: MPI.Comm = state.nodes.V.mesh.comm
        self.flips: Ints = np.zeros(len(history.active), dtype=np.int32)
        # Nodes that would be eligible if others next to them were not.
        self._barred: Flags = np.zeros(len(history.active), dtype=bool)
        self._admitted: Flags = np.zeros_like(self._barred)
        self._begin(history.active, history.lambda_N)

    def _begin(self, active: Flags, lambda_N: Floats) -> None:
        """Choose the eligible nodes; those of them that are active stay so. Collective."""
        self._eligible = self.choose()
        self.nodes: Ints = self._eligible.nonzero()[0].astype(np.int32)
        self.active: Flags = active & self._eligible
        self.lambda_N: Floats = np.where(self.active, lambda_N, 0.0)

    def renew(self, x: Floats, *, moved: bool) -> int:
        """Go on in an equilibrium x: with other contact points within the step, if they moved.

        Returns for how many nodes of this rank others are to transmit force instead. Collective.
        """
        if moved:
            self._begin(self.active, self.lambda_N)
        return 0

    def choose(self) -> Flags:
        """Choose the nodes that may transmit force, shape ``(n,)``. Collective."""
        return self._search.approach.segment >= 0

    def may_hold(self, node: Ints, gap_n: Floats, gap: Floats) -> Flags | bool:
        """Whether the law lets nodes touch that go from one gap to another in the step. Local.

        Args:
            node: Positions among the surface's nodes, shape ``(m,)``.
            gap_n: Gaps at t_n, shape ``(m,)`` [m].
            gap: Gaps at the end of the step, shape ``(m,)`` [m].
        """
        return True

    def held(self, pairs: PairKinematics) -> Floats:
        """Largest gaps at which the law lets pairs transmit force, shape ``(m,)`` [m]. Local."""
        return np.zeros(len(pairs.node))

    def admit(self, nodes: Flags) -> None:
        """Let nodes touch that an earlier solution of the step let touch. Collective.

        ``nodes`` are flags, shape ``(n,)``.
        """
        self._admitted = nodes
        self._begin(self.active, self.lambda_N)

    def _begin_in_touch(self) -> None:
        """Let nodes that lie on their segments be active until forces say otherwise. Local."""
        self.active |= self._eligible & self._search.touches

    @property
    def may_touch(self) -> Flags:
        """Whether a node may touch within the step, shape ``(n,)``. Local."""
        flags: Flags = self._search.may_close | self._state.history.active | self.active
        return flags

    def needs(self, x: Floats, node: Ints) -> Flags | None:
        """Whether the kinematics of nodes matter, shape ``(m,)``; None: all do. Local."""
        return None

    def _gaps(self, x: Floats, node: Ints) -> Floats:
        """Gaps of nodes to the segments just found at x, shape ``(m,)`` [m]. Local."""
        search = self._search
        if not search.pairing.follows:  # points that stay are not projected to be found
            search.gap[node] = search.pairing.gaps(x, node, search.segment[node])
        return search.gap[node]

    @abstractmethod
    def update(
        self, pairs: PairKinematics, x: Floats, R: Floats | None, friction: Friction, iteration: int
    ) -> int:
        """Decide which pairs transmit force and compute it, with friction. Collective.

        ``R`` is the residual without contact at the owned nodes, shape ``(n, 3)`` [N]; with
        None multipliers stay as they are. ``iteration`` counts the Newton iterations of the
        step from 0. Returns how many pairs of this rank contradict their state, or did.
        """

    def close_gaps(  # noqa: B027 (springs want no gap)
        self, pairs: PairKinematics, x: Floats, u: Floats, friction: Friction
    ) -> None:
        """Move nodes to where constraints want them. Collective.

        ``x`` are the positions of the owned nodes only, shape ``(n, 3)`` [m], ``u`` their
        displacements, which are changed, as they have more digits than positions.
        """

    @abstractmethod
    def rank(self, active: Flags) -> Ints:
        """Number of normal constraints of each pair, shape ``(m,)``. Local."""

    def tangent(self, node: Ints) -> tuple[Floats, Floats | float]:
        """Multipliers of the last pairs in linear systems. Local.

        Returns those with which the directions of their forces change, shape ``(m,)`` [N], and
        their derivative by the gaps, ``(m,)`` [N/m].
        """
        return self.lambda_N[node], 0.0

    def energy(self, pairs: PairKinematics) -> tuple[Floats, Floats]:
        """Energy of springs [J], and gap at which they begin [m], both ``(m,)``. Local."""
        zero = np.zeros(len(pairs.node))
        return zero, zero

    def stored(self, pairs: PairKinematics) -> Floats | float:
        """Energy that went into the springs in the step, shape ``(m,)`` [J]. Local."""
        return 0.0

    def released_energy(self, node: Ints) -> float:
        """Energy at t_n of the normal springs of all nodes but the given ones [J]. Local."""
        return 0.0


def known_nodes(contact: NormalContact) -> Flags:
    """Nodes that are eligible, or would be without others, shape ``(n,)``. Local."""
    return contact._eligible | contact._barred


def go_on(contact: NormalContact, other: NormalContact) -> None:
    """Begin with the active set and the multipliers of another attempt at the step. Local."""
    contact.active = other.active & contact._eligible
    contact.lambda_N = np.where(contact.active, other.lambda_N, 0.0)
