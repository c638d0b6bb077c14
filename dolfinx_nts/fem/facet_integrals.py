"""Integrals of shape functions over facets of the boundary."""

import basix
import numpy as np
from dolfinx import fem

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.elements import Element

__all__ = ["shape_integrals"]


def shape_integrals(V: fem.FunctionSpace, facets: Ints) -> tuple[Ints, Floats]:
    """Integrals of the shape functions of facets in the reference configuration. Local.

    The cost does not depend on the size of the space. In axisymmetric meshes the integrals are over
    the circumference.

    Args:
        V: Space of the displacement.
        facets: Local indices of facets on the boundary; those of ghost cells are left out.

    Returns:
        Nodes of each facet, local block indices, and integrals of their shape functions [m^2], both
        of shape ``(f, n)``.
    """
    mesh, element = V.mesh, Element.of(V)
    dim = mesh.topology.dim - 1
    to_cell = mesh.topology.connectivity(dim, dim + 1)
    cells = to_cell.array[to_cell.offsets[facets]]
    is_owned = cells < mesh.topology.index_map(dim + 1).size_local
    facets, cells = facets[is_owned], cells[is_owned]
    cell = basix.CellType[element.cell]
    sides = basix.topology(cell)[dim]
    to_facet = mesh.topology.connectivity(dim + 1, dim).array.reshape(-1, len(sides))
    number = (to_facet[cells] == facets[:, None]).argmax(axis=1)
    x = mesh.geometry.x[compat.geometry_nodes(mesh)[cells]][:, :, : dim + 1]
    linear = Element.known(element.cell, 1, element.is_axisymmetric)
    shape = linear if x.shape[1] == len(linear.points) else element
    # One more than is exact on plane facets, for warped and curved ones.
    degree = element.mass_degree + shape.degree + 1
    points, weights = basix.make_quadrature(basix.cell.subentity_types(cell)[dim][0], degree)
    closure = element.basix.entity_closure_dofs[dim]
    nodes = np.empty((len(facets), len(closure[0])), dtype=np.int32)
    integrals: Floats = np.empty(nodes.shape)
    for side, vertices in enumerate(sides):
        (of_side,) = (number == side).nonzero()
        corners = basix.geometry(cell)[vertices]
        tangents = (corners[1:] - corners[0])[:dim]
        at = corners[0] + points @ tangents
        values, *slopes = shape.basix.tabulate(1, at)[..., 0]
        along = np.einsum("jqg,tj->tqg", np.array(slopes), tangents)
        mapped = along[:, None] @ x[of_side]
        normal = mapped[0] if dim == 1 else np.cross(*mapped)
        area = weights * np.linalg.norm(normal, axis=2)
        if element.is_axisymmetric:
            area *= 2 * np.pi * (x[of_side, :, 0] @ values.T)
        nodes[of_side] = V.dofmap.list[cells[of_side]][:, closure[side]]
        integrals[of_side] = area @ element.basix.tabulate(0, at)[0, :, closure[side], 0].T
    return nodes, integrals
