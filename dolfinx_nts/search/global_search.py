"""Global search: segments within the search radius of the nodes of this rank.

Every rank owns some nodes of one surface and some segments of the other. Before a step, ranks
send each other the segments near the bounding boxes of their nodes. The vertices of received
segments become ghosts of an index map, which scatters positions and gathers forces.
"""

from typing import Any

import numpy as np
from dolfinx import common

from dolfinx_nts import compat
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.segments import diameters
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel.communication import exchanged
from dolfinx_nts.search.candidates import Search
from dolfinx_nts.search.scatter import NodalScatter
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates

__all__ = ["GlobalSearch", "owners_of"]


class GlobalSearch(Search):
    """Search for segments near the nodes of another surface, see `Search`. Collective.

    Args:
        nodes: Surface of the nodes.
        segments: Surface of the segments.

    Attributes:
        covered: `positions` at the last search, and its reach [m]; None before the first.
    """

    candidates: SegmentCandidates
    # Whether points below concave edges keep a segment. A multiplier keeps the gap to one segment:
    # where gaps to several segments differ, a node would penetrate deeper with each change of its
    # segment.
    in_dents = False
    # Search radius relative to the requested one [-]. Larger: fewer exchanges between ranks;
    # smaller: fewer candidates.
    _margin = 3.0
    # Global numbers and owners of nodes that are needed in addition to vertices of segments.
    _others: tuple[GlobalInts, Ints] = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int32)
    # Weights of the nodes of smooth segments in their control points.
    _weights: tuple[Floats, ...] = ()

    def __init__(self, nodes: Surface, segments: Surface) -> None:
        super().__init__(nodes, np.unique(segments.segments))
        self._segments = segments
        space, vertices = segments.V.dofmap.index_map, segments.segments
        ids = space.local_to_global(vertices.ravel()).reshape(vertices.shape)
        owners = owners_of(space, vertices)
        # Arrays of the data of a segment that are sent, except its size.
        self._offer = (ids, owners, segments.orientation, segments.key, segments.thickness)
        self.covered: tuple[Floats, Floats, float] | None = None

    @property
    def num_vertices(self) -> int:
        """Number of vertices of a segment. Local."""
        return int(self._segments.segments.shape[1])

    def update(self, x: Floats, reach: float) -> tuple[SegmentCandidates, bool]:
        """Find all segments within the search radius of a node, see `Search.update`. Collective.

        The last candidates are kept as long as no motion exceeds the margin of the last search;
        with an infinite radius they are always kept.
        """
        if self.covered is not None:
            *before, covered = self.covered
            if np.isinf(covered) or self.approach(x, before) + reach <= covered:
                return self.candidates, False
        self.renew(x, reach)
        return self.candidates, True

    def renew(self, x: Floats, reach: float) -> None:
        """Search again, with the arguments of `update`. Collective."""
        reach *= self._margin
        self.candidates = self._find(x, reach)
        self.candidates.initial_depth = np.array([self.initial_depth])
        self.covered = (*self.positions(x), reach)
        self.num_searches += 1

    def set_initial_depth(self, depth: float) -> None:
        """Set the depth up to which initially penetrating nodes get segments [m]. Local."""
        if depth != self.initial_depth:
            self.initial_depth, self.covered = depth, None

    def serialize(self, archive: Archive, name: str) -> None:
        covered = self.covered
        arrays = None if covered is None else (*covered[:2], np.array(covered[2]))
        stored = archive.local(name, arrays)
        if not archive.restores:
            return
        self.covered = None
        if stored is not None:
            x_nodes, x_vertices, reach = stored
            self.covered = (x_nodes, x_vertices, float(reach))
            x = np.zeros((len(reference_positions(self._nodes.V)), 3))
            x[self._nodes.nodes], x[self._vertices] = x_nodes, x_vertices
            self.candidates = self._find(x, float(reach))
            self.candidates.initial_depth = np.array([self.initial_depth])

    def _find(self, x: Floats, reach: float) -> SegmentCandidates:
        space = self._segments.V.dofmap.index_map
        comm = self._comm

        box = _box(x[self._nodes.nodes], reach)
        # A single rank needs no communication.
        boxes = np.array(comm.allgather(box) if comm.size > 1 else [box])
        x_vertex = self._offered(x)  # the first axis is reduced, which is faster
        near = _near(x_vertex.min(axis=0), x_vertex.max(axis=0), boxes, comm.rank)
        size = diameters(x_vertex.swapaxes(0, 1))
        mine = (*self._offer, size, *self._weights)
        parts = {rank: tuple(values[n] for values in mine) for rank, n in near.items()}
        ids, owners, orientation, key, thickness, size, *weights = map(
            np.concatenate, zip(*exchanged(comm, parts).values(), strict=True)
        )
        order = np.argsort(key)
        shape, num_others = ids.shape, len(self._others[0])
        ids = np.concatenate([ids[order].ravel(), self._others[0]])
        owners = np.concatenate([owners[order].ravel(), self._others[1]])

        first, last = space.local_range
        local = ids - first
        if comm.size > 1:
            remote = (ids < first) | (ids >= last)
            ghosts, place = np.unique(ids[remote], return_inverse=True)
            ghost_owners = np.empty(len(ghosts), dtype=np.int32)
            ghost_owners[place] = owners[remote]
            local[remote] = last - first + place
            space = compat.index_map(comm, space.size_local, ghosts, ghost_owners)
        scatter = NodalScatter(space)
        values = (orientation, key, size, thickness, *weights)
        vertices, others = np.split(local.astype(np.int32), [len(local) - num_others])
        arrays: list[Any] = [each[order] for each in values]
        found = FoundSegments(scatter, vertices.reshape(shape), *arrays)
        found = found._replace(in_dents=self.in_dents)
        return self._make(found, others, x, reach)

    def _offered(self, x: Floats) -> Floats:
        """Positions of the vertices of the segments of this rank, ``(k, s, 3)`` [m]. Collective."""
        vertices: Floats = x[self._segments.segments.T]
        return vertices

    def _make(
        self, found: FoundSegments, others: Ints, x: Floats, reach: float
    ) -> SegmentCandidates:
        """Create the candidates from segments found within ``reach`` [m] at x. Collective.

        ``others`` are local numbers of additional nodes on which the candidates depend.
        """
        return SegmentCandidates(found)


