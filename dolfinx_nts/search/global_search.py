"""Global search: the segments that the nodes of this rank can reach.

Every rank owns some nodes of one surface and some segments of the other.
Before a step, ranks send each other the segments that come near the
bounding box of their nodes; the vertices of what arrived become ghosts of
an index map, which then carries positions to the contacts and forces back.
"""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
from dolfinx import common

from dolfinx_nts import _kernels, compat
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, GlobalInts, Ints
from dolfinx_nts.model.surfaces import Surface, diameters
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import exchanged
from dolfinx_nts.search.scatter import NodalScatter
from dolfinx_nts.search.segment_candidates import SegmentCandidates

__all__ = ["GlobalSearch"]


class GlobalSearch:
    """Finds the segments that nodes of another surface can reach, see `Search`.

    Args:
        nodes: Surface whose nodes look for segments.
        segments: Surface that offers segments.

    Attributes:
        num_searches: How often segments were sent around.
    """

    def __init__(self, nodes: Surface, segments: Surface) -> None:
        """Start without a candidates."""
        self._nodes, self._segments = nodes, segments
        self._vertices = np.unique(segments.segments)
        space, vertices = segments.V.dofmap.index_map, segments.segments
        ids = space.local_to_global(vertices.ravel()).reshape(vertices.shape)
        owners = _owners(space, segments.V.mesh.comm)[vertices]
        # What is sent of a segment, but for its size.
        self._offer = (ids, owners, segments.orientation, segments.key, segments.thickness)
        self._covered: tuple[Floats, Floats, float] | None = None
        self._candidates: SegmentCandidates | None = None
        self.num_searches = 0

    def update(self, x: Floats, reach: float) -> tuple[SegmentCandidates, bool]:
        """SegmentCandidates that holds every segment within reach of a node.

        Collective. The last one is kept while nothing has moved more
        than the margin with which it was made; for ever if it reaches
        everywhere.

        Args:
            x: Current positions of the local nodes of the space, owned
                and ghost, shape ``(n, 3)`` [m].
            reach: Distance from a node to be covered [m].

        Returns:
            The candidates, and whether it is a new one.
        """
        if self._candidates is not None and self._covered is not None:
            *before, covered = self._covered
            if np.isinf(covered) or self.approach(x, before) + reach <= covered:
                return self._candidates, False
        # Three times as much saves exchanges and costs a few segments.
        reach *= 3
        self._covered = (*self.positions(x), reach)
        self._candidates = self._find(x, reach)
        self.num_searches += 1
        return self._candidates, True

    def positions(self, x: Floats) -> tuple[Floats, Floats]:
        """Positions of this rank's nodes and vertices, for `approach`. Local.

        Args:
            x: As of `update`.
        """
        return x[self._nodes.nodes], x[self._vertices]

    def approach(self, x: Floats, before: Sequence[Floats]) -> float:
        """By how much any node and segment may be closer than they were [m]. Collective.

        Args:
            x: As of `update`.
            before: `positions` then.
        """
        ways = zip((self._nodes.nodes, self._vertices), before, strict=True)
        moved = [_kernels.farthest(x.take(rows, axis=0), there) for rows, there in ways]
        # A node and a vertex of different ranks may approach each other.
        return sum(reductions.largest(self._nodes.V.mesh.comm, moved))

    @property
    def candidates(self) -> SegmentCandidates:
        """The last candidates."""
        assert self._candidates is not None
        return self._candidates

    def serialize(self, archive: Archive, name: str) -> None:
        """Serialize where the candidates was made. Collective."""
        covered = self._covered
        arrays = None if covered is None else (*covered[:2], np.array(covered[2]))
        stored = archive.local(name, arrays)
        if not archive.giving:
            return
        self._covered = self._candidates = None
        if stored is not None:
            x_nodes, x_vertices, reach = stored
            self._covered = (x_nodes, x_vertices, float(reach))
            x = np.zeros((len(self._nodes.V.tabulate_dof_coordinates()), 3))
            x[self._nodes.nodes], x[self._vertices] = x_nodes, x_vertices
            self._candidates = self._find(x, float(reach))

    def _find(self, x: Floats, reach: float) -> SegmentCandidates:
        space = self._segments.V.dofmap.index_map
        comm = self._segments.V.mesh.comm
        vertices = self._segments.segments

        box = _box(x[self._nodes.nodes], reach)
        # One rank has nobody to ask, and asking itself takes as long as all the rest.
        boxes = np.array(comm.allgather(box) if comm.size > 1 else [box])
        x_vertex = x[vertices.T]  # reduced along the first axis, which is faster
        lower, upper = x_vertex.min(axis=0), x_vertex.max(axis=0)
        near = np.all((lower <= boxes[:, None, 1]) & (upper >= boxes[:, None, 0]), axis=2)
        size = diameters(x_vertex.swapaxes(0, 1))
        mine = (*self._offer, size)
        parts = exchanged(comm, [tuple(values[n] for values in mine) for n in near])
        ids, owners, orientation, key, thickness, size = (
            np.concatenate([part[i] for part in parts]) for i in range(len(mine))
        )
        order = np.argsort(key)
        ids, owners = ids[order], owners[order]

        first, last = space.local_range
        local = ids - first
        if comm.size > 1:
            remote = (ids < first) | (ids >= last)
            ghosts, place = np.unique(ids[remote], return_inverse=True)
            ghost_owners = np.empty(len(ghosts), dtype=np.int32)
            ghost_owners[place] = owners[remote]
            local[remote] = last - first + place
            space = compat.index_map(comm, space.size_local, ghosts, ghost_owners)
        return self._make(
            NodalScatter(space, is_local=comm.size == 1),
            local.astype(np.int32),
            orientation[order],
            key[order],
            size[order],
            thickness[order],
        )

    def _make(
        self,
        scatter: NodalScatter,
        segments: Ints,
        orientation: Floats,
        key: GlobalInts,
        size: Floats,
        thickness: Floats,
    ) -> SegmentCandidates:
        """Make the candidates of segments that were found."""
        return SegmentCandidates(scatter, segments, orientation, key, size)


def _box(x: Floats, reach: float) -> Floats:
    """Inflated bounding box (2, 3) of points; empty if there is no point."""
    if len(x) == 0:
        return np.repeat([[np.inf], [-np.inf]], 3, axis=1)
    return np.array([x.min(axis=0) - reach, x.max(axis=0) + reach])


def _owners(index_map: common.IndexMap, comm: MPI.Comm) -> Ints:
    """Owning rank of each local index."""
    own = np.full(index_map.size_local, comm.rank, dtype=np.int32)
    return np.concatenate([own, index_map.owners])
