"""Evaluation of pairs: gap and force of nodes and their segments."""

from abc import ABC, abstractmethod

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.friction.mortar_slip import NodalFrames, mean_slip
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.pair_blocks import OwnBlocks
from dolfinx_nts.contact.implicit.shared_segments import SharedBlocks
from dolfinx_nts.contact.joint_state import JointNodes
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.search.mortar.mortar_points import MortarPoints, at_nodes
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.shared_segments import SharedSegments, shared_points

__all__ = ["NodePairing", "Pairing"]


class Pairing(ABC):
    """Evaluates pairs of nodes of a surface and their segments. Local.

    In the methods ``x`` are positions of the nodes of the candidates, ``(l, 3)`` [m], ``node``
    indices among the nodes of the surface, shape ``(m,)``, and ``segment`` their candidate
    segments, shape ``(m,)``.

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
        displacement of a node is unknown, otherwise 0, ``(l, 3)``, or None if all are unknown.
        """

    @abstractmethod
    def exchanged(self, x: Floats) -> "Pairing":
        """Copy with the same nodes and segments for a step that starts at x instead of x_n."""

    @abstractmethod
    def slip(self, measure: str, x: Floats, node: Ints, segment: Ints) -> Slip:
        """Evaluate the slip of nodes in a step to x; ``measure`` as for `Candidates.slip`."""

    @abstractmethod
    def on_nodes(self, pairs: PairKinematics, force: Floats) -> Floats:
        """Sum up the forces of pairs, ``(m, d)`` [N], on the nodes, ``(n, 3)`` [N]. Collective."""

    @abstractmethod
    def on_segments(self, pairs: PairKinematics) -> Flags:
        """Whether entries of ``pairs.dofs`` are nodes of segments, of the same shape."""

    @abstractmethod
    def is_same(self, pairs: PairKinematics) -> Flags:
        """Whether pairs have the segments of the last step, shape ``(m,)``."""

    @abstractmethod
    def num_beyond(self, x: Floats, node: Ints) -> int:
        """Number of contact points of nodes that have slid off their segments."""


class NodePairing(Pairing):
    """Nodes and their segments.

    Args:
        surface: Surface of the nodes.
        candidates: Candidate segments.
        points: Contact points of the nodes.
        x_n: Positions at t_n, shape ``(l, 3)`` [m].
        history: Contact of the nodes in the last step.

    Attributes:
        shared: Segments of nodes that are equally near to several segments. The gap of such a node
            is the mean of its gaps to these segments.
    """

    follows = True

    def __init__(
        self,
        surface: Surface | JointNodes,
        candidates: Candidates,
        points: NodalPoints,
        x_n: Floats,
        history: ContactHistory,
    ) -> None:
        """Store data that are constant in the step."""
        self.area, self._surface = surface.area, surface
        self.reached = np.concatenate([points.nodes, candidates.segments.ravel()])
        self._candidates, self._points, self._x_n, self._history = candidates, points, x_n, history
        self.shared = SharedSegments(len(history.key))

    def gaps(self, x: Floats, node: Ints, segment: Ints) -> Floats:
        if not self.shared.many[node].any():
            return self._candidates.gap(self._points.take(node), x, segment)
        row, segment, start = self.shared.entries(node, segment)
        gap = self._candidates.gap(self._points.take(node[row]), x, segment)
        return self.shared.mean(gap, start)

    def kinematics(
        self, scheme: str, x: Floats, node: Ints, segment: Ints, free: Floats | None
    ) -> PairKinematics:
        if self.shared.many[node].any():
            return self._shared_kinematics(scheme, x, node, segment, free)
        points = self._points.take(node)
        contact = self._candidates.contact(scheme, points, self._x_n, x, segment)
        dofs = points.dofs(self._candidates.segments.take(segment, axis=0))
        unknown = None if free is None else free[dofs].reshape(contact.force.shape)
        blocks = OwnBlocks(dofs, unknown, contact.tangent)
        return PairKinematics(node, segment, unknown, contact, blocks)

    def exchanged(self, x: Floats) -> "NodePairing":
        others = self._surface, self._candidates, self._points, x, self._history
        other = NodePairing(*others)
        other.shared = self.shared
        return other

    def slip(self, measure: str, x: Floats, node: Ints, segment: Ints) -> Slip:
        if not self.shared.many[node].any():
            points = self._points.take(node)
            return self._candidates.slip(measure, points, self._x_n, x, segment)
        nodal, shared = self._shared(node, segment)
        slip = self._candidates.slip(measure, nodal, self._x_n, x, shared.segment)
        return mean_slip(shared, slip, NodalFrames.of(shared, slip))

    def _shared_kinematics(
        self, scheme: str, x: Floats, node: Ints, segment: Ints, free: Floats | None
    ) -> PairKinematics:
        """Sum the kinematics of all segments of each node."""
        nodal, shared = self._shared(node, segment)
        contact = self._candidates.contact(scheme, nodal, self._x_n, x, shared.segment)
        gap_n, gap, force, gradient, turn = at_nodes(shared, contact)
        mean = ContactKinematics(gap_n, gap, force, gradient, contact.tangent, turn)
        # Short rows are padded by repetitions of a vertex, not of the node.
        dofs = shared.lists
        if self._candidates.segments.shape[1]:
            dofs = np.where(dofs == dofs[:, :1], dofs[:, 1:2], dofs)
            dofs[:, 0] = shared.lists[:, 0]
        of_rows = of_points = None
        if free is not None:
            of_rows, of_points = (
                free[each].reshape(len(each), -1) for each in (dofs, shared.reached)
            )
        unknown = None if of_rows is None or of_points is None else (of_rows, of_points)
        blocks = SharedBlocks(shared, dofs, unknown, contact.tangent)
        return PairKinematics(node, segment, of_rows, mean, blocks)

    def _shared(self, node: Ints, segment: Ints) -> tuple[NodalPoints, MortarPoints]:
        """Contact points of nodes, one for each segment of a node, in two formats."""
        row, segment, start = self.shared.entries(node, segment)
        nodal = self._points.take(node[row])
        dofs = nodal.dofs(self._candidates.segments.take(segment, axis=0))
        return nodal, shared_points(self._points.nodes[node], dofs, segment, start)

    def on_nodes(self, pairs: PairKinematics, force: Floats) -> Floats:
        total = np.zeros((len(self._history.key), 3))
        total[pairs.node] = force[:, :3]
        return total

    def on_segments(self, pairs: PairKinematics) -> Flags:
        of_segments = np.ones(pairs.dofs.shape, dtype=bool)
        of_segments[:, 0] = False
        return of_segments

    def is_same(self, pairs: PairKinematics) -> Flags:
        """Whether nodes have the same set of segments as in the last step, by their keys."""
        last, key = self._history, self._candidates.key
        same: Flags = last.key[pairs.node] == key[pairs.segment]
        if self.shared.many.any() or last.shared.any():
            same &= (last.shared == self.shared.sums(key))[pairs.node]
        return same

    def num_beyond(self, x: Floats, node: Ints) -> int:
        """Return 0, as nodes follow their segments."""
        return 0
