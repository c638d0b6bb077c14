"""Passes of contact: pairs of a stepper, some with exchanged roles.

With springs at nodes of both sides, as in `two_half_passes`, the force is the sum over both pairs.
"""

import weakref
from collections.abc import Callable

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.method import EDGES, NODES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["ForcesOfNodes", "Passes"]

# Returns forces on the nodes of a pass from its accepted contact, shape ``(n, 3)`` [N].
ForcesOfNodes = Callable[[ContactHistory], Floats]
_ForcesOnSegments = Callable[[ForcesOfNodes], Floats]


class Passes:
    """All passes of a stepper in the order of its pairs. Local.

    Args:
        positions: Returns the positions of the local nodes after the last step, ``(l, 3)`` [m].
        time: Returns the time after the last step [s].
        body_of_nodes: Number of the body of each owned node of the space, ``(n,)``; None if
            unknown.

    Attributes:
        positions, time: The arguments.
    """

    def __init__(
        self,
        positions: Callable[[], Floats],
        time: Callable[[], float],
        body_of_nodes: Ints | None = None,
    ) -> None:
        self.positions, self.time, self._body_of_nodes = positions, time, body_of_nodes
        self._sharing: weakref.WeakKeyDictionary[ContactPair, bool] = weakref.WeakKeyDictionary()
        # Weak references avoid cycles, which would be collected at different times on each rank.
        self._all: list[tuple[ContactPair, weakref.WeakMethod[_ForcesOnSegments]]] = []

    def sharing_bodies(self, pair: ContactPair) -> Ints | None:
        """Number of the body of each owned node, if several bodies share the reactions to a force.

        Several bodies share reactions in mortar contact with segments of several bodies, and in
        contact of edges of several bodies. Otherwise the result is None. Collective.
        """
        body, segments = self._body_of_nodes, pair.segments
        if body is None or pair.method == NODES or not isinstance(segments, Surface):
            return None
        if pair not in self._sharing:
            comm, there = segments.V.mesh.comm, body[segments.nodes].astype(np.float64)
            first = reductions.least(comm, float(there.min(initial=np.inf)))
            last = reductions.largest(comm, float(there.max(initial=-np.inf)))
            self._sharing[pair] = first < last
        return body if self._sharing[pair] else None

    def join(self, pair: ContactPair, forces_on_segments: _ForcesOnSegments) -> None:
        """Add a pass.

        Args:
            pair: The pair.
            forces_on_segments: Returns the reactions of forces on its nodes on the vertices of its
                segments, as values at the owned nodes of the space, shape ``(n, 3)`` [N].
                Collective.
        """
        self._all.append((pair, weakref.WeakMethod(forces_on_segments)))

    def forces_on_nodes_of(self, pair: ContactPair, of_nodes: ForcesOfNodes) -> list[Floats]:
        """Forces of all passes opposite to a pair, on the nodes of the pair. Collective.

        ``of_nodes`` returns the forces on the nodes of these passes. Each item has values at the
        owned nodes of the space, shape ``(n, 3)`` [N].
        """
        passes = [(other, method) for other, ref in self._all if (method := ref()) is not None]
        return [
            forces_on_segments(of_nodes)
            for other, forces_on_segments in passes
            if (other.nodes, other.segments) == (pair.segments, pair.nodes)
            and other.method == pair.method != EDGES
        ]
