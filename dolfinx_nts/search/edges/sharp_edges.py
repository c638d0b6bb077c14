"""Sharp convex edges of a surface, for edge-to-edge contact."""

from weakref import WeakKeyDictionary

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.fem.node_numbering import input_ids, reference_positions
from dolfinx_nts.model.obstacles.rims import FACET_EDGES, SHARP
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import places_among_all
from dolfinx_nts.search.global_search import GlobalSearch, owners_of
from dolfinx_nts.search.segment_candidates import SegmentCandidates

__all__ = ["SharpEdges", "sharp_between", "unit_normals"]

# Reach of the search for the facets around a node relative to the longest facet [-]: above
# round-off.
_AROUND = 1e-6
# Node numbers of up to 62 bits are sent in two parts, which floating-point numbers represent
# exactly.
_HALF = 1 << 31
# Order of the vertices of a facet that reverses its normal, by their number.
_REVERSED = {3: [0, 2, 1], 4: [0, 2, 1, 3]}


class SharpEdges:
    """Convex edges at which the normal of a surface turns by 30 degrees or more. Collective.

    The reference configuration decides which edges are sharp. Each edge belongs to the rank that
    owns its *carrier*, the end with the lower input number. Free edges of a surface are left out,
    since the geometry beyond them is unknown.

    Args:
        surface: The surface, of a mesh in space.

    Attributes:
        scatter: Map of the facets around the nodes of this rank.
        nodes: Carrier and other end of the ``e`` edges of this rank, in that map,
            shape ``(e, 2)``.
        facets: Vertices of both facets at each edge, oriented outward, shape ``(e, 2, k)``.
        key: Partition-independent number of each edge, shape ``(e,)``.
        thickness: Smaller height of both cells behind an edge, ``(e,)`` [m, reference].
        total: Number of edges on all ranks.
    """

    def __init__(self, surface: Surface) -> None:
        V = surface.V
        X = reference_positions(V)
        near, _ = GlobalSearch(surface, surface).update(X, _AROUND * surface.size)
        self.scatter = near.scatter
        ids = _numbers(input_ids(V), near)
        X = near.scatter.forward(X)
        edges, facets, outward = sharp_between(X, near.segments, near.orientation, ids)
        mine = edges[:, 0] < near.scatter.index_map.size_local
        self.nodes: Ints = np.ascontiguousarray(edges[mine])
        self.facets: Ints = outward[mine]
        *_, thickness = near.of_segments
        self.thickness: Floats = thickness[facets[mine]].min(axis=1)
        comm: MPI.Comm = V.mesh.comm
        self.key = places_among_all(comm, ids[self.nodes])
        self.total = reductions.total(comm, len(self.key))

    @classmethod
    def of(cls, surface: Surface) -> "SharpEdges":
        """Cached edges of a surface. Collective."""
        if surface not in _KNOWN:
            _KNOWN[surface] = cls(surface)
        return _KNOWN[surface]

    @property
    def offer(self) -> tuple[GlobalInts, Ints]:
        """Global numbers of all nodes of the edges, ``(e, 2 + 2 k)``, and their owners. Local."""
        both = np.prod(self.facets.shape[1:])
        rows = np.column_stack([self.nodes, self.facets.reshape(-1, both)])
        ids = self.scatter.index_map.local_to_global(rows.ravel()).reshape(rows.shape)
        return ids, owners_of(self.scatter.index_map, rows)

    def ends(self, x: Floats) -> Floats:
        """Positions of the ends, ``(2, e, 3)``, for positions of local nodes, ``(l, 3)`` [m].

        Collective.
        """
        ends: Floats = self.scatter.forward(x)[self.nodes.T]
        return ends


# Cache of the edges of surfaces.
_KNOWN: WeakKeyDictionary[Surface, SharpEdges] = WeakKeyDictionary()


def unit_normals(corners: Floats) -> Floats:
    """Unit normals of facets oriented outward, ``(..., k, 3)``; 0 if degenerate. Local."""
    vectors = area_vectors(corners.reshape(-1, *corners.shape[-2:]), np.ones(1))
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit: Floats = vectors / np.where(length > 0, length, 1.0)
    return unit.reshape(*corners.shape[:-2], 3)


def _numbers(local: GlobalInts, near: SegmentCandidates) -> GlobalInts:
    """Input numbers of all nodes of the map of the candidates. Collective."""
    halves = np.zeros((len(local), 3))
    halves[:, 0], halves[:, 1] = np.divmod(local, _HALF)
    first, second, _ = near.scatter.forward(halves).astype(np.int64).T
    numbers: GlobalInts = _HALF * first + second
    return numbers


def _edges_with_two_facets(segments: Ints, ids: GlobalInts) -> tuple[Ints, Ints]:
    """Edges that belong to two segments, lower number first, and both segments."""
    k = segments.shape[1]
    ends: Ints = segments[:, FACET_EDGES[k]].reshape(-1, 2)
    ends = np.take_along_axis(ends, np.argsort(ids[ends], axis=1), axis=1)
    facet = np.arange(len(ends), dtype=np.int32) // len(FACET_EDGES[k])
    order = np.lexsort((facet, *ids[ends].T[::-1]))
    ends, facet = ends[order], facet[order]
    follows = np.concatenate([[False], (ends[1:] == ends[:-1]).all(axis=1), [False]])
    # First of exactly two equal edges in a row.
    first = np.flatnonzero(~follows[:-2] & follows[1:-1] & ~follows[2:])
    return ends[first], np.column_stack([facet[first], facet[first + 1]])


def sharp_between(
    X: Floats, segments: Ints, orientation: Floats, ids: GlobalInts
) -> tuple[Ints, Ints, Ints]:
    """Find the sharp edges between two facets. Local.

    Args:
        X: Positions of all vertices in the reference configuration, shape ``(n, 3)`` [m].
        segments: Vertices of the facets, shape ``(s, k)``.
        orientation: +1 if they are oriented outward, otherwise -1, ``(s,)``.
        ids: Numbers of the vertices, by which ends are ordered, shape ``(n,)``.

    Returns:
        Ends of each edge ``(e, 2)``, both facets ``(e, 2)``, and vertices of these facets oriented
        outward, ``(e, 2, k)``.
    """
    edges, facets = _edges_with_two_facets(segments, ids)
    outward, k = segments.copy(), segments.shape[1]
    inward = orientation < 0
    outward[inward] = outward[inward][:, _REVERSED[k]]
    is_sharp = _is_sharp(X, outward, edges, facets)
    edges, facets = edges[is_sharp], facets[is_sharp]
    return edges, facets, outward[facets]


def _is_sharp(X: Floats, outward: Ints, edges: Ints, facets: Ints) -> Flags:
    """Whether edges are convex and sharp."""
    corners = X[outward[facets]]  # (e, 2, k, 3)
    normals = unit_normals(corners)
    cosine = np.einsum("ei,ei->e", normals[:, 0], normals[:, 1])
    beyond = corners[:, 1].mean(axis=1) - X[edges].mean(axis=1)
    flags: Flags = (cosine < SHARP) & (np.einsum("ei,ei->e", normals[:, 0], beyond) < 0)
    return flags
