"""Segments of tagged facets, with their orientation."""

from typing import NamedTuple

import numpy as np
from dolfinx import fem
from dolfinx.mesh import MeshTags

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.fem.axisymmetry import is_on_axis
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.segments import area_vectors
from dolfinx_nts.parallel import reductions

__all__ = ["FacetSegments", "facet_segments"]

# Distance of the centre of a cell from one of its facets, relative to the cell height [-].
_CENTRE = {"tetrahedron": 1 / 4, "triangle": 1 / 3, "hexahedron": 1 / 2, "quadrilateral": 1 / 2}


class FacetSegments(NamedTuple):
    """Segments on all local facets of a tag.

    Attributes:
        vertices: Local block indices of their vertices in Basix order, shape ``(s, k)``.
        is_owned: Whether this rank owns their facets, shape ``(s,)``.
        orientation: Orientations as in `Surface`, shape ``(s,)``.
        thickness: Undeformed height of the cell behind each segment, shape ``(s,)`` [m].
        facets: The facets, without those on the axis of an axisymmetric mesh, shape ``(f,)``.
    """

    vertices: Ints
    is_owned: Flags
    orientation: Floats
    thickness: Floats
    facets: Ints


def facet_segments(V: fem.FunctionSpace, facets: MeshTags, tag: int) -> FacetSegments:
    """Collect the segments of the facets with a tag. Collective.

    Args:
        V: Vector space of the displacement.
        facets: Facet tags of its mesh.
        tag: Value of the tag.

    Returns:
        The segments, without those on the axis of an axisymmetric mesh, which bounds no body.

    Raises:
        ValueError: A facet is not on the boundary, or all are on the axis.
    """
    mesh, element = V.mesh, Element.of(V)
    local = facets.find(tag)
    cells, owned = _cells_behind(V, local, tag)
    tdim = mesh.topology.dim
    to_facet = mesh.topology.connectivity(tdim, tdim - 1)
    number = to_facet.array.reshape(-1, len(element.sides))[cells] == local[:, None]
    # Vertices of each segment, and of the sub-cell behind it.
    on_facet, behind = (
        V.dofmap.list[cells][
            np.arange(len(local))[:, None, None], np.array(nodes)[number.argmax(axis=1)]
        ]
        for nodes in zip(*element.sides, strict=True)
    )
    X = reference_positions(V)
    outward = (X[on_facet].mean(axis=2) - X[behind].mean(axis=2)).reshape(-1, 3)
    vertices: Ints = on_facet.reshape(-1, on_facet.shape[2])
    is_surface = ~is_on_axis(mesh, X[vertices]).all(axis=1)
    if not reductions.anywhere(mesh.comm, bool(is_surface.any())):
        raise ValueError(f"expected facets of a surface, given tag {tag} on the axis only")
    vertices, outward = vertices[is_surface], outward[is_surface]
    are_segments = is_surface.reshape(on_facet.shape[:2])
    # The mean normal is used, as a corner normal does not exist if an edge has zero length.
    normal = area_vectors(X[vertices], np.ones(len(vertices)))
    height = np.einsum("si,si->s", normal, outward)
    length = np.linalg.norm(normal, axis=1)
    height /= np.where(length > 0, length, np.inf)
    return FacetSegments(
        vertices,
        np.repeat(owned, on_facet.shape[1])[is_surface],
        np.where(height > 0, 1.0, -1.0),
        element.degree * np.abs(height) / _CENTRE[element.cell],
        local[are_segments.any(axis=1)],
    )


def _cells_behind(V: fem.FunctionSpace, local: Ints, tag: int) -> tuple[Ints, Flags]:
    """Cell of each local facet, and whether this rank owns the facet. Collective.

    Raises:
        ValueError: A facet is between two cells.
    """
    mesh, tdim = V.mesh, V.mesh.topology.dim
    mesh.topology.create_connectivity(tdim - 1, tdim)
    mesh.topology.create_connectivity(tdim, tdim - 1)
    to_cell = mesh.topology.connectivity(tdim - 1, tdim)
    first = to_cell.offsets[local]
    owned: Flags = local < mesh.topology.index_map(tdim - 1).size_local
    # Without ghost cells a facet between two ranks has one local cell.
    between = np.isin(local, mesh.topology.interprocess_facets())
    between |= to_cell.offsets[local + 1] - first != 1
    if inner := reductions.total(mesh.comm, int(np.count_nonzero(between & owned))):
        raise ValueError(
            f"expected facets on the boundary, given tag {tag} with {inner} between two cells"
        )
    return to_cell.array[first], owned
