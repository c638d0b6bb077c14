"""Elements of the coordinates of meshes that tests build from arrays."""

from typing import Any

import basix
import basix.ufl

__all__ = ["coordinates"]


def coordinates(cell: str, dim: int = 3) -> Any:
    """Element of degree 1 for the coordinates of a mesh, the one of meshes that gmsh has made.

    DOLFINx makes its own boxes of another variant, with the same shape functions but with other
    kernels. These take long to compile, and so all tests share one kind.

    Args:
        cell: Kind of the cells.
        dim: Dimension of space.
    """
    equispaced = basix.LagrangeVariant.equispaced
    return basix.ufl.element("Lagrange", cell, 1, equispaced, shape=(dim,))
