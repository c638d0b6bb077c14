"""Overlaps: bodies that are inside each other, or inside obstacles, whatever contact finds.

Contact looks at nodes and segments of its pairs. This looks at whole closed boundaries: at the
nodes on one that are inside another, and at the edges of one that cross another.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.closed_boundaries import closed_boundaries
from dolfinx_nts.model.connected_bodies import connected
from dolfinx_nts.model.frames import Frame
from dolfinx_nts.model.obstacles import Obstacle
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.search.inside import Insides, all_rows
from dolfinx_nts.search.walls import thinnest_wall

__all__ = ["Overlap", "OverlapSearch"]

# Depth relative to the size of a facet [-] up to which bodies touch and do not overlap.
_TOUCHING = 1e-6


@dataclass(frozen=True)
class Overlap:
    """Two bodies that are inside each other, or a body in an obstacle.

    Attributes:
        names: The two, as ``"cube"`` by the name of the `Body`, or ``"cube and plate"`` that
            share nodes, and ``"RigidPlane"``; the first is the one of which a point lies deepest
            inside the second.
        depth: Distance of that point from the boundary of the second [m].
        reverse_depth: Depth of the deepest point of the second inside the first [m].
        nodes: Number of nodes on the boundary of either that are inside the other; 0 where only
            edges cross.
        cells: Number of cells of either whose centres are inside the other.
        size: Longest facet of the one with the smaller facets [m].

    Example:
        >>> stepper.set_displacement(other, (0.0, 0.0, -0.06))  # m, and the gap was 0.01 m
        >>> (overlap,) = nts.Diagnostics(stepper).overlaps()
        >>> sorted(overlap.names), f"{overlap.depth:.2g} m", overlap.nodes, overlap.cells
        (['lower', 'upper'], '0.05 m', 8, 0)
    """

    names: tuple[str, str]
    depth: float
    reverse_depth: float
    nodes: int
    cells: int
    size: float


class OverlapSearch:
    """Finds overlaps of bodies that share no nodes, and with obstacles. Collective.

    Args:
        bodies: All bodies of the mesh.
        obstacles: Rigid obstacles.

    Attributes:
        names: Names of the boundaries, as in an `Overlap`.
        shortest: Length of the smallest cell in the reference configuration [m].
    """

    def __init__(self, bodies: Sequence[Body], obstacles: Sequence[Obstacle]) -> None:
        """Find the boundaries of the bodies."""
        V = bodies[0].V
        self._comm: MPI.Comm = V.mesh.comm
        self._boundaries = closed_boundaries(connected(bodies))
        self._insides = Insides(self._comm, self._boundaries)
        self.names = [
            " and ".join(body.name for body in boundary.bodies) for boundary in self._boundaries
        ]
        self._obstacles = dict(zip(obstacles, _names(obstacles), strict=True))
        self._sizes = np.array([boundary.size for boundary in self._boundaries])
        length = _kernels.cell_lengths(V.tabulate_dof_coordinates(), V.dofmap.list)
        self.shortest = float(reductions.least(self._comm, float(length.min(initial=np.inf))))

    @cached_property
    def walls(self) -> Floats:
        """Thickness of the thinnest part of each boundary at rest, ``(g,)`` [m]. Collective."""
        X = self._boundaries[0].bodies[0].V.tabulate_dof_coordinates()
        return np.array([thinnest_wall(self._comm, X[b.triangles]) for b in self._boundaries])

    @property
    def obstacles(self) -> frozenset[str]:
        """Names of the obstacles. Local."""
        return frozenset(self._obstacles.values())

    def names_of(self, surface: Surface | Obstacle) -> frozenset[str]:
        """Names in an `Overlap` of the bodies to which a surface belongs. Collective."""
        if isinstance(surface, Obstacle):
            return frozenset([self._obstacles[surface]])
        mine = [bool(np.isin(surface.nodes, b.nodes).any()) for b in self._boundaries]
        belongs = reductions.anywhere(self._comm, mine)
        return frozenset(name for name, yes in zip(self.names, belongs, strict=True) if yes)

    def approach(self, x: Floats, t: float, before: Floats, t_before: float) -> float:
        """Bound on how much any two, of which one may be an obstacle, have come nearer [m].

        ``before`` are the positions at ``t_before`` from which the motion counts, ``x`` and ``t``
        are as of `find`. Collective.
        """
        nodes = [boundary.nodes for boundary in self._boundaries]

        def farthest(frame: Frame) -> list[float]:
            ends = frame.at_end(x), frame.at_start(before)
            return [_kernels.farthest(*(end.take(n, axis=0) for end in ends)) for n in nodes]

        moving = [obstacle.motion for obstacle in self._obstacles if not obstacle.motion.is_rest]
        frames = [Frame(), *(motion.frame(t_before, t) for motion in moving)]
        in_space, *in_frames = reductions.largest(self._comm, list(map(farthest, frames)))
        return float(max([np.sort(in_space)[-2:].sum(), *map(np.max, in_frames)]))

    def find(self, x: Floats, least: float = 0.0, t: float = 0.0) -> tuple[list[Overlap], Floats]:
        """Find all overlaps that are more than a touch. Collective.

        Args:
            x: Positions of the local nodes of the space, owned and ghost, ``(l, 3)`` [m].
            least: Depth that an overlap must have to be of interest [m].
            t: Time, at which moving obstacles are where they are [s].

        Returns:
            The overlaps; and how far each two of the ``g`` boundaries are apart at least, shape
            ``(g, g)`` [m], on the diagonal all of them from obstacles. The same on all ranks.
        """
        touching = np.maximum(_TOUCHING * self._sizes, least)
        in_obstacles, clearance = self._with_obstacles(x, t, touching)
        lower, upper = self._boxes(x)
        apart = np.maximum(lower[:, None], lower) - np.minimum(upper[:, None], upper)
        apart = apart.max(axis=2)
        np.fill_diagonal(apart, np.inf)
        pairs = np.argwhere(apart < -np.minimum.outer(touching, touching)).astype(np.int32)
        inner, outer = pairs.T
        depth = touching[pairs].min(axis=1)[:, None]
        # What is deep in the second boundary is as deep in its box.
        region_lower = np.maximum(lower[inner], lower[outer] + depth)
        region_upper = np.minimum(upper[inner], upper[outer] - depth)
        regions = np.stack([region_lower, region_upper], axis=1)
        overlaps = self._between_bodies(x, pairs, depth[:, 0], regions)
        np.fill_diagonal(apart, clearance)
        return [*overlaps, *in_obstacles], apart

    def _between_bodies(
        self, x: Floats, pairs: Ints, touching: Floats, regions: Floats
    ) -> Iterator[Overlap]:
        """Overlaps of bodies whose boxes overlap.

        Args:
            x: Positions [m].
            pairs: Boundaries in both orders, shape ``(p, 2)``.
            touching: Depth of a touch, shape ``(p,)`` [m].
            regions: Least and greatest coordinates of places of the first boundary that may be
                deeper in the second one, shape ``(p, 2, 3)`` [m].
        """
        nodes, edges, cells = _Rows(3), _Rows(6), _Rows(3)
        for number, inner in enumerate(map(int, pairs[:, 0])):
            boundary, region = self._boundaries[inner], regions[number]
            nodes.add(_kernels.rows_in(x, boundary.nodes[:, None], region), number)
            edges.add(_kernels.rows_in(x, boundary.edges, region), number)
        self._insides.move(x)

        def depth(points: Floats, pair: Ints) -> Floats:
            return self._insides.depth(points, pairs[pair, 1], touching[pair])

        points, at_nodes = nodes.joined(self._comm)
        ways, crossed = edges.joined(self._comm)
        if not len(points) + len(ways):
            return  # everywhere, as all ranks have the same
        middles, way = self._insides.chords(ways, pairs[crossed, 1])
        pair = np.concatenate([at_nodes, crossed[way]])
        deep = depth(np.concatenate([points, middles]), pair)
        if not deep.any():
            return
        deepest = np.zeros(len(pairs))
        np.maximum.at(deepest, pair, deep)
        num_nodes = np.bincount(at_nodes[deep[: len(at_nodes)] > 0], minlength=len(pairs))
        # Both orders of two boundaries between which there is an overlap.
        turned = np.lexsort((pairs[:, 0], pairs[:, 1]))
        both = np.column_stack([np.arange(len(pairs)), turned])
        both = both[(both[:, 0] < turned) & (np.maximum(deepest, deepest[turned]) > 0)]
        for number in map(int, both.ravel()):
            points = _centres(x, self._boundaries[pairs[number, 0]].cells)
            cells.add(_kernels.rows_in(points, all_rows(points)[:, None], regions[number]), number)
        points, pair = cells.joined(self._comm)
        num_cells = np.bincount(pair[depth(points, pair) > 0], minlength=len(pairs))
        for two in both:
            reverse, first = two[deepest[two].argsort()]
            inner, outer = pairs[first]
            yield Overlap(
                (self.names[inner], self.names[outer]),
                float(deepest[first]),
                float(deepest[reverse]),
                int(num_nodes[two].sum()),
                int(num_cells[two].sum()),
                float(self._sizes[[inner, outer]].min()),
            )

    def _boxes(self, x: Floats) -> Floats:
        """Least and greatest coordinates of the boundaries, shape ``(2, g, 3)`` [m]."""
        least = np.full((2, len(self._boundaries), 3), np.inf)
        for number, boundary in enumerate(self._boundaries):
            some = x.take(boundary.nodes, axis=0)
            least[0, number] = some.min(axis=0, initial=np.inf)
            least[1, number] = -some.max(axis=0, initial=-np.inf)
        return reductions.least(self._comm, least) * [[[1]], [[-1]]]

    def _with_obstacles(self, x: Floats, t: float, touching: Floats) -> tuple[list[Overlap], float]:
        """Overlaps with obstacles at the time t [s], and the least distance from one [m]."""
        if not self._obstacles:
            return [], np.inf
        shape = len(self._obstacles), len(self._boundaries)
        deepest, num_nodes = np.full(shape, -np.inf), np.zeros(shape, dtype=np.int64)
        seen = [obstacle.motion.frame(t, t).at_end(x) for obstacle in self._obstacles]
        for i, obstacle in enumerate(self._obstacles):
            for j, boundary in enumerate(self._boundaries):
                depth = obstacle.depth(seen[i][boundary.nodes])
                deepest[i, j] = depth.max(initial=-np.inf)
                num_nodes[i, j] = np.count_nonzero(depth > touching[j])
        deepest = reductions.largest(self._comm, deepest)
        overlaps = []
        for i, j in np.argwhere(deepest > touching):
            (obstacle, name), boundary = list(self._obstacles.items())[i], self._boundaries[j]
            at_centres = obstacle.depth(_centres(seen[i], boundary.cells))
            counts = [int(num_nodes[i, j]), int(np.count_nonzero(at_centres > touching[j]))]
            nodes, cells = reductions.total(self._comm, counts)
            names = self.names[j], name
            deepest_of_two = float(deepest[i, j])
            overlaps.append(Overlap(names, deepest_of_two, 0.0, nodes, cells, boundary.size))
        return overlaps, -float(deepest.max(initial=-np.inf))


def _names(obstacles: Sequence[Obstacle]) -> list[str]:
    """Classes of obstacles, with a number where there are several."""
    kinds = [type(obstacle).__name__ for obstacle in obstacles]
    return [
        kind if kinds.count(kind) == 1 else f"{kind} {kinds[: i + 1].count(kind)}"
        for i, kind in enumerate(kinds)
    ]


def _centres(x: Floats, cells: Ints) -> Floats:
    """Centres of the nodes of cells, shape ``(c, 3)`` [m]."""
    # Node by node, which is faster than to gather all of them.
    centres: Floats = sum(x.take(nodes, axis=0) for nodes in cells.T) / cells.shape[1]
    return centres


class _Rows:
    """Rows of coordinates, each with the number of a pair."""

    def __init__(self, width: int) -> None:
        self._rows: list[Floats] = [np.empty((0, width + 1))]

    def add(self, rows: Floats, pair: int) -> None:
        """Add rows of one pair. Local."""
        self._rows.append(np.column_stack([rows, np.full(len(rows), float(pair))]))

    def joined(self, comm: MPI.Comm) -> tuple[Floats, Ints]:
        """Rows of all ranks and their pairs, the same on all ranks. Collective."""
        rows = joined(comm, np.concatenate(self._rows))
        return np.ascontiguousarray(rows[:, :-1]), rows[:, -1].astype(np.int32)
