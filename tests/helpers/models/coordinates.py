"""Elements of the coordinates of meshes that tests build from arrays."""

from typing import Any

import basix
import basix.ufl

__all__ = ["coordinates"]


def coordinates(cell: str, dim: int = 3) -> Any:
    """Coordinate element of degree 1, the same variant as in meshes of gmsh.

    DOLFINx makes its own boxes of another variant, with the same shape functions but with other
    kernels. These take long to compile, and so all tests share one kind.

    Args:
        cell: Kind of the cells.
        dim: Dimension of space.
    """
    equispaced = basix.LagrangeVariant.equispaced
    return basix.ufl.element("Lagrange", cell, 1, equispaced, shape=(dim,))
