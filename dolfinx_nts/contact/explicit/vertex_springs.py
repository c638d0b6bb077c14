"""Springs at vertices on edges and corners, for explicit steps."""

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.explicit.compliance import NodalProperties
from dolfinx_nts.contact.explicit.penalty import ContactSprings
from dolfinx_nts.contact.vertices import VertexState

__all__ = ["VertexSprings"]


class VertexSprings(ContactSprings):
    """Springs at vertices that are deeper below a face than the springs of the parent pair.

    A spring begins without energy at the activation depth of the vertex or, if the vertex is
    deeper, at its gap at t_n. See `add_vertices`.

    Args:
        state: State of the vertices.
        at: Properties of the owned nodes.
        parent: Springs of the parent pair, which are evaluated first.
    """

    _acts_on_areas = False

    def __init__(self, state: VertexState, at: NodalProperties, parent: ContactSprings) -> None:
        super().__init__(state, at)
        self._vertices, self._parent = state, parent

    def _begin_at(self, x: Floats) -> Floats:
        state, seen = self._vertices, self._neighbours
        history, candidates = state.history, seen.candidates
        depth = np.zeros((candidates.scatter.index_map.size_local, 3))
        depth[state.parent.nodes.nodes] = self._parent.compression[:, None]
        of_nodes = candidates.scatter.forward(depth)[:, 0]
        near = seen.current >= 0
        node, segment = seen.number[near], seen.current[near]
        least = np.fmin(state.tolerance[node], _kernels.HYSTERESIS * candidates.size[segment])
        allowed = state.tolerance.copy()
        own = depth[state.nodes.nodes[node], 0]
        allowed[node] = np.fmax(own, of_nodes[candidates.segments[segment]].max(axis=1)) + least
        return np.where(history.active, history.offset, np.fmin(-allowed, history.gap))

    def _count_lost(self, x: Floats, before: Ints, after: Ints) -> int:
        # A vertex that was pushed through a facet is released.
        return 0
