"""Rigid obstacle made of facets, evaluated by the contact kernels."""

from typing import Any

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints, indices
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.obstacles.adjacent_facets import AdjacentFacets
from dolfinx_nts.model.obstacles.facing import Facing
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.obstacles.rims import is_nearest_a_rim
from dolfinx_nts.model.obstacles.trajectories import Trajectories, passages
from dolfinx_nts.model.segments import area_vectors, diameters

__all__ = ["RigidSurface"]

# Permutation between Basix order and counter-clockwise order of a quadrilateral.
_AROUND = [0, 1, 3, 2]
# Product of the normals at two corners, relative to the square of the largest normal [-], that
# counts as zero. Larger values accept slightly concave facets.
_ROUND_OFF = 1e-10


class RigidSurface(Obstacle):
    """Rigid surface of triangles or quadrilaterals. Local.

    Args:
        points: Positions of the vertices, shape ``(n, 3)`` [m], the same on all ranks.
        facets: Vertices of each facet: shape ``(s, 3)`` in any orientation; or ``(s, 4)``, all in
            Basix order (0,0), (1,0), (0,1), (1,1), or all around each facet, as in gmsh, VTK and
            meshio. The order is detected from the positions, since sides of a convex facet do not
            intersect.
        outside: Point in front of all facets, shape ``(3,)`` [m]; for a closed or strongly curved
            surface one point per facet, shape ``(s, 3)``.
        name: Name in messages, columns and legends; empty for the kind of the obstacle.

    Attributes:
        key: Numbers of the facets, shape ``(s,)``.
        corners: Positions of the vertices of each facet, shape ``(s, k, 3)`` [m].
        deepest: Depth down to which nodes touch facets that are smaller than twice this depth [m].

    Raises:
        TypeError: ``facets`` are not integers.
        ValueError: Shapes or indices do not fit, quadrilaterals are not convex in either order of
            corners, or ``outside`` lies in the plane of a facet.

    Example:
        >>> points = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 1], [4, 4, 1]])
        >>> nts.RigidSurface(points, facets=[[0, 1, 2, 3]], outside=(2, 2, 9))
        RigidSurface(num_facets=1)
    """

    def __init__(self, points: Any, facets: Any, outside: Any, *, name: str = "") -> None:
        self._call_it(name)
        points, facets = np.array(points, dtype=np.float64, order="C"), np.asarray(facets)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"expected points of shape (n, 3), given {points.shape}")
        if facets.ndim != 2 or facets.shape[1] not in (3, 4):
            raise ValueError(f"expected facets of shape (s, 3) or (s, 4), given {facets.shape}")
        if facets.dtype.kind not in "iu":
            raise TypeError(f"expected facets as integer indices of points, given {facets.dtype}")
        if facets.size and not (0 <= facets.min() and facets.max() < len(points)):
            raise ValueError(
                f"expected facets as indices of points, from 0 to {len(points) - 1}, given "
                f"{facets.min()} to {facets.max()}"
            )
        if facets.shape[1] == 4:
            facets = _in_basix_order(points, facets)
        self._points, self.corners = points, points[facets]
        centre = self.corners.mean(axis=1)
        edges = self.corners[:, 1:3] - self.corners[:, :1]
        side = np.einsum("si,si->s", np.cross(edges[:, 0], edges[:, 1]), outside - centre)
        if np.any(side == 0):
            raise ValueError(
                "expected facets with an area, in planes that do not contain the point `outside`, "
                f"given {np.count_nonzero(side == 0)} other facets, the first one with the number "
                f"{np.flatnonzero(side == 0)[0]}"
            )
        self._orientation = np.sign(side)
        vars(self)["key"] = np.arange(len(facets), dtype=np.int64)  # only the package may set it
        self._facets: Ints = np.ascontiguousarray(facets, dtype=np.int32)
        self._segments = _kernels.Segments(self._facets, self._orientation, self.key)
        self._adjacent = AdjacentFacets(self._facets, self._orientation)
        self.shortest_passage = self._shortest_passage()
        self.deepest = 0.0

    @property
    def facets(self) -> tuple[Floats, Ints, Floats]:
        """Positions ``(n, 3)`` [m], vertices of each facet ``(s, k)``, and orientation ``(s,)``.

        The orientation is +1 if the product of the first two edges points outward, otherwise -1.
        """
        return self._points, self._facets, self._orientation

    @property
    def adjacent(self) -> tuple[AdjacentFacets, Floats]:
        return self._adjacent, self._points

    @property
    def vertices(self) -> Floats:
        used: Floats = self._points[np.unique(self._facets)]
        return used

    @property
    def least_radius(self) -> float:
        return 0.0

    @property
    def extent(self) -> float:
        """Diagonal of the bounding box [m]."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0)))

    def _shortest_passage(self) -> float:
        """Displacement below which no node passes through the surface [m].

        It depends on the thickness below the centres of facets.
        """
        size = diameters(self.corners)
        return float(passages(size, self._thickness(size)).min(initial=np.inf))

    def _thickness(self, farthest: Floats) -> Floats:
        """Thickness below the centres of facets, infinite beyond ``farthest``, ``(s,)`` [m]."""
        centre, inward = self.corners.mean(axis=1), -area_vectors(self.corners, self._orientation)
        inward *= farthest[:, None] / np.linalg.norm(inward, axis=1)[:, None]
        everywhere = Facing.everywhere(len(centre))
        paths = self.follow(centre, centre + inward, self.key.astype(np.int32), everywhere)
        return np.where(paths.leaves, paths.length, np.inf)

    def deepen(self, depth: float) -> None:
        """Let nodes touch facets down to a depth [m], at most half of the least thickness.

        Without it, they touch a facet down to half of its diameter. Contact pairs call it with a
        depth by the size of the facets of their nodes, which may be larger.
        """
        half = float(self._thickness(np.full(len(self.corners), 2 * depth)).min()) / 2
        vars(self)["deepest"] = max(self.deepest, min(depth, half))  # the surface is unchanged
        self._segments.sink(np.array([self.deepest]))

    def _pairs(self, x: Floats, segment: Ints) -> tuple[Floats, Floats]:
        """Positions of nodes and facet vertices, (m, 1 + k, 3), and orientations."""
        pairs = np.concatenate([x[:, None], self.corners[segment]], axis=1)
        return pairs, self._orientation[segment]

    def contact(self, scheme: str, x_n: Floats, x: Floats, segment: Ints) -> ContactKinematics:
        pair_n, orientation = self._pairs(x_n, segment)
        pair, _ = self._pairs(x, segment)
        kernel = getattr(_kernels, f"contact_{scheme}")
        pairs = ContactKinematics(*kernel(pair_n, pair, orientation))
        return pairs._replace(
            force=pairs.force[:, :3],
            gradient=pairs.gradient[:, :3],
            tangent=pairs.tangent[:, :3, :3],
        )

    def slip(self, x_n: Floats, x: Floats, segment: Ints) -> Slip:
        pair_n, orientation = self._pairs(x_n, segment)
        pair, _ = self._pairs(x, segment)
        value, force, gradient, w, b, frame_n, frame = _kernels.slip(pair_n, pair, orientation)
        node = (force[:, :, :3], gradient[:, :, :3], w[:, :1], b[:, :, :1])
        return Slip(value, *node, frame_n=frame_n, frame=frame, orientation=orientation)

    def find(
        self, x: Floats, current: Ints, slack: float, reach: float, facing: Facing
    ) -> tuple[Ints, Floats]:
        faced = (*facing.arguments, np.full(len(self.key), np.inf))
        found, _, gap, _ = self._segments.pair(x, current, slack, reach, self._points, *faced)
        return found, gap

    def follow(self, x_n: Floats, x: Floats, inside: Ints, facing: Facing) -> Trajectories:
        ends = x_n, x, np.full(len(x), -1, dtype=np.int32), inside, self._points, self._points
        return Trajectories(*self._segments.follow(*ends, *facing.arguments))

    def depth(self, x: Floats) -> Floats:
        # Nodes touch only down to a depth of half a facet, or as `deepen` says.
        none = np.full(len(x), -1, dtype=np.int32)
        reach = max(float(diameters(self.corners).max(initial=0.0)), self.deepest)
        found, gap = self.find(x, none, _kernels.HYSTERESIS, reach, Facing.everywhere(len(x)))
        return np.where(found >= 0, -gap, 0.0)

    def within(self, points: Floats) -> Ints:
        """Find the facets that may be within the box around points, shape ``(m, 3)`` [m]."""
        least, greatest = self.corners.min(axis=1), self.corners.max(axis=1)
        apart = (least > points.max(axis=0)) | (greatest < points.min(axis=0))
        return indices(~apart.any(axis=1))

    def depth_behind(self, facets: Ints, begin: Floats, x: Floats) -> Floats:
        """Depth of points behind facets that straight paths to them enter, at any depth.

        Args:
            facets: The facets, shape ``(f,)``.
            begin: Starts of the paths, shape ``(m, 3)`` [m].
            x: The points, shape ``(m, 3)`` [m].

        Returns:
            Distances from the planes of entry, shape ``(m,)`` [m]; 0 if a path enters no facet,
            negative if its longest part behind the facets ends before the point.
        """
        chosen = self._facets[facets], self._orientation[facets], self.key[facets]
        none, everywhere = np.full(len(x), -1, dtype=np.int32), Facing.everywhere(len(x))
        ends = begin, x, none, none, self._points, self._points
        found = Trajectories(*_kernels.Segments(*chosen).follow(*ends, *everywhere.arguments))
        depth = np.where(found.leaves, -found.length, -found.gap)
        return np.where(found.entered >= 0, depth, 0.0)

    def is_at_rim(self, x: Floats, segment: Ints) -> Flags:
        return is_nearest_a_rim(x, self._points, self._facets, segment)

    def near(self, x: Floats, reach: float) -> Ints:
        near: Ints = self._segments.near(x, reach, self._points)
        return near


def _in_basix_order(points: Floats, facets: Ints) -> Ints:
    """Quadrilaterals with their corners in Basix order, shape ``(s, 4)``. Local.

    The order is unique: in any other order sides of a convex quadrilateral would intersect.

    Raises:
        ValueError: Neither order makes all of them convex.
    """
    in_basix, around = (_are_convex(points[facets[:, loop]]) for loop in (_AROUND, [0, 1, 2, 3]))
    if in_basix.all():
        return facets
    if around.all():
        return facets[:, _AROUND]
    raise ValueError(
        f"expected convex quadrilaterals, all with corners in Basix order (0,0), (1,0), (0,1), "
        f"(1,1), or all with corners around each facet (gmsh, VTK, meshio), given {len(facets)}, "
        f"of which {np.count_nonzero(in_basix)} are convex in Basix order and "
        f"{np.count_nonzero(around)} around; facet {np.flatnonzero(~in_basix)[0]} is not in Basix "
        f"order, facet {np.flatnonzero(~around)[0]} not around: cut facets that are not convex "
        "into triangles"
    )


def _are_convex(loop: Floats) -> Flags:
    """Whether quadrilaterals with corners ``(s, 4, 3)`` [m] in cyclic order are convex. Local.

    Corners may be collinear with their neighbours. Facets may be warped by up to 90 degrees
    between the planes at two corners.
    """
    to_next, to_last = np.roll(loop, -1, axis=1) - loop, np.roll(loop, 1, axis=1) - loop
    normals = np.cross(to_next, to_last)
    products = np.einsum("ski,sli->skl", normals, normals)
    largest = products.max(axis=(1, 2))
    alike = (products >= -_ROUND_OFF * largest[:, None, None]).all(axis=(1, 2))
    convex: Flags = (largest > 0) & alike
    return convex
