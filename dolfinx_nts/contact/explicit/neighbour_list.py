"""Neighbour list of explicit steps: the nodes of a pair that may touch soon.

As in molecular dynamics (Verlet), the list has a margin and is rebuilt when nodes and segments
may have approached each other by most of it.
"""

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.search.points import NodalPoints

__all__ = ["NeighbourList"]

# Gap, relative to the size of a segment [-], up to which a node is paired with it.
_REACH = 0.5
# Approach of nodes and segments after which the list is rebuilt, relative to the size of a segment
# [-]. It must not be less than the reach, or deep nodes would be missing. Larger values give longer
# lists, smaller ones more searches.
_MARGIN = 0.5
# Part of the margin [-] after which the list is rebuilt. Closer to 1, the motion of all nodes has
# to be measured in many steps.
_USED = 0.75


class NeighbourList:
    """Nodes that may touch before the list is rebuilt. Collective, as are its methods.

    Args:
        state: State of the contact pair, whose springs have been chosen at the first update.

    Attributes:
        candidates: Candidates in reach.
        number: Indices of listed nodes among the nodes of the surface, shape ``(c,)``.
        points: Their contact points, with the normals of the last search.
        stiffness: Stiffness of their springs, shape ``(c,)`` [N/m].
        current: Their current segments or -1, shape ``(c,)``; set by the caller after pairing.
        is_idle: Whether no node is listed on any rank.
    """

    candidates: Candidates
    number: Ints
    points: NodalPoints
    stiffness: Floats
    current: Ints
    is_idle = False

    def __init__(self, state: PairState) -> None:
        self._state = state
        self._comm: MPI.Comm = state.nodes.V.mesh.comm
        # Positions of nodes and vertices at the last search.
        self._positions: tuple[Floats, Floats]
        self.forget()

    def forget(self) -> None:
        """Rebuild the list at the next update, after the state was set. Local."""
        self._travelled = np.inf

    @property
    def reach(self) -> float:
        """Gap up to which nodes are paired [m]. Local."""
        return _REACH * self._state.pair.segment_size + self._state.search.sunk

    def update(self, x: Floats, step: float) -> None:
        """Rebuild the list if nodes that are not listed may touch.

        Args:
            x: Positions of the local nodes in the frame of the search, shape ``(l, 3)`` [m].
            step: Half the bound on the approach of nodes and segments since the last update [m].
        """
        self._travelled += 2 * step
        margin = _MARGIN * self._state.pair.segment_size
        if self._travelled <= margin:
            return
        # The sum of steps is a crude bound, since most nodes move in the same direction.
        if np.isfinite(self._travelled):
            self._travelled = self._state.search.approach(x, self._positions)
        if self._travelled > _USED * margin:
            self._rebuild(x)

    def serialize(self, archive: Archive, name: str, x: Floats) -> None:
        arrays: Sequence[Any] | None = None
        if not archive.giving and np.isfinite(self._travelled):
            arrays = [self.number, np.array([self._travelled, self.is_idle]), *self._positions]
        arrays = archive.local(name, arrays)
        if not archive.giving:
            return
        if arrays is None:
            self._rebuild(x)
            return
        number, (travelled, is_idle), nodes, vertices = arrays
        self._travelled, self.is_idle = float(travelled), bool(is_idle)
        self._positions = nodes, vertices
        candidates = self._state.search.candidates
        points = self._state.facets.points(x)
        self._choose(candidates, points, number, candidates.find(self._state.history.key))

    def _rebuild(self, x: Floats) -> None:
        state, margin = self._state, _MARGIN * self._state.pair.segment_size
        candidates, _ = state.search.update(x, self.reach + margin)
        if np.isinf(self._travelled):
            current = candidates.find(state.history.key)
        else:
            current = np.full(len(state.nodes.nodes), -1, dtype=np.int32)
            current[self.number] = self._current_in(candidates)
        self._travelled, self._positions = 0.0, state.search.positions(x)
        points = state.facets.points(x)
        near = candidates.near(points, candidates.scatter.forward(x), margin + state.search.sunk)
        self._choose(candidates, points, near, current)
        self.is_idle = not reductions.total(self._comm, len(near))

    def _current_in(self, candidates: Candidates) -> Ints:
        """Last segments of the listed nodes among candidates, or -1, shape ``(c,)``."""
        if candidates is self.candidates:
            return self.current
        found = self.current >= 0
        segment: Ints = np.full(len(found), -1, dtype=np.int32)
        segment[found] = candidates.find(self.candidates.key[self.current[found]])
        return segment

    def _choose(
        self, candidates: Candidates, points: NodalPoints, number: Ints, current: Ints
    ) -> None:
        """List nodes of the surface by ``number``, with their last segments or -1."""
        state = self._state
        assert state.eps_N is not None
        self.candidates, self.number, self.current = candidates, number, current[number]
        self.points, self.stiffness = points.take(number), state.eps_N[number]
