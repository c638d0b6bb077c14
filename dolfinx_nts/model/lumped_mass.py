"""Lumped mass: positive masses of the nodes in the place of the mass matrix.

At degree 1 the sums of its rows. At degree 2 these are negative at the
vertices of tetrahedra; instead its diagonal in the reference cell, scaled to
the mass of the cell (Hinton, Rock and Zienkiewicz 1976), is the rule of
quadrature at the nodes: Simpson's in hexahedra, and 1/36 at the vertices and
4/27 at the edges of tetrahedra. Mass and centre of mass of each cell are kept.
"""

from collections.abc import Sequence

import basix
import numpy as np
from dolfinx import la

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.model.bodies import Body

__all__ = ["lumped_mass", "nodal_parts"]


def lumped_mass(bodies: Sequence[Body]) -> Floats:
    """Masses of the owned nodes, shape ``(n,)`` [kg]. Collective.

    Args:
        bodies: Bodies of one space.
    """
    V = bodies[0].V
    element, geometry = Element.of(V), V.mesh.geometry
    mass = la.vector(V.dofmap.index_map, 1)
    for body in bodies:
        parts = nodal_parts(element, geometry.x[compat.geometry_nodes(V.mesh)[body.cells]])
        np.add.at(mass.array, V.dofmap.list[body.cells], body.material.rho * parts)
    mass.scatter_reverse(la.InsertMode.add)
    owned: Floats = mass.array[: V.dofmap.index_map.size_local].copy()
    return owned


def nodal_parts(element: Element, x: Floats) -> Floats:
    """Volume of cells that belongs to each of their nodes. Local.

    Args:
        element: Element of the cells.
        x: Vertices, shape ``(c, k, 3)`` [m].

    Returns:
        Volume, shape ``(c, n)`` [m^3].
    """
    points, weights, shares = _rule(element)
    slopes = Element(element.cell, 1).basix.tabulate(1, points)[1:, :, :, 0]
    volume = np.abs(np.linalg.det(np.einsum("jqv,cvi->cqij", slopes, x)))
    parts: Floats = (volume * weights) @ shares
    return parts


def _rule(element: Element) -> tuple[Floats, Floats, Floats]:
    """Points ``(q, 3)``, weights ``(q,)``, share of each node ``(q, n)``."""
    cell = basix.CellType[element.cell]
    points, weights = basix.make_quadrature(cell, element.mass_degree)
    values = element.basix.tabulate(0, points)[0, :, :, 0]
    if element.degree == 1:
        return points, weights, values
    diagonal = weights @ values**2
    return (
        element.points,
        diagonal * weights.sum() / diagonal.sum(),
        np.eye(len(element.points)),
    )
