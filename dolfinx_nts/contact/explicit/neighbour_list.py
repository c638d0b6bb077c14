"""Nodes of a contact pair that may touch soon: all that explicit steps look at."""

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import SegmentCandidates
from dolfinx_nts.search.obstacle_candidates import ObstacleCandidates

__all__ = ["NeighbourList"]


# Parts of a segment: a node so far from it or so deep in it belongs to it, and so
# far it may get before the next look, which is made when most of that is used. The
# margin is no less than the reach, or nodes deep inside would not be looked at.
_REACH, _MARGIN, _USED = 0.5, 0.5, 0.75


class NeighbourList:
    """Nodes that may touch before the next look. Collective, as its methods.

    Args:
        pair: The pair.

    Attributes:
        candidates: Segments in reach.
        number: The nodes by their positions in the surface's, shape ``(c,)``.
        nodes: The same by their numbers, shape ``(c,)``.
        stiffness: Of their springs, shape ``(c,)`` [N/m].
        current: Their last segments or -1, shape ``(c,)``; set by who
            pairs them.
        is_idle: Whether there are none on any rank.
    """

    candidates: SegmentCandidates | ObstacleCandidates
    number: Ints
    nodes: Ints
    stiffness: Floats
    current: Ints
    is_idle = False

    def __init__(self, pair: ContactPair) -> None:
        """Look at the first update."""
        self._pair = pair
        self._comm: MPI.Comm = pair.nodes.V.mesh.comm
        self._places: tuple[Floats, Floats]  # of all nodes and vertices at the last look
        self.forget()

    def forget(self) -> None:
        """Look again at the next update: the state was set."""
        self._travelled = np.inf

    @property
    def reach(self) -> float:
        """Distance at which nodes are paired [m]."""
        return _REACH * self._pair.segment_size

    def update(self, x: Floats, step: float) -> None:
        """Look around, if nodes may have come near since the last look.

        Args:
            x: Positions of the local nodes, shape ``(l, 3)`` [m].
            step: Largest motion of any node since the last update, the
                same on all ranks [m].
        """
        self._travelled += 2 * step
        margin = _MARGIN * self._pair.segment_size
        if self._travelled <= margin:
            return
        # The bound is crude, as most bodies fly the same way.
        if np.isfinite(self._travelled):
            self._travelled = self._pair.search.approach(x, self._places)
        if self._travelled > _USED * margin:
            self._rebuild(x)

    def serialize(self, archive: Archive, name: str, x: Floats) -> None:
        """Serialize what was seen. After the pair.

        Args:
            archive: Takes it or gives it.
            name: Name of the values.
            x: As of `update`.
        """
        seen: Sequence[Any] | None = None
        if not archive.giving and np.isfinite(self._travelled):
            seen = [self.number, np.array([self._travelled, self.is_idle]), *self._places]
        seen = archive.local(name, seen)
        if not archive.giving:
            return
        if seen is None:
            self._rebuild(x)
            return
        number, (travelled, is_idle), nodes, vertices = seen
        self._travelled, self.is_idle = float(travelled), bool(is_idle)
        self._places = nodes, vertices
        candidates = self._pair.search.candidates
        self._choose(candidates, number, candidates.find(self._pair.history.key))

    def _rebuild(self, x: Floats) -> None:
        pair = self._pair
        candidates, _ = pair.search.update(x, (_REACH + _MARGIN) * pair.segment_size)
        if np.isinf(self._travelled):
            current = candidates.find(pair.history.key)
        else:
            current = np.full(len(pair.nodes.nodes), -1, dtype=np.int32)
            current[self.number] = self._current_in(candidates)
        self._travelled, self._places = 0.0, pair.search.places(x)
        x = candidates.with_ghosts(x[: candidates.index_map.size_local])
        near = candidates.near(x, pair.nodes.nodes, _MARGIN * pair.segment_size)
        self._choose(candidates, near, current)
        self.is_idle = not reductions.total(self._comm, len(near))

    def _current_in(self, candidates: SegmentCandidates | ObstacleCandidates) -> Ints:
        """Last segments of the nodes in a neighbourhood or -1, shape ``(c,)``."""
        if candidates is self.candidates:
            return self.current
        found = self.current >= 0
        segment: Ints = np.full(len(found), -1, dtype=np.int32)
        segment[found] = candidates.find(self.candidates.key[self.current[found]])
        return segment

    def _choose(
        self, candidates: SegmentCandidates | ObstacleCandidates, number: Ints, current: Ints
    ) -> None:
        """Take some nodes.

        Args:
            candidates: Segments in reach.
            number: The nodes.
            current: Last segment of each node of the surface or -1.
        """
        pair = self._pair
        assert pair.eps_N is not None
        self.candidates, self.number, self.current = candidates, number, current[number]
        self.nodes, self.stiffness = pair.nodes.nodes[number], pair.eps_N[number]
