"""Point-in-body tests and penetration depths for closed boundaries on several ranks."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints, indices
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.closed_boundaries import ClosedBoundary, raised, wall_height, walls
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined

__all__ = ["Insides"]

# Signs by which the sum of smallest coordinates and negative largest coordinates is an extent.
_SIGNS = np.array([[[1.0]], [[-1.0]]])


class Insides:
    """Interiors of moving closed boundaries. Collective.

    Every rank has some triangles of a boundary, and all ranks query the same points. Ray crossings
    and solid angles are summed over the triangles of all ranks. Boundaries in the plane are
    extruded so high that their ends have no effect.

    Args:
        comm: Communicator.
        boundaries: The boundaries.
    """

    def __init__(self, comm: MPI.Comm, boundaries: Sequence[ClosedBoundary]) -> None:
        self._comm = comm
        # Trees over the triangles are built or updated on demand.
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
        """Set the positions of the local nodes, shape ``(l, 3)`` [m]. Collective."""
        self._kernels.move(self._in_space(x))
        # Least and greatest coordinates of all nodes, shape (2, g, 3) [m].
        self._boxes = self._extremes(self._kernels.extents())

    def box(self, number: int) -> Floats:
        """Least and greatest coordinates of a boundary, shape ``(2, 3)`` [m]. Local."""
        box: Floats = self._boxes[:, number]
        return box

    def diameter(self, number: int) -> float:
        """Approximate diameter of a boundary [m]. Local."""
        return float(np.linalg.norm(self._boxes[1, number] - self._boxes[0, number]))

    def displacements(self, x: Floats, before: Floats) -> Floats:
        """Smallest and largest displacements of nodes between two states. Collective.

        Args:
            x: Positions of the local nodes, shape ``(l, 3)`` [m].
            before: Earlier positions, shape ``(l, 3)`` [m].

        Returns:
            Smallest components of the displacements of the nodes of each boundary, and negative
            largest components, shape ``(2, g, 3)`` [m].
        """
        if self._height:
            x, before = self._in_space(x), self._in_space(before)
        return reductions.least(self._comm, self._kernels.displacements(x, before))

    def overlapping_boxes(self, touch: Floats) -> tuple[Floats, Ints, Floats, Floats]:
        """Find pairs of boundaries that may overlap, by their boxes. Local.

        Args:
            touch: Depth that counts as touching for each boundary, shape ``(g,)`` [m].

        Returns:
            Least distance of any two boundaries, infinite on the diagonal, ``(g, g)`` [m]; pairs
            that may overlap by more than touching, in both orders, ``(p, 2)``; their touching
            depth, ``(p,)`` [m]; and least and greatest coordinates of the points of the first
            boundary that may be deeper in the second, ``(p, 2, 3)`` [m]. The same on all ranks.
        """
        return _kernels.overlapping_boxes(self._boxes, touch)

    def depth(self, points: Floats, where: Ints, least: Floats) -> Floats:
        """Penetration depth of points. Collective.

        Args:
            points: Positions, the same on all ranks, shape ``(m, 3)`` [m].
            where: Boundary for each point, shape ``(m,)``.
            least: Depth up to which each point counts as on the boundary, ``(m,)`` [m].

        Returns:
            Distance from the boundary, 0 on it and outside, the same on all ranks, shape
            ``(m,)`` [m].
        """
        if not len(points):
            return np.zeros(0)  # on all ranks
        crossings = self._kernels.crossings(points, where, self._boxes)
        crossings = reductions.total(self._comm, crossings)
        distance = self._kernels.distance(points, where, least, crossings)
        distance = reductions.least(self._comm, distance)
        deep = distance > least
        if not deep.any():
            return np.zeros(len(points))
        count, at_an_edge = crossings
        inside = (count > 0) & deep
        # Rays that hit an edge are ambiguous, which is only frequent for points on the boundary.
        unsure = indices((at_an_edge > 0) & deep)
        if len(unsure):
            winding = self._kernels.winding(points[unsure], where[unsure])
            inside[unsure] = reductions.total(self._comm, winding) > 0.5
        return np.where(inside, distance, 0.0)

    def times(self, points: Floats, where: Ints) -> Ints:
        """Winding numbers of boundaries around points. Collective.

        Args:
            points: Positions off the boundaries, the same on all ranks, shape ``(m, 3)`` [m].
            where: Boundary for each point, shape ``(m,)``.

        Returns:
            0 outside, 1 inside, more in self-overlaps, shape ``(m,)``; the same on all ranks.
        """
        crossings = self._kernels.crossings(points, where, self._boxes)
        count, at_an_edge = reductions.total(self._comm, crossings)
        unsure = indices(at_an_edge)
        if len(unsure):
            winding = self._kernels.winding(points[unsure], where[unsure])
            count[unsure] = np.rint(reductions.total(self._comm, winding))
        return np.asarray(count, dtype=np.int32)

    def exit_fractions(self, paths: Floats, where: Ints, number: int, least: float) -> Floats:
        """Fraction of straight paths after which they leave a boundary. Collective.

        Args:
            paths: Paths as for `points_on`.
            where: Boundaries as for `points_on`.
            number: Number of earlier exits to be skipped.
            least: Initial fraction of a path that is ignored.

        Returns:
            The fractions, 1 for paths without such an exit, the same on all ranks, ``(w,)``.
        """
        cut, place = self._kernels.cuts(paths, where)
        cut, place = joined(self._comm, cut), joined(self._comm, place)
        leaves = (cut[:, 1] >= 0) & (place >= least)
        path, place = cut[leaves, 0], place[leaves]
        order = np.lexsort((place, path))
        path, place = path[order], place[order]
        chosen = np.arange(len(path)) - np.searchsorted(path, path) == number
        part = np.ones(len(paths))
        part[path[chosen]] = place[chosen]
        return part

    def points_on(self, paths: Floats, where: Ints, number: Ints) -> tuple[Floats, Ints]:
        """Midpoints of the parts of straight paths that may be inside. Collective.

        Boundaries divide straight paths into parts. The normal at most intersections shows which
        part is inside.

        Args:
            paths: Start and end of each path, the same on all ranks, shape ``(w, 6)`` [m].
            where: Boundary for each path, shape ``(w,)``.
            number: Number of each path, shape ``(w,)``.

        Returns:
            Paths of length zero, then midpoints of parts, the same on all ranks, shape ``(m, 3)``
            [m], and the number of the path of each, ``(m,)``. Paths without an intersection have no
            midpoints.
        """
        path, place = self._kernels.cuts(paths, where)
        path, place = joined(self._comm, path), joined(self._comm, place)
        return _kernels.points_on_paths(paths, number, path, place)

    def _extremes(self, least: Floats) -> Floats:
        """Bounds over all ranks, from least values and negated greatest values of this rank."""
        extremes: Floats = reductions.least(self._comm, least) * _SIGNS
        return extremes

    def _in_space(self, x: Floats) -> Floats:
        """Positions of vertices, shape ``(l, 3)``, in the plane extruded to ``(2 l, 3)``."""
        return raised(x, self._height) if self._height else x
