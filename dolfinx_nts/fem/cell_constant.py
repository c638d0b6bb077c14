"""Functions that are constant in each cell and do not change."""

from collections.abc import Iterable

from dolfinx import fem, la
from dolfinx.mesh import Mesh

__all__ = ["CellConstant", "changing"]


class CellConstant(fem.Function):  # type: ignore[misc]
    """A vector per cell that does not change. Collective.

    Args:
        mesh: The mesh.
        size: Length of the vectors.
        vector: Vector of values shared with another such function of the same size, or None.
    """

    def __init__(self, mesh: Mesh, size: int, vector: la.Vector | None = None) -> None:
        super().__init__(fem.functionspace(mesh, ("Discontinuous Lagrange", 0, (size,))), vector)


def changing(functions: Iterable[fem.Function]) -> list[fem.Function]:
    """Functions whose values may change. Local."""
    return [f for f in functions if not isinstance(f, CellConstant)]
