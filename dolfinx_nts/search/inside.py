"""Which points lie inside closed boundaries of bodies, and how deep, on any number of ranks."""

from collections.abc import Iterator, Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.model.closed_boundaries import ClosedBoundary, triangles_at
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined

__all__ = ["Insides", "all_rows"]


class Insides:
    """The insides of closed boundaries that move.

    Every rank has some triangles of a boundary, and all ranks ask for the same points. Rays are
    counted, and solid angles summed, over the triangles of all ranks. Collective.

    Args:
        comm: Communicator.
        boundaries: The boundaries.
    """

    def __init__(self, comm: MPI.Comm, boundaries: Sequence[ClosedBoundary]) -> None:
        """Begin without trees, which are built where points are asked for."""
        self._comm, self._boundaries = comm, boundaries
        self._trees: dict[int, _kernels.Boundary] = {}

    def move(self, x: Floats) -> None:
        """Go on at other positions of the local nodes, shape ``(l, 3)`` [m]. Local."""
        self._x, self._moved = x, set(self._trees)

    def depth(self, points: Floats, where: Ints, least: Floats) -> Floats:
        """Tell how deep points are inside. Collective.

        Args:
            points: Positions, the same on all ranks, shape ``(m, 3)`` [m].
            where: Number of the boundary of interest for each point, shape ``(m,)``.
            least: Depth of each point up to which it is on the boundary, ``(m,)`` [m].

        Returns:
            Distance from the boundary, 0 on it and outside, the same on all ranks, shape
            ``(m,)`` [m].
        """
        if not len(points):
            return np.zeros(0)  # everywhere, as all ranks ask for the same
        crossings = np.zeros((2, len(points)), dtype=np.int32)
        for tree, some in self._trees_of(where, all_rows(points)):
            crossings[:, some] = tree.crossings(points[some])
        crossings = reductions.total(self._comm, crossings)
        count, at_an_edge = crossings
        some = _numbers((count > 0) | (at_an_edge > 0))
        distance = np.full(len(points), np.inf)
        for tree, here in self._trees_of(where, some):
            distance[here] = tree.distance(points[here], least[here])
        distance = reductions.least(self._comm, distance)
        inside = (count > 0) & (distance > least)
        # Rays from points on the boundary often hit edges, others hardly ever.
        unsure = _numbers((at_an_edge > 0) & (distance > least))
        if len(unsure):
            winding = np.zeros(len(points))
            for tree, here in self._trees_of(where, unsure):
                winding[here] = tree.winding(points[here])
            inside[unsure] = reductions.total(self._comm, winding)[unsure] > 0.5
        return np.where(inside, distance, 0.0)

    def chords(self, ways: Floats, where: Ints) -> tuple[Floats, Ints]:
        """Find the middles of the parts into which boundaries cut straight ways. Collective.

        Args:
            ways: Begin and end of each way, the same on all ranks, shape ``(w, 6)`` [m].
            where: Number of the boundary of interest for each way, shape ``(w,)``.

        Returns:
            Middles, the same on all ranks, shape ``(c, 3)`` [m], and the way of each, ``(c,)``.
            Ways that meet no boundary have none.
        """
        rows: list[Floats] = [np.empty((2, 0))]
        for tree, some in self._trees_of(where, all_rows(ways)):
            way, place = tree.cuts(ways[some])
            rows.append(np.stack([some[way], place]))
        way, place = joined(self._comm, np.concatenate(rows, axis=1).T).T
        return _kernels.parts_of_ways(ways, way.astype(np.int32), np.ascontiguousarray(place))

    def _trees_of(self, where: Ints, some: Ints) -> Iterator[tuple[_kernels.Boundary, Ints]]:
        """Boundaries of some points, and which of these belong to each."""
        for number in map(int, np.flatnonzero(np.bincount(where[some]))):
            triangles = self._boundaries[number].triangles
            if number not in self._trees:
                self._trees[number] = _kernels.Boundary(triangles_at(self._x, triangles))
            elif number in self._moved:
                self._moved.remove(number)
                self._trees[number].move(triangles_at(self._x, triangles))
            yield self._trees[number], some[where[some] == number]


def all_rows(rows: Floats) -> Ints:
    """Numbers of all rows. Local."""
    return np.arange(len(rows), dtype=np.int32)


def _numbers(flags: Flags) -> Ints:
    """Numbers of the rows with a flag."""
    return np.flatnonzero(flags).astype(np.int32)