def _box(x: Floats, reach: float) -> Floats:
    """Bounding box of points with a margin, shape (2, 3) [m]; empty if there is no point."""
    if len(x) == 0:
        return np.repeat([[np.inf], [-np.inf]], 3, axis=1)
    return np.array([x.min(axis=0) - reach, x.max(axis=0) + reach])


def _near(lower: Floats, upper: Floats, boxes: Floats, own: int) -> dict[int, Flags]:
    """Segments in the bounding box of each rank, always with an entry for this rank.

    Args:
        lower: Least coordinates of ``s`` segments, shape ``(s, 3)`` [m].
        upper: Greatest coordinates, shape ``(s, 3)`` [m].
        boxes: Box of each rank, shape ``(ranks, 2, 3)`` [m].
        own: Number of this rank.

    Returns:
        Flags by rank, shape ``(s,)``.
    """
    least, greatest = lower.min(axis=0, initial=np.inf), upper.max(axis=0, initial=-np.inf)
    meet = np.all((least <= boxes[:, 1]) & (greatest >= boxes[:, 0]), axis=1)
    near = {}
    for rank in {own, *map(int, np.flatnonzero(meet))}:
        flags: Flags = np.all((lower <= boxes[rank, 1]) & (upper >= boxes[rank, 0]), axis=1)
        if rank == own or flags.any():
            near[rank] = flags
    return near


def owners_of(index_map: common.IndexMap, nodes: Ints) -> Ints:
    """Owning ranks of local indices, of the same shape. Local."""
    owners: Ints = np.full(nodes.shape, index_map.comm.rank, dtype=np.int32)
    is_ghost = nodes >= index_map.size_local
    owners[is_ghost] = index_map.owners[nodes[is_ghost] - index_map.size_local]
    return owners
