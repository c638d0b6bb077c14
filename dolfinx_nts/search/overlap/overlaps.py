"""Overlap check: bodies inside each other, themselves, or obstacles, independent of contact.

It uses whole closed boundaries: nodes of one boundary inside another, and edges of one that
intersect another.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.closed_boundaries import ClosedBoundary, closed_boundaries, triangles_at
from dolfinx_nts.model.connected_bodies import connected
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.rigid_body import RigidBody
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.model.thickness import least_thickness
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.search.overlap.inside import Insides
from dolfinx_nts.search.overlap.self_overlaps import self_overlap

__all__ = ["Overlap", "OverlapSearch"]

# Depth relative to the size of a facet [-] that counts as touching.
_TOUCHING = 1e-6
# Radius of the circle through the vertices of an equilateral facet relative to its diameter [-].
_HALF_FACET = 0.6
# Number of parts of each edge of a facet in the grid of points that are checked against round
# obstacles [-].
_PARTS = 4


@dataclass(frozen=True)
class Overlap:
    """Overlap of two bodies, of a body with an obstacle, or of a body with itself.

    Attributes:
        names: Names of both: of a `Body` such as ``"cube"``, of bodies that share nodes such as
            ``"cube and plate"``, or of an obstacle such as ``"RigidPlane"``. The first one has the
            deepest point inside the other. Twice the same name for a self-overlap.
        depth: Distance of that point from the boundary of the second [m]; in a self-overlap of a
            node or a facet midpoint, in one of six directions.
        reverse_depth: Depth of the deepest point of the second inside the first [m].
        nodes: Number of boundary nodes of either that are inside the other; 0 if only edges
            intersect.
        cells: Number of cells of either whose centres are inside the other.
        size: Longest facet of the body with the smaller facets [m].

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
    """Search for overlaps between bodies, with obstacles, and self-overlaps. Collective.

    Bodies that share nodes count as one.

    Args:
        bodies: All bodies of the mesh.
        obstacles: Rigid obstacles.

    Attributes:
        names: Names of the boundaries, as in `Overlap`.
        cells: Undeformed length of the smallest cell within each boundary, shape ``(g,)`` [m].
        smallest_cell: The least of these lengths [m].
        extent: Least extent of an obstacle, see `Obstacle.extent` [m].
    """

    def __init__(self, bodies: Sequence[Body], obstacles: Sequence[Obstacle]) -> None:
        V = bodies[0].V
        self._comm: MPI.Comm = V.mesh.comm
        self._boundaries = closed_boundaries(connected(bodies))
        self._insides = Insides(self._comm, self._boundaries)
        self.names = [
            " and ".join(body.name for body in boundary.bodies) for boundary in self._boundaries
        ]
        self._obstacles = dict(zip(obstacles, _names(obstacles), strict=True))
        self.extent = min((obstacle.extent for obstacle in obstacles), default=np.inf)
        self._nodes = [boundary.nodes for boundary in self._boundaries]
        self._edges = [boundary.edges for boundary in self._boundaries]
        self._sizes = np.array([boundary.size for boundary in self._boundaries])
        X = reference_positions(V)[:, : dimension(V)]
        # Boundary of each owned node, -1 for interior nodes.
        self._boundary_of = np.full(V.dofmap.index_map.size_local, -1)
        for number, nodes in enumerate(self._nodes):
            self._boundary_of[nodes] = number
        lengths = [_kernels.cell_lengths(X, boundary.cells) for boundary in self._boundaries]
        cells = np.array([length.min(initial=np.inf) for length in lengths])
        self.cells: Floats = reductions.least(self._comm, cells)
        self.smallest_cell = float(self.cells.min())

    @cached_property
    def thickness(self) -> Floats:
        """Least undeformed thickness within each boundary, ``(g,)`` [m]. Collective."""
        X = reference_positions(self._boundaries[0].bodies[0].V)
        comm, surfaces = self._comm, (b.triangles for b in self._boundaries)
        return np.array([least_thickness(comm, triangles_at(comm, X, each)) for each in surfaces])

    @property
    def obstacles(self) -> frozenset[str]:
        """Names of the obstacles. Local."""
        return frozenset(self._obstacles.values())

    def names_of(self, surface: Surface | Obstacle) -> frozenset[str]:
        """Names of the bodies of a surface, or of an obstacle, as in `Overlap`. Collective."""
        if isinstance(surface, Obstacle):
            return frozenset([self._obstacles[surface]])
        mine = np.zeros(len(self._boundaries) + 1, dtype=bool)
        mine[self._boundary_of[surface.nodes]] = True
        belongs = reductions.anywhere(self._comm, mine[:-1])
        return frozenset(self.names[number] for number in np.flatnonzero(belongs))

    def boundaries_and_nodes(self, surface: Surface) -> tuple[Ints, Ints]:
        """Boundaries of a surface on this rank, and one node of each, ``(m,)`` each. Local."""
        number, first = np.unique(self._boundary_of[surface.nodes], return_index=True)
        return number.astype(np.int32), surface.nodes[first]

    def box(self, name: str) -> Floats:
        """Least and greatest coordinates of a body at the positions of the last `find`. Local.

        ``name`` is the name of its boundary. Returns shape ``(2, 3)`` [m].
        """
        return self._insides.box(self.names.index(name))

    def below(self, points: Floats, inward: Floats, name: str) -> tuple[Flags, Floats]:
        """Whether points are inside a body at the positions of the last `find`. Collective.

        Args:
            points: Positions, the same on all ranks, shape ``(m, 3)`` [m].
            inward: Unit vectors into the body, shape ``(m, 3)``.
            name: Name of its boundary.

        Returns:
            Flags of the points inside, and the distances in these directions to the other side of
            the body, shape ``(m,)`` each [m]. The same on all ranks.
        """
        number = self.names.index(name)
        where = np.full(len(points), number, dtype=np.int32)
        touching = np.full(len(points), _TOUCHING * self._sizes[number])
        inside: Flags = self._insides.depth(points, where, touching) > 0
        far = self._insides.diameter(number)
        paths = np.hstack([points, points + far * inward])
        return inside, far * self._insides.exit_fractions(paths, where, 0, 0.0)

    def approach(self, x: Floats, t: float, before: Floats, t_before: float) -> Floats:
        """Bounds on the approach of boundaries between two states. Collective.

        Args:
            x: Positions as for `find`.
            t: Time [s].
            before: Earlier positions.
            t_before: Time of the earlier positions [s].

        Returns:
            Bounds for any two of the ``g`` boundaries, shape ``(g, g)`` [m], and for each boundary
            and the obstacles on the diagonal. The same on all ranks.
        """
        displacements = self._insides.displacements
        nearer = _kernels.approach(displacements(x, before))
        for obstacle in self._obstacles:
            frame = obstacle.motion.frame(t_before, t, obstacle.dim)
            seen = displacements(frame.at_end(x), frame.at_start(before))
            approach = np.linalg.norm(seen.min(axis=0), axis=1)
            np.fill_diagonal(nearer, np.maximum(nearer.diagonal(), approach))
        return nearer

    def find(
        self,
        x: Floats,
        least: float = 0.0,
        t: float = 0.0,
        selves: Collection[str] | None = None,
    ) -> tuple[list[Overlap], Floats]:
        """Find all overlaps that exceed the tolerance. Collective.

        Args:
            x: Positions of the local nodes of the space, owned and ghost, ``(l, 3)`` [m].
            least: Least depth of an overlap of interest [m].
            t: Time, for the positions of moving obstacles [s].
            selves: Names of the boundaries to be checked for self-overlap; None for all.

        Returns:
            The overlaps; and least distances of any two of the ``g`` boundaries, shape ``(g, g)``
            [m], with the distances from obstacles on the diagonal. The same on all ranks.
        """
        touching = np.maximum(_TOUCHING * self._sizes, least)
        self._insides.move(x)
        in_obstacles, clearance = self._with_obstacles(x, t, touching)
        apart, pairs, depth, regions = self._insides.overlapping_boxes(touching)
        if self._obstacles:
            np.fill_diagonal(apart, clearance)
        found = self._between_bodies(x, pairs, depth, regions) if len(pairs) else []
        return [*found, *self._within_bodies(x, touching, selves), *in_obstacles], apart

    def _within_bodies(
        self, x: Floats, touching: Floats, selves: Collection[str] | None
    ) -> list[Overlap]:
        overlaps = []
        for number, boundary in enumerate(self._boundaries):
            name = self.names[number]
            if not (selves is None or name in selves) or _is_rigid(boundary):
                continue
            centres = _centres(x, boundary.cells)
            found = self_overlap(
                self._insides, number, boundary, x, centres, float(touching[number])
            )
            if found:
                depth, nodes, cells = found
                overlaps.append(Overlap((name, name), depth, depth, nodes, cells, boundary.size))
        return overlaps

    def _between_bodies(
        self, x: Floats, pairs: Ints, touching: Floats, regions: Floats
    ) -> list[Overlap]:
        """Overlaps of bodies whose boxes overlap. Collective.

        Args:
            x: Positions [m].
            pairs: Boundaries in both orders, shape ``(p, 2)``.
            touching: Depth that counts as touching, shape ``(p,)`` [m].
            regions: Least and greatest coordinates of the points of the first boundary that may be
                deeper in the second one, shape ``(p, 2, 3)`` [m].
        """
        inner, outer = np.ascontiguousarray(pairs.T)
        paths, number = _kernels.paths_in(x, self._nodes, self._edges, inner, regions)
        paths, number = joined(self._comm, paths), joined(self._comm, number)
        points, pair = self._insides.points_on(paths, outer[number], number)
        deep = self._insides.depth(points, outer[pair], touching[pair])
        if not deep.any():
            return []  # on all ranks
        deepest = np.zeros(len(pairs))
        np.maximum.at(deepest, pair, deep)
        at_nodes = np.count_nonzero((paths[:, :3] == paths[:, 3:]).all(axis=1))
        deep_nodes = pair[:at_nodes][deep[:at_nodes] > 0]
        num_nodes = np.bincount(deep_nodes, minlength=len(pairs))
        # Both orders of pairs with an overlap.
        turned = np.lexsort((pairs[:, 0], pairs[:, 1]))
        both = np.column_stack([np.arange(len(pairs)), turned])
        both = both[(both[:, 0] < turned) & (np.maximum(deepest, deepest[turned]) > 0)]
        centres = [self._centres(x, inner[i], regions[i]) for i in both.ravel()]
        number = np.repeat(both.ravel(), [len(some) for some in centres]).astype(np.int32)
        points, pair = joined(self._comm, np.concatenate(centres)), joined(self._comm, number)
        deep = self._insides.depth(points, outer[pair], touching[pair])
        num_cells = np.bincount(pair[deep > 0], minlength=len(pairs))
        overlaps = []
        for two in both:
            reverse, first = two[deepest[two].argsort()]
            overlaps.append(
                Overlap(
                    (self.names[inner[first]], self.names[outer[first]]),
                    float(deepest[first]),
                    float(deepest[reverse]),
                    int(num_nodes[two].sum()),
                    int(num_cells[two].sum()),
                    float(self._sizes[pairs[first]].min()),
                )
            )
        return overlaps

    def _centres(self, x: Floats, boundary: int, region: Floats) -> Floats:
        """Centres of the cells of this rank within a boundary and a region, ``(c, 3)`` [m]."""
        centres = _centres(x, self._boundaries[boundary].cells)
        is_in: Flags = ((centres >= region[0]) & (centres <= region[1])).all(axis=1)
        return centres[is_in]

    def _with_obstacles(self, x: Floats, t: float, touching: Floats) -> tuple[list[Overlap], float]:
        """Overlaps with obstacles at the time t [s], and least distance from an obstacle [m]."""
        if not self._obstacles:
            return [], np.inf
        shape = len(self._obstacles), len(self._boundaries)
        deepest, num_nodes = np.full(shape, -np.inf), np.zeros(shape, dtype=np.int64)
        seen = [o.motion.frame(t, t, o.dim).at_end(x) for o in self._obstacles]
        for i, obstacle in enumerate(self._obstacles):
            for j, boundary in enumerate(self._boundaries):
                depth = obstacle.depth(seen[i][boundary.nodes])
                deepest[i, j] = depth.max(initial=-np.inf)
                num_nodes[i, j] = np.count_nonzero(depth > touching[j])
        deepest = reductions.largest(self._comm, deepest)
        reverse, num_points = self._obstacles_within(seen, t, touching)
        overlaps = []
        for i, j in np.argwhere((deepest > touching) | (reverse > touching)):
            (obstacle, name), boundary = list(self._obstacles.items())[i], self._boundaries[j]
            at_centres = obstacle.depth(_centres(seen[i], boundary.cells))
            counts = [int(num_nodes[i, j]), int(np.count_nonzero(at_centres > touching[j]))]
            nodes, cells = reductions.total(self._comm, counts)
            names, nodes = (self.names[j], name), int(nodes + num_points[i, j])
            depths = max(float(deepest[i, j]), 0.0), float(reverse[i, j])
            if depths[0] < (1 - _TOUCHING) * depths[1]:
                names, depths = names[::-1], depths[::-1]
            overlaps.append(Overlap(names, *depths, nodes, int(cells), boundary.size))
        # A round obstacle may penetrate the middle of a facet deeper than its nodes.
        radius = np.array([[o.least_radius] for o in self._obstacles])
        is_round, size = np.isfinite(radius), _HALF_FACET * self._sizes
        radius = np.where(is_round, radius, 0.0)
        nearer = np.sqrt(np.fmax((np.fmax(-deepest, 0.0) + radius) ** 2 - size**2, 0.0)) - radius
        distance = np.where(is_round, nearer, -deepest).min(initial=np.inf)
        return overlaps, max(0.0, float(distance))

    def _obstacles_within(
        self, seen: Sequence[Floats], t: float, touching: Floats
    ) -> tuple[Floats, Ints]:
        """Largest depths of obstacle points in bodies, and numbers of obstacle vertices inside.

        The points are vertices of facets, and points of round surfaces nearest to facets of bodies.
        ``seen`` are positions in the frame of each obstacle; other arguments as for
        `_with_obstacles`. Both results have the shape ``(o, g)`` [m, -]. Collective, after
        `Insides.move`.
        """
        shape = len(self._obstacles), len(self._boundaries)
        deepest, number = np.zeros(shape), np.zeros(shape, dtype=np.int32)
        for i, obstacle in enumerate(self._obstacles):
            in_space = obstacle.motion.frame(t, t, obstacle.dim).in_space
            vertices = in_space(obstacle.vertices)
            for j, boundary in enumerate(self._boundaries):
                least, greatest = self._insides.box(j)
                round_ = in_space(obstacle.nearest(_on_facets(obstacle, seen[i], boundary)))
                corners, of_round = (
                    some[((some > least) & (some < greatest)).all(axis=1)]
                    for some in (vertices, round_)
                )
                points = np.vstack([corners, joined(self._comm, of_round)])
                where = np.full(len(points), j, dtype=np.int32)
                depth = self._insides.depth(points, where, np.full(len(points), touching[j]))
                deepest[i, j] = depth.max(initial=0.0)
                number[i, j] = np.count_nonzero(depth[: len(corners)])
        return deepest, number


