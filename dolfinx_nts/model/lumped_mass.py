"""Lumped mass: a diagonal mass matrix with positive entries.

At degree 1 the masses are the row sums of the consistent matrix. At degree 2 row sums are negative
at the vertices of tetrahedra. Instead the diagonal of the matrix on the reference cell, scaled to
the mass of the cell (Hinton, Rock and Zienkiewicz 1976), gives the weights of a nodal quadrature:
Simpson's rule in hexahedra, and 1/36 at the vertices and 4/27 at the edges of tetrahedra. Each
straight cell has its exact mass and centre of mass. In curved cells, and in axisymmetric ones of
degree 2, the diagonal of the actual cell matrix is scaled to the exact mass.
"""

from collections.abc import Sequence

import basix
import numpy as np
from dolfinx import la

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.model.bodies import Body

__all__ = ["lumped_mass", "nodal_volumes"]


def lumped_mass(bodies: Sequence[Body]) -> Floats:
    """Lumped masses of the owned nodes. Collective.

    Args:
        bodies: Bodies of one space.

    Returns:
        Masses, shape ``(n,)`` [kg].
    """
    V = bodies[0].V
    element, geometry = Element.of(V), V.mesh.geometry
    mass = la.vector(V.dofmap.index_map, 1)
    for body in bodies:
        parts = nodal_volumes(element, geometry.x[compat.geometry_nodes(V.mesh)[body.cells]])
        np.add.at(mass.array, V.dofmap.list[body.cells], body.material.rho * parts)
    mass.scatter_reverse(la.InsertMode.add)
    owned: Floats = mass.array[: V.dofmap.index_map.size_local].copy()
    return owned


def nodal_volumes(element: Element, x: Floats) -> Floats:
    """Volume of cells distributed to their nodes. Local.

    Args:
        element: Element of the cells.
        x: Positions of the nodes of the geometry, shape ``(c, k, 3)`` [m].

    Returns:
        Volume of each node of each cell, shape ``(c, n)`` [m^3].
    """
    linear = Element.known(element.cell, 1, element.is_axisymmetric)
    is_curved = x.shape[1] > len(linear.points)
    # At degree 2 a nodal quadrature would assign no mass to nodes on the axis.
    if is_curved or (element.is_axisymmetric and element.degree > 1):
        points, weights, values = _matrix_rule(element)
        volume = _weighted(element if is_curved else linear, points, weights, x)
        diagonal = volume @ values**2
        return np.asarray(diagonal * (volume.sum(axis=1) / diagonal.sum(axis=1))[:, None])
    points, weights, shares = _rule(element)
    parts: Floats = _weighted(linear, points, weights, x) @ shares
    return parts


def _weighted(shape: Element, points: Floats, weights: Floats, x: Floats) -> Floats:
    """Quadrature weights of cells times their volume ratios, ``(c, q)`` [m^3]."""
    values, *slopes = shape.basix.tabulate(1, points)[..., 0]
    det = np.linalg.det(np.einsum("jqv,cvi->cqij", np.array(slopes), x[:, :, : len(slopes)]))
    volumes: Floats = np.abs(det) * weights
    return 2 * np.pi * (x[:, :, 0] @ values.T) * volumes if shape.is_axisymmetric else volumes


def _matrix_rule(element: Element) -> tuple[Floats, Floats, Floats]:
    """Quadrature of the mass matrix: points ``(q, 3)``, weights ``(q,)``, values ``(q, n)``."""
    cell = basix.CellType[element.cell]
    points, weights = basix.make_quadrature(cell, element.mass_degree)
    return points, weights, element.basix.tabulate(0, points)[0, :, :, 0]


def _rule(element: Element) -> tuple[Floats, Floats, Floats]:
    """Quadrature points ``(q, 3)``, weights ``(q,)`` and nodal fractions ``(q, n)`` [-]."""
    points, weights, values = _matrix_rule(element)
    if element.degree == 1:
        return points, weights, values
    diagonal = weights @ values**2
    return (element.points, diagonal * weights.sum() / diagonal.sum(), np.eye(len(element.points)))
