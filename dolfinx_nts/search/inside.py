"""Which points lie inside closed boundaries of bodies, and how deep, on any number of ranks."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.closed_boundaries import ClosedBoundary, raised, wall_height, walls
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined

__all__ = ["Insides"]

# From what the minimum over ranks is taken of to least and greatest coordinates.
_SIGNS = np.array([[[1.0]], [[-1.0]]])


class Insides:
    """The insides of closed boundaries that move.

    Those in the plane are walls, which are so high that nothing sees their ends.

    Every rank has some triangles of a boundary, and all ranks ask for the same points. Rays are
    counted, and solid angles summed, over the triangles of all ranks. Collective.

    Args:
        comm: Communicator.
        boundaries: The boundaries.
    """

    def __init__(self, comm: MPI.Comm, boundaries: Sequence[ClosedBoundary]) -> None:
        self._comm = comm
        # Trees over the triangles are built or moved where points are asked for.
        nodes = [boundary.nodes for boundary in boundaries]
        triangles = [boundary.triangles for boundary in boundaries]
        self._height = 0.0
        if triangles[0].shape[1] == 2:
            X = reference_positions(boundaries[0].bodies[0].V)
            self._height = max(wall_height(comm, X[some]) for some in nodes)
            nodes = [np.concatenate([some, some + np.int32(len(X))]) for some in nodes]
            triangles = [walls(edges, len(X)) for edges in triangles]
        self._kernels = _kernels.Boundaries(nodes, triangles)
        self._boxes: Floats = np.empty((2, 0, 3))

    def move(self, x: Floats) -> None:
        """Go on at other positions of the local nodes, shape ``(l, 3)`` [m]. Collective."""
        self._kernels.move(self._in_space(x))
        # Least and greatest coordinates of all nodes, shape (2, g, 3) [m].
        self._boxes = self._extremes(self._kernels.extents())

    def diameter(self, number: int) -> float:
        """Longest distance within a boundary, about [m]. Local."""
        return float(np.linalg.norm(self._boxes[1, number] - self._boxes[0, number]))

    def displacements(self, x: Floats, before: Floats) -> Floats:
        """Find how the nodes have moved between two states. Collective.

        Args:
            x: Positions of the local nodes, shape ``(l, 3)`` [m].
            before: Former ones.

        Returns:
            Least components of the displacements of the nodes of each boundary, and the negative
            of the greatest, shape ``(2, g, 3)`` [m].
        """
        if self._height:
            x, before = self._in_space(x), self._in_space(before)
        return reductions.least(self._comm, self._kernels.displacements(x, before))

    def meetings(self, touch: Floats) -> tuple[Floats, Ints, Floats, Floats]:
        """Find where points of one boundary may be inside another. Local.

        Args:
            touch: Depth up to which each boundary is only touched, shape ``(g,)`` [m].

        Returns:
            How far any two boundaries are apart at least, infinite on the diagonal, ``(g, g)``
            [m]; those two that may overlap by more than a touch, in both orders, ``(p, 2)``;
            the depth of that touch, ``(p,)`` [m]; and least and greatest coordinates of all
            points of the first one that may be deeper in the second, ``(p, 2, 3)`` [m]. The
            same on all ranks.
        """
        return _kernels.meetings(self._boxes, touch)

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
        crossings = self._kernels.crossings(points, where, self._boxes)
        crossings = reductions.total(self._comm, crossings)
        distance = self._kernels.distance(points, where, least, crossings)
        distance = reductions.least(self._comm, distance)
        deep = distance > least
        if not deep.any():
            return np.zeros(len(points))
        count, at_an_edge = crossings
        inside = (count > 0) & deep
        # Rays from points on the boundary often hit edges, others hardly ever.
        unsure = np.flatnonzero((at_an_edge > 0) & deep).astype(np.int32)
        if len(unsure):
            winding = self._kernels.winding(points[unsure], where[unsure])
            inside[unsure] = reductions.total(self._comm, winding) > 0.5
        return np.where(inside, distance, 0.0)

    def times(self, points: Floats, where: Ints) -> Ints:
        """Count how often boundaries go round points. Collective.

        Args:
            points: Positions off the boundaries, the same on all ranks, shape ``(m, 3)`` [m].
            where: Number of the boundary of interest for each point, shape ``(m,)``.

        Returns:
            0 outside, 1 inside, more where a body is inside itself, shape ``(m,)``; the same on
            all ranks.
        """
        crossings = self._kernels.crossings(points, where, self._boxes)
        count, at_an_edge = reductions.total(self._comm, crossings)
        unsure = np.flatnonzero(at_an_edge).astype(np.int32)
        if len(unsure):
            winding = self._kernels.winding(points[unsure], where[unsure])
            count[unsure] = np.rint(reductions.total(self._comm, winding))
        return np.asarray(count, dtype=np.int32)

    def way_out(self, ways: Floats, where: Ints, number: int, least: float) -> Floats:
        """Find the part of ways after which they leave a boundary. Collective.

        Args:
            ways: As of `points_on`.
            where: As of `points_on`.
            number: How often they leave it before.
            least: Part of a way in which it does not matter.

        Returns:
            The part, 1 for ways that do not leave it as often, the same on all ranks, ``(w,)``.
        """
        cut, place = self._kernels.cuts(ways, where)
        cut, place = joined(self._comm, cut), joined(self._comm, place)
        leaves = (cut[:, 1] >= 0) & (place >= least)
        way, place = cut[leaves, 0], place[leaves]
        order = np.lexsort((place, way))
        way, place = way[order], place[order]
        chosen = np.arange(len(way)) - np.searchsorted(way, way) == number
        part = np.ones(len(ways))
        part[way[chosen]] = place[chosen]
        return part

    def points_on(self, ways: Floats, where: Ints, number: Ints) -> tuple[Floats, Ints]:
        """Find the ways that are points, and the middles of parts that may be inside. Collective.

        Boundaries cut straight ways into parts, and most cuts tell on which side a way goes on.

        Args:
            ways: Begin and end of each way, the same on all ranks, shape ``(w, 6)`` [m].
            where: Number of the boundary of interest for each way, shape ``(w,)``.
            number: A number of each way, shape ``(w,)``.

        Returns:
            First the ways that are points, then the middles of parts, the same on all ranks, shape
            ``(m, 3)`` [m], and the number of the way of each, ``(m,)``. Other ways that meet no
            boundary have none.
        """
        way, place = self._kernels.cuts(ways, where)
        way, place = joined(self._comm, way), joined(self._comm, place)
        return _kernels.points_on_ways(ways, number, way, place)

    def _extremes(self, least: Floats) -> Floats:
        """Least and greatest values of all ranks, from those of a rank, greatest negative."""
        extremes: Floats = reductions.least(self._comm, least) * _SIGNS
        return extremes

    def _in_space(self, x: Floats) -> Floats:
        """Positions of the vertices of triangles, shape ``(l, 3)``, or of walls ``(2 l, 3)``."""
        return raised(x, self._height) if self._height else x
