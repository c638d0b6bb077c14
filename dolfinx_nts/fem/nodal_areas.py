"""Areas of facets, shared out among their nodes."""

import basix
import numpy as np
from dolfinx import fem, la

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.elements import Element

__all__ = ["nodal_areas"]


def nodal_areas(V: fem.FunctionSpace, cells: Ints, sides: Ints) -> Floats:
    """Integrate the shape functions of the nodes over facets in the reference state. Collective.

    Args:
        V: Vector space of the displacement.
        cells: Cell of each facet that this rank owns, shape ``(s,)``.
        sides: Number of the facet in its cell, shape ``(s,)``.

    Returns:
        Areas of the owned nodes, of rings around their whole circumference, ``(n,)`` [m^2].
    """
    element, X = Element.of(V), V.tabulate_dof_coordinates()
    cell = basix.CellType[element.cell]
    facets, kinds = (of(cell)[-2] for of in (basix.topology, basix.cell.subentity_types))
    total = la.vector(V.dofmap.index_map)
    for side, axes in enumerate(basix.cell.facet_jacobians(cell)):
        points, weights = basix.make_quadrature(kinds[side], element.mass_degree)
        points = basix.geometry(cell)[facets[side][0]] + points @ axes.T
        values, *gradients = element.basix.tabulate(1, points)[..., 0]
        nodes = V.dofmap.list[cells[sides == side]]
        # Tangents of the facets by each of its axes, (t, s, q, 3).
        along = np.einsum("dqk,dt->tqk", gradients, axes)
        tangents = np.einsum("tqk,ski->tsqi", along, X[nodes])
        normal = np.cross(*tangents) if len(tangents) == 2 else tangents[0]
        density = weights * np.linalg.norm(normal, axis=-1)
        if element.makes_rings:
            density *= 2 * np.pi * X[nodes, 0] @ values.T
        np.add.at(total.array, nodes, density @ values)
    total.scatter_reverse(la.InsertMode.add)
    areas: Floats = total.array[: V.dofmap.index_map.size_local]
    return areas
