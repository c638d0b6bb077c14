"""Surfaces: tagged facets as nodes and segments of contact.

A *node* (in the literature: slave, secondary, source) may touch a *segment* (master, primary,
target). A surface has both, and a contact pair decides which it uses. A facet of degree 1 is one
segment, a facet of degree 2 is divided into four. Positions are x = X + u; the mesh never moves.
"""

import math
from collections.abc import Callable
from copy import copy
from functools import cached_property
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.mesh import MeshTags, locate_entities_boundary, meshtags

from dolfinx_nts import _kernels
from dolfinx_nts.common.arguments import as_call, label
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.common.named_tag import NamedTag
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.elements import Element, check_space, check_tag
from dolfinx_nts.fem.facet_integrals import shape_integrals
from dolfinx_nts.fem.few_nodes import nodes_on_any_rank, sums_at
from dolfinx_nts.fem.node_numbering import input_ids, reference_positions
from dolfinx_nts.model.facet_segments import facet_segments
from dolfinx_nts.model.obstacles.rigid_shapes import RigidSphere
from dolfinx_nts.model.segments import NEIGHBOURS, area_vectors, diameters
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined, places_among_all
from dolfinx_nts.parallel.errors import agreed

__all__ = [
    "FINE",
    *(
        "Smooth",
        "Surface",
        "boundary_facets",
        "facet_shares",
        "facet_size_towards",
        "facing_segments",
    ),
    "sharpest_corner",
]

# Length of an edge relative to the largest segment [-] that counts as zero.
_NO_LENGTH = 1e-12
# Fraction of the force and area of a mid-node [-] that is moved to each adjacent vertex: a uniform
# pressure has no nodal force at the vertices of triangles of degree 2.
_TO_END = 1 / 8
# Least area of a node relative to the mean share of its facets [-], for laws of friction. At the
# vertices of triangles of degree 2 the integral of the shape function is zero to round-off. Larger:
# nodes have a larger area in total; smaller: pressures at these vertices, which have hardly any
# force, become large.
_LEAST_SHARE = 1e-3
# Least cosine between the normal of a facet and the direction to a body that it faces [-]. Larger:
# few facets of round bodies are included; smaller: the lateral facets of a plate are included.
_FACING = 0.5
# The size of a surface is this quantile [-] of the diameters of its facing facets. Larger: coarse
# facets next to the contact hide its refinement (at 0.5 a graded block below a punch with the same
# facets is 1.7 times coarser); smaller: single small facets determine the size. The second number
# is the distance up to which facets are included, relative to a facet [-].
FINE, _BESIDE = 0.25, 2
# Largest distance of vertices from the sphere of a surface, relative to the radius [-].
_ON_SPHERE = 1e-3

# Shape of the segments, see `Surface`.
Smooth = bool | RigidSphere


