"""Evaluation of pairs: gap and force of nodes, by what they face."""

from abc import ABC, abstractmethod

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.pair_blocks import OwnBlocks
from dolfinx_nts.contact.joint_state import JointNodes
from dolfinx_nts.model.kinematics import Slip
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.search.points import NodalPoints

__all__ = ["NodePairing", "Pairing"]


class Pairing(ABC):
    """Evaluates pairs of the nodes of a surface and what they face. Local.

    In the methods ``x`` are positions of the nodes that the candidates know, ``(l, 3)`` [m],
    ``node`` positions among the surface's nodes, shape ``(m,)``, and ``segment`` what these
    face, shape ``(m,)``.

    Attributes:
        area: Area on which the multiplier of each node acts, shape ``(n,)`` [m^2].
        reached: Nodes on which gaps may depend, shape ``(r,)``.
        follows: Whether nodes change their segments within a step.
    """

    area: Floats
    reached: Ints
    follows: bool

    @abstractmethod
    def gaps(self, x: Floats, node: Ints, segment: Ints) -> Floats:
        """Compute the gaps of nodes, shape ``(m,)`` [m]."""

    @abstractmethod
    def kinematics(
        self, scheme: str, x: Floats, node: Ints, segment: Ints, free: Floats | None
    ) -> PairKinematics:
        """Evaluate nodes in a step to x.

        ``scheme`` is the kernel, see `Candidates.contact`, and ``free`` is 1 where the
        displacement of a node is unknown, otherwise 0, ``(l, 3)``, or None if all are.
        """

    @abstractmethod
    def slip(self, law: str, x: Floats, node: Ints, segment: Ints) -> Slip:
        """Evaluate the slip of nodes in a step to x; ``law`` as of `Candidates.slip`."""

    @abstractmethod
    def on_nodes(self, pairs: PairKinematics, force: Floats) -> Floats:
        """Sum up the forces of pairs, ``(m, d)`` [N], on the nodes, ``(n, 3)`` [N]. Collective."""

    @abstractmethod
    def is_same(self, pairs: PairKinematics) -> Flags:
        """Whether pairs have the segments of the last step, shape ``(m,)``."""

    @abstractmethod
    def num_beyond(self, x: Floats, node: Ints) -> int:
        """Number of contact points of nodes that have slid off their segments."""


class NodePairing(Pairing):
    """Nodes and their segments, see `Pairing`.

    Args:
        surface: Surface of the nodes.
        candidates: What they may face.
        points: Contact points of the nodes.
        x_n: Positions at t_n, shape ``(l, 3)`` [m].
        last: Keys of the segments of the last step, shape ``(n,)``.
    """

    follows = True

    def __init__(
        self,
        surface: Surface | JointNodes,
        candidates: Candidates,
        points: NodalPoints,
        x_n: Floats,
        last: GlobalInts,
    ) -> None:
        """Take what does not change in the step."""
        self.area, self._surface = surface.area, surface
        self.reached = np.concatenate([points.nodes, candidates.segments.ravel()])
        self._candidates, self._points, self._x_n, self._last = candidates, points, x_n, last

    def gaps(self, x: Floats, node: Ints, segment: Ints) -> Floats:
        """Distances from the segments, see `Pairing.gaps`."""
        return self._candidates.gap(self._points.take(node), x, segment)

    def kinematics(
        self, scheme: str, x: Floats, node: Ints, segment: Ints, free: Floats | None
    ) -> PairKinematics:
        """Evaluate each node and its segment, see `Pairing.kinematics`."""
        points = self._points.take(node)
        contact = self._candidates.contact(scheme, points, self._x_n, x, segment)
        dofs = points.dofs(self._candidates.segments.take(segment, axis=0))
        unknown = None if free is None else free[dofs].reshape(contact.force.shape)
        blocks = OwnBlocks(dofs, unknown, contact.tangent)
        return PairKinematics(node, segment, unknown, contact, blocks)

    def slip(self, law: str, x: Floats, node: Ints, segment: Ints) -> Slip:
        """Evaluate each node and its segment, see `Pairing.slip`."""
        points = self._points.take(node)
        return self._candidates.slip(law, points, self._x_n, x, segment)

    def on_nodes(self, pairs: PairKinematics, force: Floats) -> Floats:
        """Take the force on each node of a pair, see `Pairing.on_nodes`."""
        total = np.zeros((len(self._last), 3))
        total[pairs.node] = force[:, :3]
        return total

    def is_same(self, pairs: PairKinematics) -> Flags:
        """Compare keys of segments, see `Pairing.is_same`."""
        same: Flags = self._last[pairs.node] == self._candidates.key[pairs.segment]
        return same

    def num_beyond(self, x: Floats, node: Ints) -> int:
        """Return 0, as nodes follow their segments, see `Pairing.num_beyond`."""
        return 0
