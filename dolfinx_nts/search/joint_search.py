"""Joint search of several pairs, each with its own segments."""

from collections.abc import Sequence
from operator import is_not

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.common.parts import largest_of_parts
from dolfinx_nts.model.frames import Frame
from dolfinx_nts.model.obstacles.rims import is_nearest_a_rim
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.points import ContactPoints
from dolfinx_nts.search.scatter import joint_scatter
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates

__all__ = ["JointCandidates", "JointSearch"]


class JointSearch:
    """Joint search with segments of one space and one shape. Collective.

    One reduction decides which searches must be renewed.

    Args:
        comm: Communicator.
        searches: The ``c`` searches.
        shorter: Reduction of the search radius of each search, shape ``(c,)`` [m].

    Attributes:
        frame: Space.
        candidates: The candidates of the last update.
    """

    frame = Frame()
    candidates: "JointCandidates"

    def __init__(self, comm: MPI.Comm, searches: Sequence[GlobalSearch], shorter: Floats) -> None:
        self._comm, self._searches, self._shorter = comm, tuple(searches), shorter
        # Nodes of all searches, then vertices of all, and offsets of each.
        rows = [rows for side in zip(*(s.rows for s in searches), strict=True) for rows in side]
        self._rows, self._ends = np.concatenate(rows), np.cumsum([0, *map(len, rows)])
        # Search ranges, see `GlobalSearch.covered`, of each search and in joint arrays.
        self._known: list[tuple[Floats, Floats, float] | None] = []
        self._before: Floats = np.zeros((len(self._rows), 3))
        self._covered: Floats = np.empty(0)

    @property
    def initial_depth(self) -> float:
        """Depth up to which initially penetrating nodes get segments [m]. Local."""
        return max(search.initial_depth for search in self._searches)

    def update(self, x: Floats, reach: float) -> tuple["JointCandidates", bool]:
        """Update the candidates of all searches. Collective."""
        is_new = self._recall()
        stale = ~(self._approach(x) + reach - self._shorter <= self._covered)
        if stale.any():
            for i in map(int, stale.nonzero()[0]):
                self._searches[i].renew(x, reach - float(self._shorter[i]))
            is_new = self._recall()
        if is_new:
            parts = [search.candidates for search in self._searches]
            num_nodes = [len(search.rows[0]) for search in self._searches]
            in_dents = any(search.in_dents for search in self._searches)
            self.candidates = JointCandidates(parts, num_nodes, self._shorter, in_dents)
        return self.candidates, is_new

    def _recall(self) -> bool:
        """Store the positions and reach of all searches; return whether any has changed. Local."""
        covered = [search.covered for search in self._searches]
        if len(self._known) == len(covered) and not any(map(is_not, covered, self._known)):
            return False
        self._known = covered
        self._covered = np.array([-np.inf if each is None else each[2] for each in covered])
        for number, each in enumerate(covered):
            for side, place in enumerate((number, len(covered) + number)):
                if each is not None:
                    self._before[self._ends[place] : self._ends[place + 1]] = each[side]
        return True

    def _approach(self, x: Floats) -> Floats:
        """Bounds of `Search.approach` since each search, shape ``(c,)`` [m]."""
        moved = x.take(self._rows, axis=0) - self._before
        distances = np.sqrt(np.einsum("ij,ij->i", moved, moved))
        farthest = reductions.largest(self._comm, largest_of_parts(distances, self._ends))
        sums: Floats = farthest.reshape(2, -1).sum(axis=0)
        return sums


class JointCandidates(SegmentCandidates):
    """Segments of several searches, in groups, with one map of nodes. Collective.

    Points are the nodes of all searches, search by search.

    Args:
        parts: Candidates of each of ``c`` searches.
        num_nodes: Number of nodes of each search.
        shorter: Reduction of the search radius of each search, shape ``(c,)`` [m].
        in_dents: See `FoundSegments`.
    """

    def __init__(
        self,
        parts: Sequence[SegmentCandidates],
        num_nodes: Sequence[int],
        shorter: Floats,
        in_dents: bool,
    ) -> None:
        scatter, rows = joint_scatter([part.scatter for part in parts])
        vertices = [
            part.segments if own is None else own[part.segments]
            for part, own in zip(parts, rows, strict=True)
        ]
        orientation, key, size, thickness = (
            np.concatenate(some) for some in zip(*(p.of_segments for p in parts), strict=True)
        )
        found = FoundSegments(scatter, np.concatenate(vertices), orientation, key, size, thickness)
        found = found._replace(in_dents=in_dents)
        self._first: Ints = np.cumsum([0, *(len(part.key) for part in parts)]).astype(np.int32)
        super().__init__(found, self._first)
        self._group: Ints = np.repeat(np.arange(len(parts), dtype=np.int32), num_nodes)
        self._shorter = shorter
        self.initial_depth = np.concatenate([part.initial_depth for part in parts])

    def find(self, key: GlobalInts) -> Ints:
        return self._kernel.find(key, self._group)

    def near(self, points: ContactPoints, x: Floats, reach: float) -> Ints:
        return self._kernel.near(points.of(x), reach, x, self._group[points.facing.numbers])

    def is_at_rim(self, points: ContactPoints, x: Floats, segment: Ints) -> Flags:
        flags = np.zeros(len(segment), dtype=bool)
        group = np.searchsorted(self._first, segment, side="right") - 1
        for number in np.unique(group):
            (own,), first = (group == number).nonzero(), self._first[number]
            facets = self.segments[first : self._first[number + 1]]
            flags[own] = is_nearest_a_rim(points.of(x)[own], x, facets, segment[own] - first)
        return flags

    def _of_groups(self, reach: float) -> Floats | float:
        return reach - self._shorter
