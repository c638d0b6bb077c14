"""Functions that are constant in each cell and never change."""

from collections.abc import Iterable

from dolfinx import fem, la
from dolfinx.mesh import Mesh

__all__ = ["CellConstant", "changing"]


class CellConstant(fem.Function):  # type: ignore[misc]
    """A vector for each cell that never changes. Collective.

    Args:
        mesh: The mesh.
        size: Length of the vectors.
        vector: Values of another such function with vectors of this length, to share.
    """

    def __init__(self, mesh: Mesh, size: int, vector: la.Vector | None = None) -> None:
        """Create the space."""
        super().__init__(fem.functionspace(mesh, ("Discontinuous Lagrange", 0, (size,))), vector)


def changing(functions: Iterable[fem.Function]) -> list[fem.Function]:
    """Functions whose values may change. Local."""
    return [f for f in functions if not isinstance(f, CellConstant)]
