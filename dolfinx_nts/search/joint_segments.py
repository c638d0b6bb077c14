"""Segments of several searches in one array, so that kernels evaluate all pairs at once."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import Floats, GlobalInts, Ints
from dolfinx_nts.search.scatter import NodalScatter
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates

__all__ = ["JointSegments"]


class JointSegments:
    """Segments that several searches have found, one after the other. Collective.

    The joint candidates evaluate pairs. To find segments is up to those of each search, as the
    nodes of one must not face the segments of another.

    Args:
        parts: Candidates of each search, of one space and with segments of one shape.

    Attributes:
        parts: The argument.
        candidates: All of them, with one map of nodes.
        first: Number of the first segment of each part among these, shape ``(c,)``.
    """

    def __init__(self, parts: Sequence[SegmentCandidates]) -> None:
        """Join the maps of the nodes, and number the segments in them."""
        self.parts = tuple(parts)
        scatter, self._rows = _joint_map([part.scatter for part in parts])
        vertices = [
            part.segments if rows is None else rows[part.segments]
            for part, rows in zip(parts, self._rows, strict=True)
        ]
        orientation, key, size, thickness = (
            np.concatenate(arrays)
            for arrays in zip(*(part.of_segments for part in parts), strict=True)
        )
        found = FoundSegments(scatter, np.concatenate(vertices), orientation, key, size, thickness)
        self.candidates = SegmentCandidates(found)
        counts = [len(part.key) for part in parts]
        self.first: GlobalInts = np.cumsum([0, *counts[:-1]])

    def at(self, number: int, x: Floats) -> Floats:
        """Positions, ``(l, 3)``, of the nodes that the candidates of one part know. Local."""
        rows = self._rows[number]
        return x if rows is None else x[rows]

    def numbered(self, number: int, segment: Ints) -> Ints:
        """Numbers among all of segments of one part, -1 stays, of the same shape. Local."""
        joint = np.where(segment >= 0, segment + self.first[number], -1)
        return joint.astype(np.int32)


def _joint_map(scatters: Sequence[NodalScatter]) -> tuple[NodalScatter, list[Ints | None]]:
    """Map with the ghosts of all, and the nodes of each in it, None if they are the same."""
    first = scatters[0]
    if all(scatter.is_local for scatter in scatters):
        return first, [None] * len(scatters)
    maps = [scatter.index_map for scatter in scatters]
    comm: MPI.Comm = first.index_map.comm
    num_owned = first.index_map.size_local
    ghosts, place = np.unique(np.concatenate([m.ghosts for m in maps]), return_index=True)
    owners = np.concatenate([m.owners for m in maps])[place]
    joint = compat.index_map(comm, num_owned, ghosts, owners)
    own = np.arange(num_owned, dtype=np.int32)
    rows: list[Ints | None] = [
        np.concatenate([own, num_owned + np.searchsorted(ghosts, m.ghosts)]).astype(np.int32)
        for m in maps
    ]
    return NodalScatter(joint, is_local=False), rows