def _is_rigid(boundary: ClosedBoundary) -> bool:
    """Whether all bodies of a boundary are rigid."""
    return all(isinstance(body, RigidBody) for body in boundary.bodies)


def _on_facets(obstacle: Obstacle, x: Floats, boundary: ClosedBoundary) -> Floats:
    """Points on the facets of a boundary near a round obstacle, ``(m, 3)`` [m]. Local."""
    if not 0 < obstacle.least_radius < np.inf:
        return np.empty((0, 3))
    corners = x[boundary.triangles]
    near = corners[obstacle.depth(corners.mean(axis=1)) > -boundary.size]
    k = corners.shape[1]
    steps = np.stack(np.meshgrid(*[np.arange(_PARTS + 1)] * k), axis=-1).reshape(-1, k)
    parts = steps[steps.sum(axis=1) == _PARTS] / _PARTS
    points: Floats = np.einsum("pk,fki->fpi", parts, near).reshape(-1, 3)
    return points


def _names(obstacles: Sequence[Obstacle]) -> list[str]:
    """Names of obstacles or their classes; equal names get a number."""
    kinds = [obstacle.name.removeprefix("a ").removeprefix("moving ") for obstacle in obstacles]
    return [
        kind if kinds.count(kind) == 1 else f"{kind} {kinds[: i + 1].count(kind)}"
        for i, kind in enumerate(kinds)
    ]


def _centres(x: Floats, cells: Ints) -> Floats:
    """Centres of the nodes of cells, shape ``(c, 3)`` [m]."""
    # Summed node by node, which is faster than a mean of gathered positions.
    centres: Floats = sum(x.take(nodes, axis=0) for nodes in cells.T) / cells.shape[1]
    return centres
