"""Facets of a rank, and their neighbours, in the reference configuration."""

from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.fem.node_numbering import input_ids, reference_positions
from dolfinx_nts.model.obstacles.rims import FACET_EDGES, SHARP
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel.communication import exchanged
from dolfinx_nts.search.global_search import owners_of

__all__ = ["NearFacets", "local_edges"]


class NearFacets(NamedTuple):
    """Facets of a surface that share a vertex with one of this rank. Local.

    Around vertices of facets of this rank, the facets and their order are the same as in a serial
    run.

    Attributes:
        X: Reference positions of the ``n`` nodes in the order of their input numbers, shape
            ``(n, 3)`` [m].
        facets: Vertices of the facets in Basix order, ordered by key, shape ``(f, k)``.
        orientation: +1 if a_1 x a_2 points outward, otherwise -1, shape ``(f,)``.
        edges: Both ends of each edge; in the plane these are the facets, shape ``(e, 2)``.
        facet_edges: Edges of each facet in the order of `local_edges`, shape ``(f, c)``.
        is_feature: Flags of edges at which the surface turns by 30 degrees or more or ends; all
            edges in the plane, shape ``(e,)``.
        own: Facets of this rank, in the order of the segments of the surface, shape ``(s,)``.
        dofs: Global numbers of the nodes in the space, shape ``(n,)``.
        owners: Ranks that own the nodes, shape ``(n,)``.
    """

    X: Floats
    facets: Ints
    orientation: Floats
    edges: Ints
    facet_edges: Ints
    is_feature: Flags
    own: Ints
    dofs: GlobalInts
    owners: Ints

    @classmethod
    def of(cls, surface: Surface) -> "NearFacets":
        """Collect the facets of this rank and their neighbours. Collective."""
        space, comm = surface.V.dofmap.index_map, surface.V.mesh.comm
        vertices = surface.segments
        rows: tuple[Any, ...] = (
            surface.key,
            surface.orientation,
            input_ids(surface.V)[vertices],
            reference_positions(surface.V)[vertices],
            space.local_to_global(vertices.ravel()).reshape(vertices.shape),
            owners_of(space, vertices),
        )
        rows = rows if comm.size == 1 else _around(comm, rows)
        key, first = np.unique(rows[0], return_index=True)
        orientation, ids, X, dofs, owners = (values[first] for values in rows[1:])
        _, first, node = np.unique(ids.ravel(), return_index=True, return_inverse=True)
        facets = node.reshape(ids.shape).astype(np.int32)
        X = X.reshape(-1, 3)[first]
        edges, facet_edges = _edges(facets)
        is_feature = _features(X, facets, orientation, len(edges), facet_edges)
        own = np.searchsorted(key, surface.key).astype(np.int32)
        dofs, owners = dofs.ravel()[first], owners.ravel()[first]
        return cls(X, facets, orientation, edges, facet_edges, is_feature, own, dofs, owners)

    @property
    def normals(self) -> Floats:
        """Outward area vectors of the facets, shape ``(f, 3)`` [m^2]."""
        return area_vectors(self.X[self.facets], self.orientation)


def local_edges(k: int) -> list[tuple[int, int]]:
    """Vertices at both ends of each edge of a facet of k vertices; one edge in the plane."""
    return [(0, 1)] if k == 2 else [(a, b) for a, b in FACET_EDGES[k]]


def _around(comm: MPI.Comm, rows: tuple[Any, ...]) -> tuple[Any, ...]:
    """Facets of this rank and their neighbours, with duplicates. Collective.

    Owners of nodes collect all adjacent facets and send them to the ranks of these facets. The
    last two columns are the nodes and their owners.
    """
    owners = rows[-1]
    parts = {rank: (owners == rank).any(axis=1) for rank in {comm.rank, *owners.flat}}
    at_nodes = exchanged(
        comm, {rank: tuple(values[part] for values in rows) for rank, part in parts.items()}
    )
    everything = tuple(map(np.concatenate, zip(*at_nodes.values(), strict=True)))
    answers = {}
    for rank, (*_, dofs, owners) in at_nodes.items():
        part = np.isin(everything[-2], dofs[owners == comm.rank]).any(axis=1)
        answers[rank] = tuple(values[part] for values in everything)
    return tuple(map(np.concatenate, zip(*exchanged(comm, answers).values(), strict=True)))


def _edges(facets: Ints) -> tuple[Ints, Ints]:
    """Edges of facets, lower number first, and edges of each facet."""
    ends = np.sort(facets[:, local_edges(facets.shape[1])], axis=2)
    edges, number = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
    return edges, number.reshape(ends.shape[:2]).astype(np.int32)


def _features(
    X: Floats, facets: Ints, orientation: Floats, num_edges: int, facet_edges: Ints
) -> Flags:
    """Flags of feature edges: free edges, and edges at which facets turn by 30 degrees or more."""
    if facets.shape[1] == 2:
        return np.ones(num_edges, dtype=bool)
    normals = area_vectors(X[facets], orientation)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals /= np.where(length > 0, length, 1.0)
    facet = np.repeat(np.arange(len(facets)), facet_edges.shape[1])
    order = np.argsort(facet_edges.ravel(), kind="stable")
    edge, facet = facet_edges.ravel()[order], facet[order]
    count = np.bincount(edge, minlength=num_edges)
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    two = np.flatnonzero(count == 2)
    cosine = np.einsum("ei,ei->e", normals[facet[first[two]]], normals[facet[first[two] + 1]])
    is_feature = np.ones(num_edges, dtype=bool)
    is_feature[two] = cosine < SHARP
    return is_feature