class Surface(Declaration):
    """Part of the boundary: facets with one tag, as nodes and segments of contact. Collective.

    `where` and `of` create surfaces without tags.

    Args:
        V: Vector space of the displacement, ``("Lagrange", 1, (3,))`` or of degree 2.
        facets: Facet tags of the mesh.
        tag: Value of the tag.
        smooth: Whether contact uses curved patches through the nodes of the surface instead of
            flat facets (``search/smooth/smooth_patches.py``), for its segments and, in
            surface-to-surface contact, for the surface itself. Edges at which facets turn by 30
            degrees or more stay sharp. Needs degree 1. With a `RigidSphere`, contact uses that
            sphere exactly; the surface must belong to a `RigidBody`, which moves the sphere, with
            all its vertices on the sphere.
        name: Name in messages, columns and legends; empty for the name of the region, or
            ``surface`` with the tag.

    Attributes:
        V, smooth: The arguments.
        name: The argument, or the automatic name.
        nodes: Nodes of the surface that this rank owns, local block indices of V, sorted, shape
            ``(n,)``.
        segments: Vertices of the segments on facets that this rank owns, local block indices of
            V, owned or ghost, in Basix order, shape ``(s, k)``, ``k`` 3 or 4.
        facet: Local index of the facet of each segment, shape ``(s,)``.
        orientation: +1 if the product a_1 x a_2 of the tangents of a segment points out of its
            body, otherwise -1, shape ``(s,)``.
        key: Partition-independent number of each segment, shape ``(s,)``.
        thickness: Height of the cell behind each segment in the reference configuration, shape
            ``(s,)`` [m].
        size: Longest diameter of a segment on any rank in the reference configuration [m].

    Raises:
        TypeError: ``V`` is not a function space, ``facets`` not MeshTags, ``tag`` not an integer,
            or ``smooth`` neither a bool nor a RigidSphere.
        ValueError: The space or the tag does not fit, a facet is not on the boundary, or a vertex
            not on the sphere.

    Example:
        >>> top = nts.Surface(V, facets, tag["lower_top"])
        >>> top.nodes.size, top.segments.shape
        (9, (4, 4))
        >>> top = nts.Surface.where(V, lambda x: np.isclose(x[2], 0.5))
        >>> round(float(top.area.sum()), 9)  # m^2
        1.0
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        facets: MeshTags,
        tag: int,
        *,
        smooth: Smooth = False,
        name: str = "",
    ) -> None:
        check_space(V)
        if smooth and (degree := Element.of(V).degree) > 1:
            raise ValueError(
                f"expected displacements of degree 1 with smooth=True, given degree {degree}: on "
                "curved cells (setOrder(2) in gmsh) surfaces of degree 2 are round themselves"
            )
        mesh = V.mesh
        check_tag(V, facets, tag, mesh.topology.dim - 1, "facets")
        if not isinstance(smooth, bool | RigidSphere):
            raise TypeError(f"expected smooth=True, False or a RigidSphere, given {smooth!r}")
        self.V, self._facets, self._tag, self.smooth = V, facets, tag, smooth
        self.name = label(name) or NamedTag.name_of(tag, "surface")

        found = facet_segments(V, facets, tag)
        if len(found.facets) < len(facets.find(tag)):
            values = np.full_like(found.facets, tag)
            self._facets = meshtags(mesh, mesh.topology.dim - 1, found.facets, values)
        # Nodes belong to all local facets, segments only to owned facets.
        nodes = nodes_on_any_rank(V, found.vertices)
        self.nodes: Ints = nodes[nodes < V.dofmap.index_map.size_local]
        self.segments: Ints = found.vertices[found.is_owned]
        per_facet = len(found.vertices) // max(len(found.facets), 1)
        self.facet: Ints = np.repeat(found.facets, per_facet)[found.is_owned]
        self.orientation: Floats = found.orientation[found.is_owned]
        self.thickness: Floats = found.thickness[found.is_owned]
        ids = np.sort(input_ids(V)[self.segments], axis=1)
        self.key = places_among_all(mesh.comm, ids)
        x = reference_positions(V)[self.segments]
        if isinstance(smooth, RigidSphere):
            self._check_sphere(smooth, x)
        self.size = float(reductions.largest(mesh.comm, diameters(x).max(initial=0.0)))

    def _check_sphere(self, sphere: RigidSphere, x: Floats) -> None:
        """Check that the vertices of the segments, ``(s, k, 3)`` [m], are on a sphere."""
        if sphere.is_hollow or sphere.dim != dimension(self.V) or not sphere.motion.is_rest:
            raise ValueError(
                f"expected a RigidSphere of {dimension(self.V)} coordinates that is neither hollow "
                f"nor moving as the shape of {self.name}, given {sphere!r}: the body moves it"
            )
        off = float(np.abs(sphere.distance(x.reshape(-1, 3))[0]).max(initial=0.0))
        off = float(reductions.largest(self.V.mesh.comm, off))
        if off > _ON_SPHERE * sphere.radius:
            raise ValueError(
                f"expected facets of {self.name} with vertices on {sphere!r}, given some that are "
                f"{off:.3g} m off it: select facets of the round part by where= or a tag"
            )

    def __repr__(self) -> str:
        """Tag, and numbers of nodes and segments on this rank. Local."""
        sizes = {"owned_nodes": len(self.nodes), "owned_segments": len(self.segments)}
        kind = {"smooth": self.smooth} if self.smooth else {}
        return as_call(self, tag=int(self._tag), name=self.name, **kind, **sizes)

    @classmethod
    def where(
        cls,
        V: fem.FunctionSpace,
        predicate: Callable[[Any], Any],
        *,
        smooth: Smooth = False,
        name: str = "",
    ) -> "Surface":
        """Create a surface from the boundary facets selected by a predicate. Collective.

        Args:
            V: Vector space of the displacement.
            predicate: Function of reference positions, shape ``(3, n)`` [m], that returns
                ``(n,)`` booleans; a facet is selected if they are true at all its vertices.
            smooth: See the class.
            name: See the class; empty for "a part of the boundary".

        Returns:
            The surface.

        Raises:
            TypeError: The predicate is not a function, or does not return booleans.
            ValueError: The space does not fit, the function returns another shape, or no facet
                is selected.
        """
        facets = boundary_facets(V, predicate)
        return cls.of(V, facets, label(name) or "a part of the boundary", smooth=smooth)

    @classmethod
    def of(
        cls,
        V: fem.FunctionSpace,
        facets: Ints,
        name: str = "a part of the boundary",
        *,
        smooth: Smooth = False,
    ) -> "Surface":
        """Create a surface from given facets. Collective.

        Args:
            V: Vector space of the displacement.
            facets: Local indices of facets on the boundary, each on the rank that owns it,
                shape ``(s,)``.
            name: Name of the surface in messages.
            smooth: See the class.

        Returns:
            The surface.

        Raises:
            ValueError: There is no facet on any rank, or one is not on the boundary.
        """
        if not reductions.total(V.mesh.comm, len(facets)):
            raise ValueError(
                f"expected facets of the boundary, given none: the mesh has {_extent(V)}; the "
                "condition must be true at all vertices of a facet: compare by np.isclose"
            )
        ordered = np.sort(facets).astype(np.int32)
        tags = meshtags(V.mesh, V.mesh.topology.dim - 1, ordered, np.ones_like(ordered))
        return cls(V, tags, NamedTag(1, name), smooth=smooth)

    @cached_property
    def node_ids(self) -> GlobalInts:
        """Partition-independent numbers of the nodes, shape ``(n,)``.

        Vertices have their input numbers.
        """
        return input_ids(self.V)[self.nodes]

    @property
    def owned_facets(self) -> Ints:
        """Facets that this rank owns, local indices, shape ``(f,)``. Local."""
        mesh = self.V.mesh
        facets: Ints = self._facets.find(self._tag)
        num_owned: int = mesh.topology.index_map(mesh.topology.dim - 1).size_local
        return facets[facets < num_owned]

    def with_nodes(self, flags: Flags) -> "Surface":
        """Copy of the surface with some of its nodes only. Local.

        Args:
            flags: Flags of the owned nodes that the copy keeps, shape ``(n,)``.

        Returns:
            The surface, with the same segments.
        """
        surface = copy(self)
        own = vars(surface)
        own["nodes"] = self.nodes[flags]
        for name in ("node_ids", "area", "positive_area", "_middles"):
            own.pop(name, None)
        return surface

    def smoothed(self, *, smooth: bool = True) -> "Surface":
        """Copy of the surface with curved patches, of degree 1, or with flat facets. Local."""
        surface = copy(self)
        vars(surface)["smooth"] = smooth
        return surface

    def measure(self, degree: int | None = None) -> ufl.Measure:
        """Measure for integrals over the reference surface. Local.

        In an axisymmetric mesh the factor 2 pi r is not included.

        Args:
            degree: Degree of the quadrature; None for the estimate of UFL.

        Returns:
            UFL measure.
        """
        return ufl.Measure(
            "ds",
            domain=self.V.mesh,
            subdomain_data=self._facets,
            subdomain_id=int(self._tag),
            metadata={} if degree is None else {"quadrature_degree": degree},
        )

    @cached_property
    def area(self) -> Floats:
        """Reference area of each node, shape ``(n,)`` [m^2].

        It is the integral of the shape function, in axisymmetric meshes over the circumference.
        Collective at the first use.
        """
        nodes, integrals = shape_integrals(self.V, self._facets.find(self._tag))
        return sums_at(self.V, self.nodes, nodes.ravel(), integrals.reshape(-1, 1))[:, 0]

    @cached_property
    def positive_area(self) -> Floats:
        """As `area`, but positive at all nodes, also at degree 2, shape ``(n,)`` [m^2].

        Collective at the first use.
        """
        if self._degree == 1:
            return self.area
        shares = np.tile(facet_shares(self), self.segments.shape[1])[:, None]
        mean = sums_at(self.V, self.nodes, self.segments.T.ravel(), shares)[:, 0]
        area: Floats = np.maximum(self.area, _LEAST_SHARE * mean)
        return area

    def per_area(self, force: Floats, area: Floats | None = None) -> Floats:
        """Convert nodal forces to tractions. Collective.

        Uniform tractions are exact. At degree 2 an eighth of the force and of the area of each
        mid-node is first moved to each adjacent vertex.

        Args:
            force: Forces, shape ``(n,)`` or ``(n, 3)`` [N].
            area: Areas on which they act, shape ``(n,)`` [m^2], 0 only at nodes without force;
                None for the attribute `area`.

        Returns:
            Forces per reference area, of the same shape [Pa].
        """
        values = np.column_stack([self.area if area is None else area, force])
        return _ratios(self.spread(values)).reshape(force.shape)

    def spread(self, values: Floats) -> Floats:
        """Move an eighth of the values of each mid-node to each adjacent vertex. Collective.

        Args:
            values: Values of the nodes, shape ``(n,)`` or ``(n, m)``.

        Returns:
            Values of the same shape; at degree 1 the argument.
        """
        if self._degree == 1:
            return values
        columns = values.reshape(len(values), math.prod(values.shape[1:]))
        node, end = self._middles.T
        vector = la.vector(self.V.dofmap.index_map, columns.shape[1])
        spread: Floats = vector.array.reshape(-1, columns.shape[1])
        spread[self.nodes] = columns
        given = _TO_END * spread[node]
        np.add.at(spread, end, given)
        np.subtract.at(spread, node, given)
        vector.scatter_reverse(la.InsertMode.add)
        return spread[self.nodes].reshape(values.shape)

    @cached_property
    def _box(self) -> Floats:
        """Bounding box in the reference configuration, ``(2, 3)`` [m]."""
        x, comm = reference_positions(self.V)[self.segments].reshape(-1, 3), self.V.mesh.comm
        least = reductions.least(comm, x.min(axis=0, initial=np.inf))
        largest = reductions.largest(comm, x.max(axis=0, initial=-np.inf))
        return np.array([least, largest])

    @cached_property
    def _degree(self) -> int:
        return Element.of(self.V).degree

    @cached_property
    def _middles(self) -> Ints:
        """Pairs of an owned mid-node and an adjacent vertex, local nodes, shape ``(m, 2)``."""
        dofs, element = self.V.dofmap.list, Element.of(self.V)
        rows = [np.empty((0, 2), dtype=np.int32)]
        for node, pairs in enumerate(element.diagonals):
            cells = dofs[np.isin(dofs[:, node], self.nodes)]
            for end in np.unique(pairs):
                if end != node:
                    rows.append(cells[:, [node, end]])
        return np.unique(np.concatenate(rows), axis=0)


def _ratios(values: Floats) -> Floats:
    """Forces, columns 1, 2, ..., divided by areas, column 0; 0 for zero areas."""
    ratios: Floats = values[:, 1:] / np.where(values[:, :1] > 0, values[:, :1], np.inf)
    return ratios


def sharpest_corner(surface: Surface) -> float:
    """Least sine of an angle between two edges of a segment. Collective.

    Args:
        surface: The surface.

    Returns:
        The sine in the reference configuration [-], 0 if an edge has no length.
    """
    x = reference_positions(surface.V)[surface.segments]
    if x.shape[1] == 2:  # edges have no corner
        has_length = diameters(x) > _NO_LENGTH * surface.size
        return float(reductions.everywhere(surface.V.mesh.comm, bool(has_length.all())))
    neighbours = np.array(NEIGHBOURS[surface.segments.shape[1]])
    a, b = (x[:, neighbours[:, side]] - x for side in (0, 1))
    length_a, length_b = np.linalg.norm(a, axis=-1), np.linalg.norm(b, axis=-1)
    area = np.linalg.norm(np.cross(a, b), axis=-1)
    good = np.minimum(length_a, length_b) > _NO_LENGTH * surface.size
    sine = np.divide(area, length_a * length_b, out=np.zeros_like(area), where=good)
    return float(reductions.least(surface.V.mesh.comm, sine.min(initial=1.0)))


def facet_shares(surface: Surface) -> Floats:
    """Reference area of each facet divided by its number of nodes, shape ``(s,)`` [m^2]. Local.

    In axisymmetric meshes it is the area of the whole circumference.
    """
    X = reference_positions(surface.V)[surface.segments]
    share: Floats = np.linalg.norm(area_vectors(X, surface.orientation), axis=1) / X.shape[1]
    if is_axisymmetric(surface.V.mesh):
        share = 2 * np.pi * X[:, :, 0].mean(axis=1) * share
    return share


def facing_segments(surface: Surface, *others: Surface) -> tuple[Floats, Flags]:
    """Segments of a surface that face others. Collective.

    They are opposite the bounding boxes of the nearest other surfaces, at most two facets farther
    from them than the nearest segment. If there are none, all segments count.

    Returns:
        Diameters of the segments of all ranks, shape ``(s,)`` [m], and flags, ``(s,)``.
    """
    x = reference_positions(surface.V)[surface.segments]
    comm: MPI.Comm = surface.V.mesh.comm
    lengths = joined(comm, diameters(x))
    every = np.ones(len(lengths), dtype=bool)
    if not others:
        return lengths, every
    size = float(np.quantile(lengths, FINE))
    centre = joined(comm, x.mean(axis=1))
    normal = _kernels.unit_vectors(joined(comm, area_vectors(x, surface.orientation)))
    low, high = surface._box
    lows, highs = np.moveaxis(np.array([other._box for other in others]), 1, 0)
    apart = np.linalg.norm(np.fmax(np.fmax(lows - high, low - highs), 0.0), axis=1)
    faces = np.zeros(len(lengths), dtype=bool)
    for nearest in np.flatnonzero(apart <= apart.min() + _BESIDE * size):
        to_box = np.clip(centre, lows[nearest], highs[nearest]) - centre
        distance = np.linalg.norm(to_box, axis=1)
        is_turned = np.einsum("si,si->s", normal, to_box) >= _FACING * distance
        faces |= is_turned & (distance <= apart[nearest] + _BESIDE * size)
    return lengths, faces if faces.any() else every


def facet_size_towards(surface: Surface, *others: Surface) -> float:
    """Lower quartile of the diameters of the facets that face others [m]. Collective.

    Surfaces are refined where contact is expected.
    """
    lengths, faces = facing_segments(surface, *others)
    return float(np.quantile(lengths[faces], FINE))


def boundary_facets(V: fem.FunctionSpace, predicate: Callable[[Any], Any]) -> Ints:
    """Boundary facets selected by a predicate. Collective.

    Args:
        V: Vector space of the displacement.
        predicate: As in `Surface.where`.

    Returns:
        Local indices, sorted, shape ``(s,)``.

    Raises:
        TypeError: The predicate is not a function, or does not return booleans.
        ValueError: The space does not fit, or the function returns another shape.
    """
    check_space(V)

    if not callable(predicate):
        raise TypeError(
            f"expected a function of positions, such as lambda x: x[2] < 0.1, given {predicate!r}"
        )

    def checked(x: Floats) -> Any:
        with agreed(V.mesh.comm, "select facets of the boundary"):
            inside = np.asarray(predicate(x))
            if inside.shape != x.shape[1:]:
                raise ValueError(
                    f"expected a boolean for each of {x.shape[1]} positions x of shape {x.shape}, "
                    f"such as x[2] < 0.1, given shape {inside.shape}"
                )
            # On a rank without facets the result may be an empty list of another type.
            if inside.size and inside.dtype != bool:
                raise TypeError(
                    f"expected a boolean for each position x, such as x[2] < 0.1, given "
                    f"{inside.dtype}: compare numbers, for instance by np.isclose(x[2], 0.1)"
                )
        return inside.astype(bool)

    facets: Ints = locate_entities_boundary(V.mesh, V.mesh.topology.dim - 1, checked)
    return facets


def _extent(V: fem.FunctionSpace) -> str:
    """Bounding box of the mesh in words. Collective."""
    X = reference_positions(V)[:, : dimension(V)]
    low = reductions.least(V.mesh.comm, X.min(axis=0, initial=np.inf))
    high = reductions.largest(V.mesh.comm, X.max(axis=0, initial=-np.inf))
    size = np.abs([low, high]).max()
    ends = zip("xyz", *(np.array([low, high]) / size).round(9) * size + 0.0, strict=False)
    return ", ".join(f"{axis} from {a:.6g} to {b:.6g}" for axis, a, b in ends)
