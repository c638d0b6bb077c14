"""Local search and forces of crossing edges in a step."""

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.implicit.pairing import NodePairing
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.pair_state import PairState

__all__ = ["CrossingEdges"]

# Weight of a carrier at a crossing [-] below which its displacement cannot be eliminated.
_LEAST_SHARE = 0.25


class EdgePairing(NodePairing):
    """Pairs of a sharp edge, represented by its carrier node, and an edge that crosses it.

    The force of a pair acts on both ends of the edge. The displacement of the carrier is eliminated
    only if its weight is not small.
    """

    def kinematics(
        self, scheme: str, x: Floats, node: Ints, segment: Ints, free: Floats | None
    ) -> PairKinematics:
        pairs = super().kinematics(scheme, x, node, segment, free)
        share = np.linalg.norm(pairs.contact.gradient[:, :3], axis=1)
        pairs.fixed |= ~(share > _LEAST_SHARE)
        return pairs

    def on_nodes(self, pairs: PairKinematics, force: Floats) -> Floats:
        scatter = self._candidates.scatter
        total = np.zeros((scatter.index_map.size_local, 3))
        scatter.add(total, pairs.dofs[:, :2], force.reshape(*pairs.dofs.shape, 3)[:, :2])
        return total[self._surface.nodes]

    def on_segments(self, pairs: PairKinematics) -> Flags:
        of_segments = super().on_segments(pairs)
        of_segments[:, 1] = False
        return of_segments


class CrossingEdges(LocalSearch):
    """Local search of crossing edges."""

    def __init__(self, state: PairState | JointState, x_n: Floats, x_trial: Floats) -> None:
        super().__init__(state, x_n, x_trial)
        of_step = self.candidates, self.points, self.x_n, state.history
        self.pairing = EdgePairing(state.nodes, *of_step)
